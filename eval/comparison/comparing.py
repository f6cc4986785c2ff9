"""The whole comparison of a candidate with a reference: the verdict on every metric, and where fields differ."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
import polars as pl

from roadperc_stream.geometry import Float
from roadperc_stream.schemas.columns import FrameMetrics, columns_of

from ..configurations import change
from ..options import Rules
from ..quantities import JITTERS, OFFSETS, SEEN, SIDES, STAGE_TIMES, TRUTH, Quantity
from ..runs import Run, collect
from ..scan import scan
from .agreement import NOT_COMPARED, Agreement, Overlap, compare_tables, together
from .bootstrap import Interval, mean_interval
from .messages import message_agreements
from .pairing import KEY, Pairing, RunPair, numbered

Mark = Literal["worse", "unchanged", "better"]
_CANDIDATE: Final = " of the candidate"
ROUNDING: Final = 1e-9
"""Share of a metric's size below which a difference is another processor's rounding."""


@dataclass(frozen=True)
class Metric:
    """A number per frame, float64, null where unknown.

    ``name`` is what ``--allow`` and ``--ignore`` match; ``share`` says that the values are 1 and 0; ``timed`` that it
    is a time, which depends on the machine and is judged on request only.
    """

    name: str
    value: pl.Expr
    higher_is_better: bool = False
    share: bool = False
    timed: bool = False


def _of_quantity(quantity: Quantity, *, timed: bool = False) -> Metric:
    return Metric(quantity.column, quantity.judged, quantity.better == "high", timed=timed)


def _share(name: str, holds: pl.Expr) -> Metric:
    return Metric(name, holds.cast(pl.Float64), higher_is_better=True, share=True)


_BEST_STATES: Final = {
    "surface_source": "depth",
    **{f"lane_{side}_status": "measured" for side in SIDES},
    "odometry_status": "tracked",
}
_COVERING: Final = (
    "surface_source",
    *(q.column for q in (*SEEN, *OFFSETS, *TRUTH) if columns_of(FrameMetrics)[q.column].compares_coverage),
)
METRICS: Final = (
    *map(_of_quantity, TRUTH),
    *(replace(_of_quantity(q), name=q.column.replace("second_difference", "jitter")) for q in JITTERS),
    *(_share(f"{name}.{best}", (pl.col(name) == best).fill_null(value=False)) for name, best in _BEST_STATES.items()),
    *(_share(f"{name}.coverage", pl.col(name).is_not_null()) for name in _COVERING),
    *(_of_quantity(quantity, timed=True) for quantity in STAGE_TIMES),
)
"""What two runs are judged by.

Errors against truth and the jitter of the lane boundaries are judged over the frames in which both runs have them;
states and coverage over all frames both runs have, as 1 or 0. What the chain says without truth to compare it with
(camera height, lane width, inliers) has no better side and is left to the comparison of fields.
"""
FRAMES: Final = _share("frames.coverage", pl.lit(value=True))
"""The reference's frames that the candidate has."""


@dataclass
class Paired:
    """A metric's values of the frames that both runs have, log by log.

    ``differences`` are candidate minus reference, (N,) float64 of each log, of which only logs with values are kept.
    """

    frames: int = 0
    reference_sum: float = 0.0
    candidate_sum: float = 0.0
    differences: list[Float] = field(default_factory=list)

    def add(self, reference: Float, candidate: Float) -> None:
        """Take the values of one more log, (N,) each."""
        if reference.size:
            self.frames += reference.size
            self.reference_sum += float(reference.sum())
            self.candidate_sum += float(candidate.sum())
            self.differences.append(candidate - reference)


@dataclass(frozen=True)
class Verdict:
    """A metric of both runs: means over the ``frames`` both have, their difference with its interval, and the mark.

    ``judged`` is false for times that no allowance names.
    """

    metric: Metric
    frames: int
    reference: float
    candidate: float
    interval: Interval
    mark: Mark
    judged: bool

    @property
    def difference(self) -> float:
        """Candidate minus reference."""
        return self.candidate - self.reference


def verdicts(pairs: Sequence[RunPair], overlaps: Sequence[Overlap], rules: Rules) -> tuple[Verdict, ...]:
    """A verdict on each metric that any pair has values of, in the metrics' order.

    Raises:
        TableError: a table's data cannot be read.
    """
    paired = {metric.name: Paired() for metric in METRICS}
    for pair in pairs:
        ours, theirs = (_measured(run, pair.by_segment) for run in (pair.reference, pair.candidate))
        joined = ours.join(theirs, on=KEY, suffix=_CANDIDATE).sort(KEY)
        for name, values in paired.items():
            known = joined.select(name, name + _CANDIDATE).drop_nulls()
            values.add(known[name].to_numpy(), known[name + _CANDIDATE].to_numpy())
    kept = Paired()
    for found in overlaps:
        had = np.ones(found.common + found.only_reference)
        kept.add(had, np.where(np.arange(had.size) < found.common, 1.0, 0.0))
    judged = ((FRAMES, kept), *((metric, paired[metric.name]) for metric in METRICS))
    return tuple(judge(metric, values, rules) for metric, values in judged if _judgeable(metric, values, rules))


