"""Comparison of a new run with a base run: a verdict on every metric, and the agreement of every field."""

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
from .agreement import NOT_COMPARED, Agreement, Overlap, added, compare_tables
from .bootstrap import Interval, mean_interval
from .messages import message_agreements
from .pairing import KEY, NEW, Pairing, RunPair, numbered

Mark = Literal["worse", "unchanged", "better"]
ROUNDING: Final = 1e-9
"""Ratio to a metric's size below which a difference is rounding, as on another processor."""


@dataclass(frozen=True)
class Metric:
    """A number per frame, float64, null where unknown.

    ``--allow`` and ``--ignore`` match ``name``. With ``share`` the values are 1 and 0. With ``timed`` it is a time,
    which depends on the machine and is judged on request only.
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
"""The metrics on which two runs are judged.

Errors against truth and the jitter of lane boundaries are judged over the frames in which both runs have a value.
States and coverage are judged over all common frames, as 1 or 0. For outputs without truth (camera height, lane width,
inliers) neither side is better, so only the comparison of fields shows them.
"""
FRAMES: Final = _share("frames.coverage", pl.lit(value=True))
"""Share of the base's frames that the new run has."""


@dataclass
class Paired:
    """A metric's values in the common frames, log by log.

    ``differences`` are new minus base, (N,) float64 for each log with values.
    """

    frames: int = 0
    base_sum: float = 0.0
    new_sum: float = 0.0
    differences: list[Float] = field(default_factory=list)

    def add(self, base: Float, new: Float) -> None:
        """Add the values of a log, (N,) each."""
        if base.size:
            self.frames += base.size
            self.base_sum += float(base.sum())
            self.new_sum += float(new.sum())
            self.differences.append(new - base)


@dataclass(frozen=True)
class Verdict:
    """The means of a metric over the common ``frames``, the interval of their difference, and the mark.

    ``judged`` is false for times that no allowance names.
    """

    metric: Metric
    frames: int
    base: float
    new: float
    interval: Interval
    mark: Mark
    judged: bool

    @property
    def difference(self) -> float:
        """Candidate minus base."""
        return self.new - self.base


def verdicts(pairs: Sequence[RunPair], overlaps: Sequence[Overlap], rules: Rules) -> tuple[Verdict, ...]:
    """A verdict on each metric with values in any pair, in the order of ``METRICS``.

    Raises:
        TableError: a table's data cannot be read.
    """
    paired = {metric.name: Paired() for metric in METRICS}
    for pair in pairs:
        ours, theirs = (_measured(run, pair.by_segment) for run in (pair.base, pair.new))
        joined = ours.join(theirs, on=KEY, suffix=NEW).sort(KEY)
        for name, values in paired.items():
            known = joined.select(name, name + NEW).drop_nulls()
            values.add(known[name].to_numpy(), known[name + NEW].to_numpy())
    kept = Paired()
    for found in overlaps:
        kept.add(np.ones(found.common + found.only_base), np.repeat([1.0, 0.0], found[:2]))
    every = ((FRAMES, kept), *((metric, paired[metric.name]) for metric in METRICS))
    return tuple(
        _judge(metric, values, rules)
        for metric, values in every
        if values.frames
        and not rules.ignores(metric.name)
        # a share of 0 in both runs means that neither run has the output
        and not (metric.share and values.base_sum == values.new_sum == 0)
    )


def _measured(run: Run, by_segment: bool) -> pl.DataFrame:
    values = [metric.value.cast(pl.Float64).alias(metric.name) for metric in METRICS]
    return collect(numbered(scan(run), run, by_segment).select(*KEY, *values), run.source_name)


def _judge(metric: Metric, values: Paired, rules: Rules) -> Verdict:
    base, new = values.base_sum / values.frames, values.new_sum / values.frames
    interval = _interval(metric, values)
    allowed = max(rules.allowance(metric.name, base), ROUNDING * max(abs(base), abs(new)))
    judged = not metric.timed or rules.names(metric.name)
    mark = _mark(metric, values, interval, allowed)
    return Verdict(metric, values.frames, base, new, interval, mark, judged)


def _interval(metric: Metric, values: Paired) -> Interval:
    """The interval of the mean difference; for a share it ends at 0 if no frame was gained, or none was lost.

    Lost frames are counted, not estimated: a single series of lost frames is worse, even if other logs lost none.
    """
    interval = mean_interval(values.differences)
    if not metric.share:
        return interval
    least = min(float(part.min()) for part in values.differences)
    most = max(float(part.max()) for part in values.differences)
    return Interval(max(interval.low, least), min(interval.high, most))


def _mark(metric: Metric, values: Paired, interval: Interval, allowed: float) -> Mark:
    sign = 1 if metric.higher_is_better else -1
    gain = sign * (values.new_sum - values.base_sum) / values.frames
    low, high = sorted((sign * interval.low, sign * interval.high))
    if abs(gain) <= allowed:
        return "unchanged"
    if high < 0 or (metric.share and high == 0):
        return "worse"
    return "better" if low > 0 or (metric.share and low == 0) else "unchanged"


@dataclass(frozen=True)
class Comparison:
    """The comparison of two sets of runs.

    ``columns`` and ``messages`` are the agreements of the tables' columns and of the messages; ``messages`` is empty if
    the arguments are not logs. ``overlaps`` and ``changes`` (lines on the settings that differ) belong to
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
        """Number of compared frames."""
        return sum(found.common for found in self.overlaps)

    @property
    def fields(self) -> dict[str, Agreement]:
        """All compared fields, columns first."""
        return {**self.columns, **self.messages}

    def named(self, mark: Mark) -> list[Verdict]:
        """The judged metrics with this mark."""
        return [verdict for verdict in self.verdicts if verdict.judged and verdict.mark == mark]

    @property
    def regressions(self) -> list[str]:
        """Metrics that became worse than allowed, and runs that the new run lacks."""
        return [
            *(verdict.metric.name for verdict in self.named("worse")),
            *(f"no run of {run.name}" for run in self.pairing.missing),
        ]

    @property
    def differences(self) -> list[str]:
        """Fields that differ beyond their tolerance, and runs or frames that only one side has."""
        apart = any(found.only_base or found.only_new for found in self.overlaps)
        alone = [*self.pairing.missing, *self.pairing.added]
        return [
            *(name for name, agreement in self.fields.items() if agreement.state == "differs"),
            *(["frames that only one run has"] if apart else []),
            *(f"the run {run.name}, which only one side has" for run in alone),
        ]


def compare_runs(pairing: Pairing, logs: tuple[Path, Path] | None, rules: Rules) -> Comparison:
    """Compare all pairs: their tables, and the messages of two ``logs``.

    Raises:
        RoadpercError: a file cannot be read, a pair shares no stamp, or a rule matches no name.
    """
    if logs is None:  # fields of messages have names only where they differ, so rules cannot be checked with logs
        columns = set[str]().union(*(pair.columns for pair in pairing.pairs)).difference(NOT_COMPARED)
        rules.require_use({*columns, *(metric.name for metric in METRICS), FRAMES.name})
    overlaps, agreements = zip(*(compare_tables(pair, rules) for pair in pairing.pairs), strict=True)
    return Comparison(
        pairing,
        overlaps,
        tuple(change(pair.base, pair.new) for pair in pairing.pairs),
        added(agreements),
        message_agreements(*logs, pairing.pairs[0].name, rules) if logs else {},
        verdicts(pairing.pairs, overlaps, rules),
    )
