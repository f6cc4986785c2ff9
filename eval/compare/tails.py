"""Findings on the tail of a metric: p95, spread, worst log, worst frame, share beyond the limit.

A mean over all frames cannot show that one log, or two frames of 600, became clearly worse. These tests need an effect
far above the noise between two runs that differ in ``seed`` only (``make gate-rates`` measures it):

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
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float

from .bootstrap import mean_interval
from .metrics import COVERAGE_RELEVANT, Metric
from .values import LogValues
from .verdicts import Mark, MarkedStatistic, Place

FEWEST: Final = 2
JUMP: Final = 10.0
LONE_JUMP: Final = 50.0
SPREAD_RATIO: Final = 1.5
FLICKER: Final = 4.0
_TAIL: Final = 0.95


def tail_findings(
    logs: Sequence[LogValues], relevant: float, limit: float | None, tests: int, place: Place | None
) -> Iterator[MarkedStatistic]:
    """The findings on the tail of one metric; none for times, and only the worst log for shares.

    ``tests`` is the number of tests that share ``LEVEL``, ``place`` the worst frame.
    """
    metric = logs[0].metric
    if metric.timed:
        return
    if len(logs) > 1:
        yield _worst_log(logs, relevant, tests)
    if metric.share:
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
    return MarkedStatistic(metric, "worst log", base, new, interval, _mark(worse), worst.place(), worst.pair.name)


def _worst_frame(logs: Sequence[LogValues], relevant: float, limit: float, place: Place | None) -> MarkedStatistic:
    metric = logs[0].metric
    rises = np.concatenate([log.rises for log in logs])
    bad = np.concatenate([metric.sign * log.judged[1] > metric.sign * limit for log in logs])
    jumps = np.sort(rises[bad & (rises > max(0.0, -2 * float(rises.min())))])
    worse = jumps.size > 0 and jumps[-1] >= LONE_JUMP * relevant
    worse = worse or (jumps.size >= FEWEST and jumps[-FEWEST] >= JUMP * relevant)
    base, new = (place.base, place.new) if place else (0.0, 0.0)
    return MarkedStatistic(
        metric, "worst frame", base, new, None, _mark(worse), place, place.pair.name if place else ""
    )


def _beyond_limit(
    metric: Metric, base: Sequence[Float], new: Sequence[Float], limit: float, tests: int, place: Place | None
) -> MarkedStatistic:
    before, after = (float(np.mean(np.concatenate(side) > limit)) for side in (base, new))
    worse = after - before >= COVERAGE_RELEVANT
    worse = worse and _rises([(b > limit, n > limit) for b, n in zip(base, new, strict=True)], tests)
    return MarkedStatistic(metric, "beyond limit", before, after, None, _mark(worse), place)


def _mark(worse: bool) -> Mark:
    return "worse" if worse else "unchanged"
