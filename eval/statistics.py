"""The numbers a report gives of a numeric column, and those of several tables from those of each."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .distribution import Distribution, absolute, quantiles


@dataclass(frozen=True)
class Statistics:
    """A numeric column over the frames that have a value, in its own unit; quantiles interpolate linearly.

    ``abs_...`` are over absolute values, ``std`` is the population's, ``total`` the sum. ``rank_error`` says how far
    the rank of a quantile may be off, as a share of the values: 0 where all values were at hand, and twice as much for
    those of absolute values.
    """

    values: int
    total: float
    std: float
    least: float
    p5: float
    median: float
    p95: float
    p99: float
    abs_median: float
    abs_p95: float
    abs_most: float
    rank_error: float = 0.0


def statistics(column: Distribution) -> Statistics:
    """Those of all values of a column, at least one."""
    values = column.values
    total, std = float(values.sum()), float(values.std())
    most = float(max(-values[0], values[-1]))
    return Statistics(len(values), total, std, float(values[0]), *_quantiles(column), most, column.rank_error)


def statistics_of_all(parts: Sequence[Statistics], column: Distribution) -> Statistics:
    """Those of several tables: exact but for the quantiles, which are as exact as the distribution over all tables.

    The deviation is that within the tables and that between their means (Chan, Golub and LeVeque 1979).
    """
    count = sum(part.values for part in parts)
    total = math.fsum(part.total for part in parts)
    squares = math.fsum(part.values * (part.std**2 + (part.total / part.values - total / count) ** 2) for part in parts)
    least, most = min(part.least for part in parts), max(part.abs_most for part in parts)
    return Statistics(count, total, math.sqrt(squares / count), least, *_quantiles(column), most, column.rank_error)


def _quantiles(column: Distribution) -> tuple[float, float, float, float, float, float]:
    """p5, median, p95 and p99, and the median and p95 of the absolute values."""
    p5, median, p95, p99 = quantiles(column, (0.05, 0.5, 0.95, 0.99))
    abs_median, abs_p95 = quantiles(absolute(column), (0.5, 0.95))
    return p5, median, p95, p99, abs_median, abs_p95
