"""The paired difference of every metric over all pairs of runs, and what to call it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
import polars as pl

from roadperc_stream.core.geometry import Float

from ..collecting import collect
from ..scan import scan
from .bootstrap import Interval, mean_interval
from .metrics import FRAMES, METRICS, Metric
from .pairing import KEY, LoggedRun, RunPair, numbered, segments_of
from .rules import Rules
from .tables import Overlap

Mark = Literal["better", "worse", "unchanged"]
_CANDIDATE: Final = " of the candidate"
ROUNDING: Final = 1e-9
"""Share of a metric's size below which a difference is another processor's rounding."""


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

    ``allowed`` is how much worse it may be; ``judged`` is false for times nobody asked to judge.
    """

    metric: Metric
    frames: int
    reference: float
    candidate: float
    interval: Interval
    allowed: float
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
        for name, (reference, candidate) in _values(pair).items():
            paired[name].add(reference, candidate)
    found = [(FRAMES, _frames_kept(overlaps)), *((metric, paired[metric.name]) for metric in METRICS)]
    return tuple(judge(metric, values, rules) for metric, values in found if _judgeable(metric, values, rules))


def judge(metric: Metric, values: Paired, rules: Rules) -> Verdict:
    """The verdict on a metric with values."""
    reference, candidate = values.reference_sum / values.frames, values.candidate_sum / values.frames
    interval = _interval(metric, values)
    allowed = rules.allowance(metric.name, reference)
    mark = _mark(metric, values, interval, max(allowed, ROUNDING * max(abs(reference), abs(candidate))))
    judged = not metric.timed or rules.names(metric.name)
    return Verdict(metric, values.frames, reference, candidate, interval, allowed, mark, judged)


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


def _values(pair: RunPair) -> Mapping[str, tuple[Float, Float]]:
    """Of each metric the values of the frames in which both runs have one, in the order of time."""
    ours, theirs = (_measured(item, pair.by_segment) for item in (pair.reference, pair.candidate))
    joined = ours.join(theirs, on=KEY, suffix=_CANDIDATE).sort(KEY)
    return {metric.name: _both(joined, metric.name) for metric in METRICS}


def _measured(item: LoggedRun, by_segment: bool) -> pl.DataFrame:
    values = [metric.value.cast(pl.Float64).alias(metric.name) for metric in METRICS]
    rows = numbered(scan(item.run), segments_of(item, by_segment))
    return collect(rows.select(*KEY, *values), item.run.source_name)


def _both(joined: pl.DataFrame, name: str) -> tuple[Float, Float]:
    known = joined.select(name, name + _CANDIDATE).drop_nulls()
    return known[name].to_numpy(), known[name + _CANDIDATE].to_numpy()


def _frames_kept(overlaps: Iterable[Overlap]) -> Paired:
    kept = Paired()
    for found in overlaps:
        had = np.ones(found.common + found.only_reference)
        kept.add(had, np.where(np.arange(had.size) < found.common, 1.0, 0.0))
    return kept


def _judgeable(metric: Metric, values: Paired, rules: Rules) -> bool:
    """Whether there is anything to judge: a share that is 0 in both runs belongs to what neither has."""
    if rules.ignores(metric.name) or not values.frames:
        return False
    return not metric.share or values.reference_sum > 0 or values.candidate_sum > 0
