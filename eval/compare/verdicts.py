"""Judges the metrics of two runs: findings on the statistics of a metric, and a verdict on each metric.

A mean over all frames cannot show that one log, or two frames of 600, became clearly worse. So there are findings on
the tail of a metric, too. They need an effect far above the noise between two runs that differ in ``seed`` only
(``make gate-rates`` measures it):

- p95 rises by the relevant effect. The share of frames above the base's p95 rises, too: the interval of its change is
  above 0.
- The spread, p95 of abs(value - median of its log), rises by ``SPREAD_RATIO`` and by a tenth of the relevant effect.
  The share of frames above the base's spread rises, too.
- The worst log's mean rises by the relevant effect, and its interval excludes 0. A share of a log instead loses at
  least ``FEWEST`` frames, and more than ``FLICKER`` deviations of the number of frames gained in a log.
- ``FEWEST`` frames beyond the limit rise by ``JUMP`` relevant effects, or one by ``LONE_JUMP``, and by more than
  twice the largest fall. Without an effect, rises and falls are alike.
- The share of frames beyond the limit rises by ``COVERAGE_RELEVANT``, and its interval is above 0.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float

from ..options import APART_NS, WORST_FRAMES, Rules
from .bootstrap import Interval, mean_interval
from .fields import Overlap
from .metrics import COVERAGE_RELEVANT, LogValues, Metric, values_of
from .pairing import RunPair

Mark = Literal["worse", "unchanged", "better"]
Statistic = Literal["mean", "p95", "spread", "worst log", "worst frame", "beyond limit"]
ROUNDING: Final = 1e-9
"""Ratio to a metric's size below which a difference is rounding, as on another processor."""
FEWEST: Final = 2
JUMP: Final = 10.0
LONE_JUMP: Final = 50.0
SPREAD_RATIO: Final = 1.5
FLICKER: Final = 4.0
_TAIL: Final = 0.95


@dataclass(frozen=True)
class Place:
    """A frame in which the new run is worse by a metric: its number in the new run's table, and both values."""

    metric: Metric
    pair: RunPair
    frame: int
    stamp_ns: int
    base: float
    new: float


@dataclass(frozen=True)
class MarkedStatistic:
    """A statistic of a metric in both runs, and its mark.

    ``interval`` is that of the difference, if the statistic has one. ``log`` is the name of the pair that the statistic
    describes, empty if it describes all.
    """

    metric: Metric
    statistic: Statistic
    base: float
    new: float
    interval: Interval | None
    mark: Mark
    place: Place | None = None
    log: str = ""


@dataclass(frozen=True)
class Verdict:
    """The means of a metric over the common ``frames``, the interval of their difference, and the mark.

    The mark is worse if a finding is worse. A mean that changes by less than ``relevant`` is unchanged. ``judged`` is
    false for times that are not requested.
    """

    metric: Metric
    frames: int
    base: float
    new: float
    interval: Interval
    mark: Mark
    judged: bool
    findings: tuple[MarkedStatistic, ...] = ()
    places: tuple[Place, ...] = ()
    relevant: float = 0.0

    @property
    def place(self) -> Place | None:
        """The worst frame of all logs; ``places`` has the first ones at different moments."""
        return next(iter(self.places), None)

    @property
    def difference(self) -> float:
        """New minus base."""
        return self.new - self.base

    @property
    def weight(self) -> float:
        """Largest effect of the findings that have the verdict's mark, as a multiple of the relevant effect."""
        effects = [abs(found.new - found.base) for found in self.findings if found.mark == self.mark]
        return max(effects, default=0.0) / (self.relevant or 1.0)

    @property
    def worst(self) -> MarkedStatistic | None:
        """The finding with the largest effect among those that are worse."""
        worse = [found for found in self.findings if found.mark == "worse"]
        return max(worse, key=lambda found: abs(found.new - found.base), default=None)


def verdicts(pairs: Sequence[RunPair], overlaps: Sequence[Overlap], rules: Rules) -> tuple[Verdict, ...]:
    """A verdict on each metric with values in any pair, in the order of ``METRICS``.

    The intervals share ``LEVEL``: it is divided by the number of groups, because the metrics of a group restate one
    cause (Bonferroni), and for the worst log also by the number of logs.

    Raises:
        TableError: a table's data cannot be read.
    """
    found = [logs for logs in values_of(pairs, overlaps) if not rules.ignores(logs[0].metric.name)]
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
    mark = _mean_mark(metric, new - base, interval, allowed)
    places = sorted((p for log in logs for p in worst_places(log)), key=lambda at: metric.sign * (at.base - at.new))
    worst = next(iter(places), None)
    mean = MarkedStatistic(metric, "mean", base, new, interval, mark, worst)
    tails = tuple(tail_findings(logs, allowed, rules.limits.get(metric.name, metric.limit), tests, worst))
    worse = any(finding.mark == "worse" for finding in tails)
    judged = not metric.timed or rules.times or rules.names(metric.name)
    frames = sum(log.base.size for log in logs)
    whole: Mark = "worse" if worse else mark
    return Verdict(
        metric, frames, base, new, interval, whole, judged, (mean, *tails), tuple(places[:WORST_FRAMES]), allowed
    )


