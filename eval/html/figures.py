"""Data, colours, axes and lines of the page's charts.

Series are thinned: the page of a long run stays small, and peaks stay visible.
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
from roadperc_stream.system.text import shown

from ..runs import Run, collect
from ..scan import SEGMENT, finite, rows_of, since_start_s

COLOURS: Final = ("#2563eb", "#d97706", "#059669", "#c026d3", "#dc2626", "#0891b2", "#65a30d", "#57534e")
"""Distinct on white, on paper, and for most forms of colour blindness."""
TRUTH_COLOUR: Final = "#111827"
"""The page's script replaces it on a dark page."""
_DIGITS: Final = 6
_WIDTH: Final = 1.6
_WIDER: Final = 3.0
Trace = dict[str, Any]
Layout = dict[str, Any]
_TIME: Final = "since_start_s"
TIME_TITLE: Final = "time from the log's first frame, s"
BUCKETS: Final = 300
"""Buckets of a thinned series: with two extremes in each, more than a chart has columns of pixels."""
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Figure:
    """A chart: heading, explanation, and plotly.js' data and layout."""

    title: str
    note: str
    traces: Sequence[Trace]
    layout: Mapping[str, Any]

    @property
    def timed(self) -> bool:
        """Whether the chart is over time, so that its cursor follows the others."""
        return bool(self.layout["xaxis"]["title"]["text"] == TIME_TITLE)

    @property
    def spec(self) -> dict[str, Any]:
        """The figure for plotly.js."""
        return {"data": list(self.traces), "layout": dict(self.layout)}


def layout(x_title: str, y_title: str, **more: Any) -> Layout:
    """The layout of a chart; its heading is part of the page."""
    return {
        "height": 270,
        "margin": {"l": 52, "r": 12, "t": 8, "b": 42},
        "font": {"family": "system-ui, sans-serif", "size": 12},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "hovermode": "x unified",
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"},
        "showlegend": True,
        "xaxis": axis(x_title),
        "yaxis": axis(y_title),
        **more,
    }


def axis(title: str, **more: Any) -> Layout:
    """An axis whose numbers have neither exponents nor prefixes; the page's script gives it a colour."""
    look = {"automargin": True, "ticks": "outside", "ticklen": 3, "exponentformat": "none"}
    return {"title": {"text": title, "standoff": 6}, **look, **more}


def line(name: str, x: Float, y: Float, colour: str, **more: Any) -> Trace:
    """A line through (N,) points; NaN interrupts it.

    ``width``, ``wider`` (added to it) and ``dash`` go to the line, the rest to the trace.
    """
    look = {"width": more.pop("width", _WIDTH) + more.pop("wider", 0.0), "dash": more.pop("dash", "solid")}
    # A line through single values between gaps has no length, so points are drawn.
    alone = bool(np.isfinite(y).sum() and not np.isfinite(y[:-1] + y[1:]).any())
    return {
        "type": "scatter",
        "mode": "lines+markers" if alone else "lines",
        "name": escaped(name),
        "x": numbers(x),
        "y": numbers(y),
        "line": {"color": colour, **look},
        **more,
    }


def numbers(values: Float) -> list[float | None]:
    """Values for JSON: six digits, None for NaN."""
    return [float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None for value in values.tolist()]


def escaped(text: str) -> str:
    """A text for plotly.js, which interprets tags in names as markup."""
    return html.escape(shown(text), quote=False)


def colour_of(place: int) -> str:
    """The colour of the run or kind with this index; colours repeat."""
    return COLOURS[place % len(COLOURS)]


@dataclass(frozen=True)
class Series:
    """A run's columns over time: seconds from its first frame, and (N,) values of each column, NaN if null.

    ``values`` holds only columns with a value in any frame. Each of the log's ``segments`` (N,) except the last ends
    with an additional row of NaN, so that no line crosses segments.
    """

    name: str
    segments: NDArray[np.int64]
    since_start_s: Float
    values: Mapping[str, Float]


def load_series(run: Run, columns: Iterable[str]) -> Series:
    """The numeric columns that a run has.

    Raises:
        TableError: the table's data cannot be read.
    """
    present = [name for name in dict.fromkeys(columns) if name in run.columns]
    rows = rows_of(run).select("stamp_ns", SEGMENT, pl.col(present).cast(pl.Float64))
    table = collect(rows.with_columns(since_start_s(), *finite(present)), run.source_name)
    begins = np.flatnonzero(np.diff(table[SEGMENT])) + 1
    values = {name: np.insert(table[name].to_numpy().astype(float), begins, np.nan) for name in present}
    filled = {name: array for name, array in values.items() if np.isfinite(array).any()}
    # the additional rows repeat the segment and the time of the row before
    whole = (table[name].to_numpy() for name in (SEGMENT, _TIME))
    segments, times_s = (np.insert(column, begins, column[begins - 1]) for column in whole)
    return Series(run.name, segments, times_s, filled)


def wider(runs: Sequence[Series], place: int, column: str) -> float:
    """Additional width of a run's curve if later runs draw equal ones over it, so that all colours are visible."""
    values = runs[place].values[column]
    later = (run.values[column] for run in runs[place + 1 :] if column in run.values)
    return _WIDER * sum(np.array_equal(values, other, equal_nan=True) for other in later)


def thinned(values: Float, buckets: int = BUCKETS) -> Indices:
    """Indices of the smallest value, the largest value and the first gap of each bucket, in order.

    A line through these values has the same peaks and gaps as the line through all values. Series with up to three
    values per bucket are kept whole.
    """
    if len(values) <= 3 * buckets:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), buckets + 1).astype(int)
    kept = [_extremes(values[a:b]) + a for a, b in pairwise(edges)]
    return np.unique(np.concatenate([[0, len(values) - 1], *kept]))


def _extremes(values: Float) -> Indices:
    """Indices of the smallest, the largest and the first unknown value of a bucket, if any."""
    unknown = np.isnan(values)
    gap = np.flatnonzero(unknown)[:1]
    if unknown.all():
        return gap
    return np.concatenate([[np.nanargmin(values), np.nanargmax(values)], gap])
