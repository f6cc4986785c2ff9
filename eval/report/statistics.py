"""Statistics of a numeric column over a set of rows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roadperc_stream.geometry import Float


@dataclass(frozen=True)
class Statistics:
    """Statistics of a numeric column over the frames with a value, in the column's unit.

    ``values`` is the number of values, ``total`` their sum, ``std`` the population's standard deviation. Quantiles are
    interpolated linearly. ``abs_...`` are of absolute values.
    """

    values: int
    total: float
    std: float
    least: float
    abs_most: float
    p5: float
    median: float
    p95: float
    p99: float
    abs_median: float
    abs_p95: float


def statistics(values: Float) -> Statistics:
    """Statistics of (N,) finite values, at least one. The values are overwritten, which saves copies."""
    least, most, total, std = (float(of(values)) for of in (np.min, np.max, np.sum, np.std))
    p5, median, p95, p99 = quantiles(values, (0.05, 0.5, 0.95, 0.99))
    abs_median, abs_p95 = (median, p95) if least >= 0 else quantiles(np.abs(values, out=values), (0.5, 0.95))
    return Statistics(
        values=len(values),
        total=total,
        std=std,
        least=least,
        abs_most=max(-least, most),
        p5=p5,
        median=median,
        p95=p95,
        p99=p99,
        abs_median=abs_median,
        abs_p95=abs_p95,
    )


def quantiles(values: Float, shares: Sequence[float]) -> list[float]:
    """Quantiles of (N,) values at ascending shares with linear interpolation; the values are reordered.

    Each search begins at the place of the previous one: less than half the time of ``numpy.quantile``, and no copies.
    """
    found: list[float] = []
    begin = 0
    for share in shares:
        place = share * (len(values) - 1)
        rank = int(place)
        values[begin:].partition(rank - begin)
        low, above = float(values[rank]), values[rank + 1 :]
        found.append(low + (place - rank) * (float(above.min()) - low) if len(above) else low)
        begin = rank
    return found