def worst_places(log: LogValues) -> Iterator[Place]:
    """The frames in which the new run is worse by most, ``APART_NS`` apart; none if their numbers are unknown."""
    rises, judged = log.rises.copy(), log.judged
    for _ in range(WORST_FRAMES):
        at = int(rises.argmax())
        if rises[at] <= 0 or log.frames[at] < 0:
            return
        base, new = (log.metric.shown(float(side[at])) for side in judged)
        yield Place(log.metric, log.pair, int(log.frames[at]), int(log.stamps_ns[at]), base, new)
        rises[np.abs(log.stamps_ns - log.stamps_ns[at]) < APART_NS] = 0.0


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


def _mean_mark(metric: Metric, difference: float, interval: Interval, allowed: float) -> Mark:
    low, high = sorted((-metric.sign * interval.low, -metric.sign * interval.high))
    if abs(difference) < allowed:
        return "unchanged"
    if high < 0 or (metric.share and high == 0):
        return "worse"
    return "better" if low > 0 or (metric.share and low == 0) else "unchanged"


def tail_findings(
    logs: Sequence[LogValues], relevant: float, limit: float | None, tests: int, place: Place | None
) -> Iterator[MarkedStatistic]:
    """The findings on the tail of one metric; none for times, and only the worst log for shares and whole figures.

    ``tests`` is the number of tests that share ``LEVEL``, ``place`` the worst frame.
    """
    metric = logs[0].metric
    if metric.timed:
        return
    if len(logs) > 1:
        yield _worst_log(logs, relevant, tests)
    if metric.share or metric.whole:
        return
    base, new = ([metric.sign * log.judged[side] for log in logs] for side in (0, 1))
    bound, after, worse = _quantile(base, new, relevant, tests)
    yield MarkedStatistic(metric, "p95", metric.sign * bound, metric.sign * after, None, _mark(worse), place)
    deviations = [_deviations(log.base) for log in logs], [_deviations(log.new) for log in logs]
    bound, after, worse = _quantile(*deviations, relevant / 10, tests)
    yield MarkedStatistic(metric, "spread", bound, after, None, _mark(worse and after >= SPREAD_RATIO * bound), place)
    if limit is not None:
        yield _worst_frame(logs, relevant, limit, place)
        yield _beyond_limit(metric, base, new, metric.sign * limit, tests, place)


def _deviations(values: Float) -> Float:
    return np.asarray(np.abs(values - np.median(values)), np.float64)


def _quantile(base: Sequence[Float], new: Sequence[Float], relevant: float, tests: int) -> tuple[float, float, bool]:
    """The quantile of both sides over all frames, and whether more frames of the new one are clearly beyond it."""
    bound, after = (float(np.quantile(np.concatenate(side), _TAIL)) for side in (base, new))
    beyond = [(b > bound, n > bound) for b, n in zip(base, new, strict=True)]
    return bound, after, after - bound >= relevant and _rises(beyond, tests)


def _rises(beyond: Sequence[tuple[NDArray[np.bool_], NDArray[np.bool_]]], tests: int) -> bool:
    """Whether the interval of the difference of two shares is above 0."""
    return mean_interval([new.astype(float) - base for base, new in beyond], tests).low > 0


def _worst_log(logs: Sequence[LogValues], relevant: float, tests: int) -> MarkedStatistic:
    metric = logs[0].metric
    rises = [float(log.rises.mean()) for log in logs]
    worst = logs[int(np.argmax(rises))]
    base, new = (float(side.mean()) for side in worst.judged)
    worse, interval = max(rises) >= relevant, None
    if metric.share:
        gained = sum(int((log.rises < 0).sum()) for log in logs) / len(logs)
        worse = worse and float(worst.rises.sum()) >= max(FEWEST, FLICKER * np.sqrt(gained))
    elif worse:
        interval = mean_interval([worst.differences], tests * len(logs))
        worse = interval.low > 0 or interval.high < 0
    place, name = next(worst_places(worst), None), worst.pair.name
    return MarkedStatistic(metric, "worst log", base, new, interval, _mark(worse), place, name)


def _worst_frame(logs: Sequence[LogValues], relevant: float, limit: float, place: Place | None) -> MarkedStatistic:
    metric = logs[0].metric
    rises = np.concatenate([log.rises for log in logs])
    bad = np.concatenate([metric.sign * log.judged[1] > metric.sign * limit for log in logs])
    jumps = np.sort(rises[bad & (rises > max(0.0, -2 * float(rises.min())))])
    worse = jumps.size > 0 and jumps[-1] >= LONE_JUMP * relevant
    worse = worse or (jumps.size >= FEWEST and jumps[-FEWEST] >= JUMP * relevant)
    base, new, log = (place.base, place.new, place.pair.name) if place else (0.0, 0.0, "")
    return MarkedStatistic(metric, "worst frame", base, new, None, _mark(worse), place, log)


def _beyond_limit(
    metric: Metric, base: Sequence[Float], new: Sequence[Float], limit: float, tests: int, place: Place | None
) -> MarkedStatistic:
    before, after = (float(np.mean(np.concatenate(side) > limit)) for side in (base, new))
    worse = after - before >= COVERAGE_RELEVANT
    worse = worse and _rises([(b > limit, n > limit) for b, n in zip(base, new, strict=True)], tests)
    return MarkedStatistic(metric, "beyond limit", before, after, None, _mark(worse), place)


def _mark(worse: bool) -> Mark:
    return "worse" if worse else "unchanged"