def _measured(run: Run, by_segment: bool) -> pl.DataFrame:
    values = [metric.value.cast(pl.Float64).alias(metric.name) for metric in METRICS]
    return collect(numbered(scan(run), run, by_segment).select(*KEY, *values), run.source_name)


def _judgeable(metric: Metric, values: Paired, rules: Rules) -> bool:
    """Whether there is anything to judge: a share that is 0 in both runs belongs to what neither has."""
    if rules.ignores(metric.name) or not values.frames:
        return False
    return not metric.share or values.reference_sum > 0 or values.candidate_sum > 0


def judge(metric: Metric, values: Paired, rules: Rules) -> Verdict:
    """The verdict on a metric with values."""
    reference, candidate = values.reference_sum / values.frames, values.candidate_sum / values.frames
    interval = _interval(metric, values)
    allowed = max(rules.allowance(metric.name, reference), ROUNDING * max(abs(reference), abs(candidate)))
    judged = not metric.timed or rules.names(metric.name)
    return Verdict(
        metric, values.frames, reference, candidate, interval, _mark(metric, values, interval, allowed), judged
    )


def _interval(metric: Metric, values: Paired) -> Interval:
    """The interval of the mean difference; of a share it ends at 0 where no frame was gained, or none lost.

    A frame that lost its value is a fact: a single burst of them is worse, though it says little of other drives.
    """
    interval = mean_interval(values.differences)
    if not metric.share:
        return interval
    least = min(float(part.min()) for part in values.differences)
    most = max(float(part.max()) for part in values.differences)
    return Interval(max(interval.low, least), min(interval.high, most))


def _mark(metric: Metric, values: Paired, interval: Interval, allowed: float) -> Mark:
    sign = 1 if metric.higher_is_better else -1
    gain = sign * (values.candidate_sum - values.reference_sum) / values.frames
    low, high = sorted((sign * interval.low, sign * interval.high))
    if abs(gain) <= allowed:
        return "unchanged"
    if high < 0 or (metric.share and high == 0):
        return "worse"
    return "better" if low > 0 or (metric.share and low == 0) else "unchanged"


@dataclass(frozen=True)
class Comparison:
    """What two sets of runs share and where they part.

    ``columns`` and ``messages`` say how fields of the tables and of the logs' results agree, the latter only where logs
    were named; ``overlaps`` and ``changes``, the lines on what differs between the two configurations, are those of
    ``pairing.pairs``.
    """

    pairing: Pairing
    overlaps: tuple[Overlap, ...]
    changes: tuple[tuple[str, ...], ...]
    columns: Mapping[str, Agreement]
    messages: Mapping[str, Agreement]
    verdicts: tuple[Verdict, ...]

    @property
    def frames(self) -> int:
        """Frames that were compared."""
        return sum(found.common for found in self.overlaps)

    @property
    def fields(self) -> dict[str, Agreement]:
        """All fields compared, the tables' first."""
        return {**self.columns, **self.messages}

    def named(self, mark: Mark) -> list[Verdict]:
        """The judged metrics with this mark."""
        return [verdict for verdict in self.verdicts if verdict.judged and verdict.mark == mark]

    @property
    def regressions(self) -> list[str]:
        """Names of what became worse than allowed: metrics, and runs that the candidate lacks."""
        return [
            *(verdict.metric.name for verdict in self.named("worse")),
            *(f"no run of {run.name}" for run in self.pairing.missing),
        ]

    @property
    def differences(self) -> list[str]:
        """Names of the fields that differ beyond their tolerance, and of what only one side has."""
        apart = any(found.only_reference or found.only_candidate for found in self.overlaps)
        alone = [*self.pairing.missing, *self.pairing.added]
        return [
            *(name for name, agreement in self.fields.items() if agreement.state == "differs"),
            *(["frames of one run alone"] if apart else []),
            *(f"the run {run.name} of one side alone" for run in alone),
        ]


def compare_runs(pairing: Pairing, logs: tuple[Path, Path] | None, rules: Rules) -> Comparison:
    """Compare all pairs, one pair of files after another.

    If two ``logs`` were named, their results are compared as well as their tables.

    Raises:
        RoadpercError: a file cannot be read, a pair shares no stamp, or a rule names nothing there is.
    """
    if logs is None:  # the fields of messages are known where they differ, no sooner
        columns = set[str]().union(*(pair.columns for pair in pairing.pairs)).difference(NOT_COMPARED)
        rules.require_use({*columns, *(metric.name for metric in METRICS), FRAMES.name})
    overlaps, agreements = zip(*(compare_tables(pair, rules) for pair in pairing.pairs), strict=True)
    return Comparison(
        pairing,
        overlaps,
        tuple(change(pair.reference, pair.candidate) for pair in pairing.pairs),
        together(agreements),
        message_agreements(*logs, pairing.pairs[0].name, rules) if logs else {},
        verdicts(pairing.pairs, overlaps, rules),
    )
