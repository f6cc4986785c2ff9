"""Draws the strip of text at the top of an overlay: the frame's numbers and the legend."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np

from roadperc_stream.model import Absent, Box, Image, Object, Objects
from roadperc_stream.output.drawing import colours
from roadperc_stream.output.drawing.canvas import (
    DARK,
    Colour,
    Pen,
    box_outline,
    dashed_line,
    edged_lines,
    text_size,
    write,
)
from roadperc_stream.output.drawing.colours import bgr
from roadperc_stream.schemas.columns import FrameMetrics

Phrase = tuple[str, Colour]
"""Text that stays on one line, and its colour."""
_PLAIN: Final[Colour] = (240, 240, 240)
_SHADE: Final = 0.7
_GAP_CHARACTERS: Final = 0.6
"""Gap between two phrases, in heights of the text."""
_SYMBOL_DASHES: Final = 4.0
Symbol = Literal["area", "line", "dashed line", "box", "dashed box"]


@dataclass(frozen=True)
class LegendEntry:
    """The meaning of a colour and a shape."""

    text: str
    colour: Colour
    symbol: Symbol


LEGEND: Final = (
    LegendEntry("drivable", bgr(colours.DRIVABLE), "area"),
    LegendEntry("lane", bgr(colours.BOUNDARY["measured"]), "line"),
    LegendEntry("held", bgr(colours.BOUNDARY["held"]), "line"),
    LegendEntry("raw", bgr(colours.RAW_LINE), "dashed line"),
    LegendEntry("kept", bgr(colours.OBJECT["kept"]), "box"),
    LegendEntry("unverified", bgr(colours.OBJECT["unverified"]), "box"),
    LegendEntry("dropped", bgr(colours.OBJECT["dropped"]), "dashed box"),
)
Item = Phrase | LegendEntry
Strip = Sequence[Sequence[tuple[int, Item]]]
"""Lines of items, each with its first column."""


def lay_out_strip(pen: Pen, metrics: FrameMetrics, objects: Objects | Absent, since_start_s: float) -> Strip:
    """Arrange a frame's numbers and the legend in lines; a narrow image needs more lines.

    Null values are left out. The nearest and the most urgent object are named.
    """
    return _lines((*frame_phrases(metrics, objects, since_start_s), *LEGEND), pen)


def draw_strip(canvas: Image, strip: Strip) -> None:
    """Write the lines over the topmost rows of the image, (H, W, 3) uint8."""
    pen = Pen.of(canvas)
    shaded = canvas[: len(strip) * pen.row_px]
    shaded[...] = cv2.addWeighted(shaded, 1 - _SHADE, np.full_like(shaded, DARK), _SHADE, 0)
    for row, line in enumerate(strip):
        for x, item in line:
            _draw_item(canvas, item, (x, row * pen.row_px), pen)


def _draw_item(canvas: Image, item: Item, at_px: tuple[int, int], pen: Pen) -> None:
    if isinstance(item, LegendEntry):
        x, y = at_px
        width, height = _symbol_size(pen)
        left, top = x + pen.margin_px, y + (pen.row_px - height) // 2
        _draw_symbol(canvas, item, Box(left, top, left + width - 1, top + height - 1), pen)
        write(canvas, item.text, (x + width + 2 * pen.margin_px, y), _PLAIN, pen)
    else:
        write(canvas, item[0], at_px, item[1], pen)


def _draw_symbol(canvas: Image, entry: LegendEntry, place: Box, pen: Pen) -> None:
    """Draw a sample of the overlay's drawing, at the same line width."""
    y = (place.y_min + place.y_max) / 2
    dash_px = (place.x_max - place.x_min) / _SYMBOL_DASHES
    ends = np.array(((place.x_min, y), (place.x_max, y)))
    if entry.symbol == "area":
        first, last = (int(place.x_min), int(place.y_min)), (int(place.x_max), int(place.y_max))
        cv2.rectangle(canvas, first, last, entry.colour, cv2.FILLED)
    elif entry.symbol == "line":
        edged_lines(canvas, [ends], entry.colour, pen.broad_px, pen)
    elif entry.symbol == "dashed line":
        dashed_line(canvas, ends, entry.colour, pen.thin_px, dash_px, pen)
    else:
        box_outline(canvas, place, entry.colour, pen.thin_px, pen, dash_px if entry.symbol == "dashed box" else None)


def _symbol_size(pen: Pen) -> tuple[int, int]:
    return round(1.4 * pen.text_px), round(0.6 * pen.text_px)


def frame_phrases(metrics: FrameMetrics, objects: Objects | Absent, since_start_s: float) -> Iterator[Phrase]:
    """Phrases of a frame's row and of its nearest and most urgent objects, the most important numbers first."""
    yield f"frame {metrics.frame}", _PLAIN
    yield f"{since_start_s:.2f} s", _PLAIN
    yield from _lane("left", metrics.lane_left_status, metrics.lane_left_offset_m)
    yield from _lane("right", metrics.lane_right_status, metrics.lane_right_offset_m)
    if not isinstance(objects, Absent):
        yield from _objects(objects.nearest, objects.most_urgent)
    yield from _odometry(metrics)
    if metrics.surface_source is not None:
        yield f"surface: {metrics.surface_source}", _PLAIN


def _lane(side: str, status: str | None, offset_m: float | None) -> Iterator[Phrase]:
    if status is not None:
        text = status if offset_m is None else f"{offset_m:+.2f} m"
        yield f"lane {side} {text}", bgr(colours.BOUNDARY[status])


def _objects(nearest: Object | None, urgent: Object | None) -> Iterator[Phrase]:
    """The most urgent object, then the nearest: the smallest time to impact may belong to another object."""
    if urgent is not None and urgent is nearest:
        yield f"nearest {_named(urgent)}, impact in {urgent.time_to_impact_s:.1f} s", _PLAIN
        return
    if urgent is not None:
        yield f"impact: {_named(urgent)} in {urgent.time_to_impact_s:.1f} s", _PLAIN
    if nearest is not None:
        yield f"nearest {_named(nearest)}", _PLAIN


def _named(item: Object) -> str:
    """Label, and distance if known."""
    name = item.detection.label or "object"
    return name if item.distance_m is None else f"{name} {item.distance_m:.1f} m"


def _odometry(metrics: FrameMetrics) -> Iterator[Phrase]:
    if metrics.step_m is not None:
        yield f"step {metrics.step_m:.2f} m", _PLAIN
    elif metrics.odometry_status is not None:
        text = "without scale" if metrics.odometry_status == "tracked" else metrics.odometry_status
        yield f"odometry {text}", bgr(colours.ORANGE) if metrics.odometry_status == "lost" else _PLAIN


def _lines(items: Iterable[Item], pen: Pen) -> list[list[tuple[int, Item]]]:
    """The items with their first columns, as many on a line as fit."""
    lines: list[list[tuple[int, Item]]] = [[]]
    x = 0
    for item in items:
        width = _width(item, pen)
        if lines[-1] and x + width > pen.size[0]:
            lines.append([])
            x = 0
        lines[-1].append((x, item))
        x += width + round(_GAP_CHARACTERS * pen.text_px)
    return lines


def _width(item: Item, pen: Pen) -> int:
    if isinstance(item, LegendEntry):
        return text_size(item.text, pen)[0] + _symbol_size(pen)[0] + 2 * pen.margin_px
    return text_size(item[0], pen)[0]
