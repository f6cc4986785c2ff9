"""The numbers a report gives of a numeric column, and those of several tables from those of each."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roadperc_stream.core.geometry import Float

from .distribution import Distribution, absolute, quantiles


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


def statistics(column: Distribution) -> Statistics:
    """Those of all values of a column, at least one."""
    return _with_quantiles(moments(column.values), column)


def statistics_of_all(parts: Sequence[Moments], column: Distribution) -> Statistics:
    """Those of several tables: exact but for the quantiles, which are as exact as the distribution over all tables.

    The deviation is that within the tables and that between their means (Chan, Golub and LeVeque 1979).
    """
    count = sum(part.values for part in parts)
    total = math.fsum(part.total for part in parts)
    squares = math.fsum(part.values * (part.std**2 + (part.total / part.values - total / count) ** 2) for part in parts)
    least, most = min(part.least for part in parts), max(part.abs_most for part in parts)
    return _with_quantiles(Moments(count, total, math.sqrt(squares / count), least, most), column)


def _with_quantiles(known: Moments, column: Distribution) -> Statistics:
    p5, median, p95, p99 = quantiles(column, (0.05, 0.5, 0.95, 0.99))
    abs_median, abs_p95 = quantiles(absolute(column), (0.5, 0.95))
    return Statistics(
        **vars(known),
        p5=p5,
        median=median,
        p95=p95,
        p99=p99,
        abs_median=abs_median,
        abs_p95=abs_p95,
        rank_error=column.rank_error,
    )
