"""Columns of a metrics table over time, thinned so that a page of any run stays small and its peaks stay visible."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.core.geometry import Float
from roadperc_stream.core.time import NS_PER_S

from ..collecting import collect
from ..runs import Run
from ..scan import rows_of
from ..segments import SEGMENT, elapsed_ns, segment

_TIME: Final = "since_start_s"
BUCKETS: Final = 600
"""Parts a run is thinned in: more than the columns of pixels a chart has on a page."""
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Series:
    """A run's columns over time: seconds from its first frame, and (N,) values of each column, NaN where null.

    ``values`` holds only columns with a value in any frame. Where the log's ``segments`` (N,) change, the last row of
    the one that ends is NaN and no frame's: no line goes on across.
    """

    name: str
    segments: NDArray[np.int64]
    since_start_s: Float
    values: Mapping[str, Float]


def load_series(run: Run, columns: Iterable[str]) -> Series:
    """Numeric columns of a run, those it has.

    Raises:
        TableError: the table's data cannot be read.
    """
    present = [name for name in dict.fromkeys(columns) if name in run.columns]
    rows = rows_of(run).select("stamp_ns", segment(run.columns), pl.col(present).cast(pl.Float64))
    table = collect(rows.with_columns((elapsed_ns() / NS_PER_S).alias(_TIME)), run.source_name)
    begins = np.flatnonzero(np.diff(table[SEGMENT])) + 1
    values = {name: np.insert(_finite(table[name]), begins, np.nan) for name in present}
    filled = {name: array for name, array in values.items() if np.isfinite(array).any()}
    segments, since_start_s = (_ends_repeated(table[name].to_numpy(), begins) for name in (SEGMENT, _TIME))
    return Series(run.name, segments, since_start_s, filled)


def _ends_repeated(values: NDArray[Any], begins: Indices) -> NDArray[Any]:
    """(N,) values with the last before each beginning twice."""
    return np.insert(values, begins, values[begins - 1])


def thinned(values: Float, buckets: int = BUCKETS) -> Indices:
    """Indices, in order, that stand for a long series: of each bucket its least, its largest and its first gap.

    A line drawn through them covers what a line through all covers, peaks and gaps included. Series of up to three
    values a bucket are kept whole.
    """
    if len(values) <= 3 * buckets:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), buckets + 1).astype(int)
    kept = [_telling(values[a:b]) + a for a, b in pairwise(edges)]
    return np.unique(np.concatenate([[0, len(values) - 1], *kept]))


def _telling(values: Float) -> Indices:
    """Indices of the least, the largest and the first unknown of a bucket, those there are."""
    unknown = np.isnan(values)
    gap = np.flatnonzero(unknown)[:1]
    if unknown.all():
        return gap
    return np.concatenate([[np.nanargmin(values), np.nanargmax(values)], gap])


def _finite(column: pl.Series) -> Float:
    values = column.to_numpy().astype(float)
    return np.where(np.isfinite(values), values, np.nan)
