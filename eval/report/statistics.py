"""Statistics of a numeric column over a set of rows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

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
    """Statistics of (N,) finite values, at least one."""
    least, most = float(values.min()), float(values.max())
    p5, median, p95, p99 = quantiles(values, (0.05, 0.5, 0.95, 0.99))
    abs_median, abs_p95 = (median, p95) if least >= 0 else quantiles(np.abs(values), (0.5, 0.95))
    return Statistics(
        values=len(values),
        total=float(values.sum()),
        std=float(values.std()),
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
    """Quantiles of (N,) values with linear interpolation; polars takes half the time of ``numpy.quantile``."""
    series = pl.Series(values)
    return [series.quantile(share, "linear") for share in shares]  # type: ignore[misc]
