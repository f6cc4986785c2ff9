"""Comparison of a new run with a base run: a verdict on every metric, and the agreement of every field."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.geometry import Float

from ..configurations import change
from ..options import Rules
from ..runs import Run, collect
from ..scan import scan
from .agreement import NOT_COMPARED, Agreement, Overlap, added, compare_tables
from .bootstrap import Interval, mean_interval
from .messages import message_agreements
from .metrics import FRAMES, METRICS, Metric
from .pairing import KEY, NEW, STAMP, Pairing, RunPair, numbered
from .verdicts import Finding, Group, Mark, Place, Verdict

ROUNDING: Final = 1e-9
"""Ratio to a metric's size below which a difference is rounding, as on another processor."""


@dataclass(frozen=True)
class LogValues:
    """A metric's values in the common frames of a pair: (N,) float64 each, the frames' numbers and stamps beside them.

    ``base`` and ``new`` are the judged numbers: absolute values, or the values themselves if high is better.
    """

    pair: RunPair
    frames: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    base: Float
    new: Float

    @property
    def differences(self) -> Float:
        """New minus base."""
        return self.new - self.base

    def place(self, metric: Metric) -> Place:
        """The frame in which the new run is worse by most."""
        at = int(np.argmin(self.differences) if metric.higher_is_better else np.argmax(self.differences))
        numbers = int(self.frames[at]), int(self.stamps_ns[at])
        return Place(self.pair, *numbers, float(self.base[at]), float(self.new[at]))


def verdicts(pairs: Sequence[RunPair], overlaps: Sequence[Overlap], rules: Rules) -> tuple[Verdict, ...]:
    """A verdict on each metric with values in any pair, in the order of ``METRICS``.

    Raises:
        TableError: a table's data cannot be read.
    """
    joined = [(pair, _joined(pair)) for pair in pairs]
    kept = [_kept(pair, found) for pair, found in zip(pairs, overlaps, strict=True)]
    every = ((FRAMES, kept), *((metric, [_values(metric, *one) for one in joined]) for metric in METRICS))
    return tuple(
        _judge(metric, values, rules)
        for metric, logs in every
        if (values := [log for log in logs if log.base.size])
        and not rules.ignores(metric.name)
        # a share of 0 in both runs means that neither run has the output
        and not (metric.share and not any(log.base.any() or log.new.any() for log in values))
    )


def _joined(pair: RunPair) -> pl.DataFrame:
    ours, theirs = (_measured(run, pair.by_segment) for run in (pair.base, pair.new))
    return ours.join(theirs, on=KEY, suffix=NEW).sort(KEY)


def _measured(run: Run, by_segment: bool) -> pl.DataFrame:
    values = [metric.value.alias(metric.name) for metric in METRICS]
    return collect(numbered(scan(run), run, by_segment).select(*KEY, "frame", *values), run.source_name)


def _values(metric: Metric, pair: RunPair, joined: pl.DataFrame) -> LogValues:
    known = joined.select("frame" + NEW, STAMP, metric.name, metric.name + NEW).drop_nulls()
    base, new = (known[name].cast(pl.Float64).to_numpy() for name in (metric.name, metric.name + NEW))
    if not metric.higher_is_better:
        base, new = np.abs(base), np.abs(new)
    return LogValues(pair, known["frame" + NEW].to_numpy(), known[STAMP].to_numpy(), base, new)


def _kept(pair: RunPair, found: Overlap) -> LogValues:
    """The base's frames as 1, and whether the new run has them; without their numbers."""
    unknown = np.full(found.common + found.only_base, -1)
    return LogValues(pair, unknown, unknown, np.ones(unknown.size), np.repeat([1.0, 0.0], found[:2]))


def _judge(metric: Metric, logs: Sequence[LogValues], rules: Rules) -> Verdict:
    base, new = (float(np.concatenate(side).mean()) for side in ([x.base for x in logs], [x.new for x in logs]))
    interval = _interval(metric, [log.differences for log in logs])
    relevant = rules.relevant.get(metric.name, metric.relevant)
    if metric.timed:
        relevant *= abs(base)
    allowed = max(relevant, rules.allowance(metric.name, base), ROUNDING * max(abs(base), abs(new)))
    mark = _mark(metric, new - base, interval, allowed)
    places = [log.place(metric) for log in logs]
    sign = -1 if metric.higher_is_better else 1
    place = max(places, key=lambda at: sign * (at.new - at.base))
    shown = None if metric is FRAMES or place.base == place.new else place
    mean = Finding(metric, "mean", base, new, interval, mark, shown)
    judged = not metric.timed or rules.times or rules.names(metric.name)
    frames = sum(log.base.size for log in logs)
    return Verdict(metric, frames, base, new, interval, mark, judged, (mean,), shown, allowed)


def _interval(metric: Metric, differences: Sequence[Float]) -> Interval:
    """The interval of the mean difference; for a share it ends at 0 if no frame was gained, or none was lost.

    Lost frames are counted, not estimated: a single series of lost frames is worse, even if other logs lost none.
    """
    interval = mean_interval(differences)
    if not metric.share:
        return interval
    least = min(float(part.min()) for part in differences)
    most = max(float(part.max()) for part in differences)
    return Interval(max(interval.low, least), min(interval.high, most))


def _mark(metric: Metric, difference: float, interval: Interval, allowed: float) -> Mark:
    sign = 1 if metric.higher_is_better else -1
    low, high = sorted((sign * interval.low, sign * interval.high))
    if abs(difference) < allowed:
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

    def groups(self, mark: Mark) -> list[Group]:
        """The judged metrics with this mark, by cause; the largest effect first, among the groups and in each."""
        names = dict.fromkeys(verdict.metric.group for verdict in self.named(mark))
        by_name = {name: [found for found in self.named(mark) if found.metric.group == name] for name in names}
        groups = [
            Group(name, tuple(sorted(found, key=lambda verdict: -verdict.weight))) for name, found in by_name.items()
        ]
        return sorted(groups, key=lambda group: -group.verdicts[0].weight)

    @property
    def worst_place(self) -> Place | None:
        """The frame of the worse metric with the largest effect."""
        worse = sorted(self.named("worse"), key=lambda verdict: -verdict.weight)
        return next((verdict.place for verdict in worse if verdict.place), None)

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
