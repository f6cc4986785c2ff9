"""Comparison of a new run with a base run: a verdict on every metric, and the agreement of every field."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float

from ..configurations import change
from ..options import Rules
from .agreement import NOT_COMPARED, Agreement, Overlap, added, compare_tables
from .bootstrap import Interval, mean_interval
from .metrics import FRAMES, METRICS, Metric
from .pairing import Pairing, RunPair
from .tails import tail_findings
from .values import LogValues, values_of
from .verdicts import CauseGroup, Mark, MarkedStatistic, Place, Verdict

ROUNDING: Final = 1e-9
"""Ratio to a metric's size below which a difference is rounding, as on another processor."""


def verdicts(pairs: Sequence[RunPair], overlaps: Sequence[Overlap], rules: Rules) -> tuple[Verdict, ...]:
    """A verdict on each metric with values in any pair, in the order of ``METRICS``.

    The intervals share ``LEVEL``: it is divided by the number of groups, because the metrics of a group restate one
    cause (Bonferroni), and for the worst log also by the number of logs.

    Raises:
        TableError: a table's data cannot be read.
    """
    found = [
        logs
        for logs in values_of(pairs, overlaps)
        if not rules.ignores(logs[0].metric.name)
        # a share of 0 in both runs means that neither run has the output
        and not (logs[0].metric.share and not any(log.base.any() or log.new.any() for log in logs))
    ]
    tests = len({logs[0].metric.group for logs in found})
    return tuple(_judge(logs, rules, tests) for logs in found)


def _judge(logs: Sequence[LogValues], rules: Rules, tests: int) -> Verdict:
    metric = logs[0].metric
    before, after = (float(np.concatenate([log.judged[side] for log in logs]).mean()) for side in (0, 1))
    base, new = metric.shown(before), metric.shown(after)
    relevant = rules.relevant.get(metric.name, metric.relevant) * (base if metric.timed else 1.0)
    rounding = ROUNDING * max(abs(base), abs(new))
    allowed = max((rules.allowance(metric.name, base) or relevant) - rounding, rounding)
    interval = _interval(metric, [log.differences for log in logs], tests)
    if metric.timed:
        interval = Interval(*(base * float(np.expm1(bound)) for bound in (interval.low, interval.high)))
    mark = _mark(metric, new - base, interval, allowed)
    places = [place for log in logs if (place := log.place())]
    worst = max(places, key=lambda at: metric.sign * (at.new - at.base), default=None)
    mean = MarkedStatistic(metric, "mean", base, new, interval, mark, worst)
    tails = tuple(tail_findings(logs, allowed, rules.limits.get(metric.name, metric.limit), tests, worst))
    worse = any(finding.mark == "worse" for finding in tails)
    judged = not metric.timed or rules.times or rules.names(metric.name)
    frames = sum(log.base.size for log in logs)
    whole: Mark = "worse" if worse else mark
    return Verdict(metric, frames, base, new, interval, whole, judged, (mean, *tails), worst, allowed)


def _interval(metric: Metric, differences: Sequence[Float], tests: int) -> Interval:
    """The interval of the mean difference; for a share it ends at 0 if no frame was gained, or none was lost.

    Lost frames are counted, not estimated: a single series of lost frames is worse, even if other logs lost none.
    """
    interval = mean_interval(differences, tests)
    if not metric.share:
        return interval
    least = min(float(part.min()) for part in differences)
    most = max(float(part.max()) for part in differences)
    return Interval(max(interval.low, least), min(interval.high, most))


def _mark(metric: Metric, difference: float, interval: Interval, allowed: float) -> Mark:
    low, high = sorted((-metric.sign * interval.low, -metric.sign * interval.high))
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

    def groups(self, mark: Mark) -> list[CauseGroup]:
        """The judged metrics with this mark, by cause; the largest effect first, among the groups and in each."""
        names = dict.fromkeys(verdict.metric.group for verdict in self.named(mark))
        by_name = {name: [found for found in self.named(mark) if found.metric.group == name] for name in names}
        groups = [
            CauseGroup(name, tuple(sorted(found, key=lambda verdict: -verdict.weight)))
            for name, found in by_name.items()
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
    messages: Mapping[str, Agreement] = {}
    if logs:
        from .messages import message_agreements  # only here, because it imports the readers of logs

        messages = message_agreements(*logs, pairing.pairs[0].name, rules)
    return Comparison(
        pairing,
        overlaps,
        tuple(change(pair.base, pair.new) for pair in pairing.pairs),
        added(agreements),
        messages,
        verdicts(pairing.pairs, overlaps, rules),
    )
