"""What every chart of the page shares: a figure of plotly.js as plain data, colours, axes and lines."""

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from roadperc_stream.core.geometry import Float

COLOURS: Final = ("#2563eb", "#d97706", "#059669", "#c026d3", "#dc2626", "#0891b2", "#65a30d", "#57534e")
"""Distinct on white, on paper and for most who see fewer colours."""
TRUTH_COLOUR: Final = "#111827"
_GRID: Final = "#e5e7eb"
_DIGITS: Final = 6
Trace = dict[str, Any]
Layout = dict[str, Any]


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
