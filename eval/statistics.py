"""The numbers a report gives of a numeric column, those of several tables from those of each.

Quantiles of columns that do not fit into memory are over sorted values, thinned where there are too many, and merged.
The method is Manku, Rajagopalan and Lindsay, "Approximate medians and other quantiles in one pass and with limited
memory" (SIGMOD 1998): buffers of equally heavy values in levels, each thinning moving a rank by half a step at most.
The bound is certain rather than likely, the same table gives the same figures every time, and few values are exact.
Files are sorted for their own quantiles anyway: after that it costs a tenth of a KLL sketch.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float

FAN_IN: Final = 32
"""Distributions of a level that are merged into one of the next."""


@dataclass(frozen=True)
class Distribution:
    """Values in ascending order, (N,), and how many frames each stands for, (N,).

    ``error_frames`` bounds how far thinning has moved the rank of any value, in frames.
    """

    values: NDArray[np.float64]
    weights: NDArray[np.float64]
    error_frames: float = 0.0

    @cached_property
    def heights(self) -> NDArray[np.float64]:
        """How many frames each value and those below it stand for, (N,)."""
        return np.cumsum(self.weights)

    @property
    def exact(self) -> bool:
        """Whether nothing was thinned."""
        return self.error_frames == 0

    @property
    def rank_error(self) -> float:
        """How far a quantile's rank may lie from the one asked for, as a share of all frames; 0 if exact.

        Besides the thinning, a quantile between two values may belong to either.
        """
        if self.exact:
            return 0.0
        return (self.error_frames + float(self.weights.max()) / 2) / float(self.heights[-1])


def exactly(values: NDArray[np.float64]) -> Distribution:
    """The distribution of values in ascending order, (N,), each one frame."""
    return Distribution(values, np.broadcast_to(1.0, len(values)))


def merged(parts: Sequence[Distribution]) -> Distribution:
    """All values of several distributions."""
    values = np.concatenate([part.values for part in parts])
    weights = np.concatenate([part.weights for part in parts])
    order = np.argsort(values, kind="stable")
    return Distribution(values[order], weights[order], sum(part.error_frames for part in parts))


def thinned(whole: Distribution, points: int) -> Distribution:
    """At most ``points`` values of equal weight, those in the middle of equal parts; ranks move by half a part."""
    if len(whole.values) <= points:
        return whole
    single = whole.exact and whole.weights.strides == (0,)  # as `exactly` gives them: each height is its rank
    step = (len(whole.values) if single else whole.heights[-1]) / points
    middles = (np.arange(points) + 0.5) * step
    places = np.ceil(middles).astype(np.int64) - 1 if single else np.searchsorted(whole.heights, middles)
    return Distribution(whole.values[places], np.broadcast_to(step, points), whole.error_frames + step / 2)


def absolute(signed: Distribution) -> Distribution:
    """The distribution of the absolute values, whose ranks err from both sides."""
    if signed.values[0] >= 0:
        return signed
    sizes = np.abs(signed.values)
    order = np.argsort(sizes, kind="stable")
    return Distribution(sizes[order], signed.weights[order], 2 * signed.error_frames)


def quantiles(of: Distribution, shares: Sequence[float]) -> list[float]:
    """Quantiles, interpolated linearly; where each value is one frame, those of ``numpy.quantile``."""
    # A value stands in the middle of its frames, and the quantile q between frame 0 and the last, n - 1.
    places = np.asarray(shares) * (of.heights[-1] - 1) + 0.5
    found: list[float] = np.interp(places, of.heights - of.weights / 2, of.values).tolist()
    return found


class Sketch:
    """A distribution that grows: of at most ``points`` values a part, FAN_IN parts a level."""

    def __init__(self, points: int) -> None:
        self._points = points
        self._levels: list[list[Distribution]] = [[]]

    def add(self, part: Distribution) -> None:
        """Take in a part; a full level becomes one part of the next."""
        for level in self._levels:
            level.append(thinned(part, self._points))
            if len(level) < FAN_IN:
                return
            part = merged(level)
            level.clear()
        self._levels.append([thinned(part, self._points)])

    def limit(self, points: int) -> None:
        """Allow no more than so many values a part, those taken in before included."""
        if points < self._points:
            self._points = points
            self._levels = [[thinned(part, points) for part in level] for level in self._levels]

    def distribution(self) -> Distribution:
        """All that was added."""
        return merged([part for level in self._levels for part in level])


@dataclass(frozen=True)
class Moments:
    """What is known of a numeric column without the order of its values, in its own unit: those of parts add up.

    ``values`` counts the frames that have one, ``total`` is their sum, ``std`` the population's, ``abs_most`` the
    largest absolute value.
    """

    values: int
    total: float
    std: float
    least: float
    abs_most: float


@dataclass(frozen=True)
class Statistics(Moments):
    """A numeric column over the frames that have a value; quantiles interpolate linearly.

    ``abs_...`` are over absolute values. ``rank_error`` says how far the rank of a quantile may be off, as a share of
    the values: 0 where all values were at hand, and twice as much for those of absolute values.
    """

    p5: float
    median: float
    p95: float
    p99: float
    abs_median: float
    abs_p95: float
    rank_error: float = 0.0


def moments(values: Float) -> Moments:
    """Those of values in ascending order, (N,), at least one."""
    most = float(max(-values[0], values[-1]))
    total = float(values.sum())
    apart = values - total / len(values)
    std = math.sqrt(float(np.square(apart, out=apart).mean()))  # not by BLAS, whose threads wait for each other
    return Moments(len(values), total, std, float(values[0]), most)


def statistics(parts: Sequence[Moments], column: Distribution) -> Statistics:
    """Those of several tables: exact but for the quantiles, which are as exact as the distribution over all tables.

    The deviation is that within the tables and that between their means (Chan, Golub and LeVeque 1979).
    """
    count = sum(part.values for part in parts)
    total = math.fsum(part.total for part in parts)
    squares = math.fsum(part.values * (part.std**2 + (part.total / part.values - total / count) ** 2) for part in parts)
    p5, median, p95, p99 = quantiles(column, (0.05, 0.5, 0.95, 0.99))
    abs_median, abs_p95 = quantiles(absolute(column), (0.5, 0.95))
    return Statistics(
        values=count,
        total=total,
        std=math.sqrt(squares / count),
        least=min(part.least for part in parts),
        abs_most=max(part.abs_most for part in parts),
        p5=p5,
        median=median,
        p95=p95,
        p99=p99,
        abs_median=abs_median,
        abs_p95=abs_p95,
        rank_error=column.rank_error,
    )


class ColumnPools:
    """Columns of several tables: the moments of each table's, and a sketch of at most ``points`` values a part."""

    def __init__(self, points: int) -> None:
        self.points = points
        self._columns: dict[str, tuple[list[Moments], Sketch]] = {}

    def add(self, column: str, known: Moments, part: Distribution) -> None:
        """Take in a table's values of a column."""
        found, sketch = self._columns.setdefault(column, ([], Sketch(self.points)))
        found.append(known)
        sketch.add(part)

    def limit(self, points: int) -> None:
        """Keep fewer points of each distribution."""
        self.points = min(points, self.points)
        for _, sketch in self._columns.values():
            sketch.limit(self.points)

    def statistics(self, columns: Iterable[str]) -> dict[str, Statistics]:
        """Those over all tables, of the columns that have values."""
        present = {name: self._columns[name] for name in columns if name in self._columns}
        return {name: statistics(found, sketch.distribution()) for name, (found, sketch) in present.items()}
