"""What every chart of the page shares: its data, colours, axes and lines.

A series is thinned so that a page of any run stays small and its peaks stay visible.
"""

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.geometry import Float

from ..runs import Run, collect
from ..scan import SEGMENT, rows_of, segment, since_start_s

COLOURS: Final = ("#2563eb", "#d97706", "#059669", "#c026d3", "#dc2626", "#0891b2", "#65a30d", "#57534e")
"""Distinct on white, on paper and for most who see fewer colours."""
TRUTH_COLOUR: Final = "#111827"
_GRID: Final = "#e5e7eb"
_DIGITS: Final = 6
Trace = dict[str, Any]
Layout = dict[str, Any]
_TIME: Final = "since_start_s"
BUCKETS: Final = 600
"""Parts a run is thinned in: more than the columns of pixels a chart has on a page."""
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Figure:
    """A chart: its heading, what to know when reading it, and data and layout as plotly.js takes them."""

    title: str
    note: str
    traces: Sequence[Trace]
    layout: Mapping[str, Any]

    @property
    def spec(self) -> dict[str, Any]:
        """The figure as plotly.js takes it."""
        return {"data": list(self.traces), "layout": dict(self.layout)}


def layout(x_title: str, y_title: str, **more: Any) -> Layout:
    """The page's look of a chart; the heading stands above it, in the page."""
    return {
        "height": 270,
        "margin": {"l": 52, "r": 12, "t": 8, "b": 42},
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": "#1f2937"},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "hovermode": "x unified",
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"},
        "showlegend": True,
        "xaxis": axis(x_title),
        "yaxis": axis(y_title),
        **more,
    }


def axis(title: str, **more: Any) -> Layout:
    """An axis with a light grid."""
    look = {"gridcolor": _GRID, "zerolinecolor": "#9ca3af", "automargin": True, "ticks": "outside", "ticklen": 3}
    return {"title": {"text": title, "standoff": 6}, **look, **more}


def line(name: str, x: Float, y: Float, colour: str, **more: Any) -> Trace:
    """A line through (N,) points; NaN interrupts it. ``width`` and ``dash`` go to the line, the rest to the trace."""
    look = {key: more.pop(key) for key in ("width", "dash", "shape") if key in more}
    # A value between two gaps would be a line of no length: a single frame is shown as a point.
    alone = bool(np.isfinite(y).sum() and not np.isfinite(y[:-1] + y[1:]).any())
    return {
        "type": "scatter",
        "mode": "lines+markers" if alone else "lines",
        "name": escaped(name),
        "x": numbers(x),
        "y": numbers(y),
        "line": {"color": colour, "width": 1.6, **look},
        **more,
    }


def numbers(values: Float) -> list[float | None]:
    """Values as JSON holds them: six digits, None for NaN."""
    return [float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None for value in values.tolist()]


def escaped(text: str) -> str:
    """A text that plotly.js shows as it is: it takes tags in names for markup."""
    return html.escape(text, quote=False)


def colour_of(place: int) -> str:
    """The colour of a run or a kind by its place; they repeat."""
    return COLOURS[place % len(COLOURS)]


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
    table = collect(rows.with_columns(since_start_s()), run.source_name)
    begins = np.flatnonzero(np.diff(table[SEGMENT])) + 1
    values = {name: np.insert(_finite(table[name]), begins, np.nan) for name in present}
    filled = {name: array for name, array in values.items() if np.isfinite(array).any()}
    # (N,) values with the last before each beginning twice
    whole = {name: table[name].to_numpy() for name in (SEGMENT, _TIME)}
    segments, times_s = (np.insert(all_, begins, all_[begins - 1]) for all_ in whole.values())
    return Series(run.name, segments, times_s, filled)


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
