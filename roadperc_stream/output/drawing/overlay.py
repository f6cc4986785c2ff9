"""Draws the results into a camera image, for reports and videos.

Lines and text are sized for the target image, so the text of a thumbnail is as legible as that of a full frame.
Viewers draw the results themselves, from the messages of ``drawing.annotations``. The strip at the top of a frame has
its numbers and the legend.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np

from roadperc_stream.model import Absent, Box, Image, Lanes, Mask, Object, Objects
from roadperc_stream.output.drawing import colours
from roadperc_stream.output.drawing.annotations import caption
from roadperc_stream.output.drawing.canvas import (
    DARK,
    Colour,
    Pen,
    box_outline,
    dashed_line,
    edged_lines,
    polyline,
    resized,
    scaled_box,
    text_size,
    write,
    write_on_plate,
)
from roadperc_stream.output.drawing.captions import by_nearness, label_places
from roadperc_stream.output.drawing.colours import bgr
from roadperc_stream.schemas.columns import FrameMetrics

_PLAIN: Final[Colour] = (240, 240, 240)
_SHADE: Final = 0.7
_GAP_CHARACTERS: Final = 0.6
"""Gap between two phrases, in heights of the text."""
_SYMBOL_DASHES: Final = 4.0


@dataclass(frozen=True)
class Phrase:
    """A text of the strip that stays on one line; with a symbol before it, the symbol has the colour."""

    text: str
    colour: Colour = _PLAIN
    symbol: Literal["", "area", "line", "dashed line", "box", "dashed box"] = ""


LEGEND: Final = (
    Phrase("drivable", bgr(colours.DRIVABLE), "area"),
    Phrase("lane", bgr(colours.BOUNDARY["measured"]), "line"),
    Phrase("held", bgr(colours.BOUNDARY["held"]), "line"),
    Phrase("raw", bgr(colours.RAW_LINE), "dashed line"),
    Phrase("kept", bgr(colours.OBJECT["kept"]), "box"),
    Phrase("unverified", bgr(colours.OBJECT["unverified"]), "box"),
    Phrase("dropped", bgr(colours.OBJECT["dropped"]), "dashed box"),
)
_TINT: Final = 0.22
_LEVELS: Final = np.arange(256)[None, :, None]
_TINTED: Final = np.rint((1 - _TINT) * _LEVELS + _TINT * np.array(bgr(colours.DRIVABLE))).astype(np.uint8)
"""(1, 256, 3) lookup table of each colour's levels on the drivable road."""
_RAW_DASH: Final = 7.0
_BOX_DASH: Final = 4.0
"""Length of a dash, in line widths."""
_BOX_LINE: Final = 12.0
"""The line width of a small box is its shorter side divided by this."""


@dataclass(frozen=True)
class PerceivedFrame:
    """A camera image, (H, W, 3), and its results.

    ``fits`` is true if the image has the size of its calibration, which is the size of the results.
    """

    image_bgr: Image
    lanes: Lanes | Absent
    objects: Objects | Absent
    drivable: Mask | Absent
    fits: bool = True


def draw_results(frame: PerceivedFrame, width_px: int, top_px: int = 0) -> Image:
    """A copy of the image with the frame's results drawn in; absent results are not drawn.

    - Drivable pixels are tinted blue.
    - A lane boundary is a broad line along the smoothed curve: green if measured, orange if held.
    - The raw line is thin, dashed and yellow.
    - A kept object has a solid box with label, distance and time to impact: green, or yellow if unverified.
    - A dropped object has a dashed grey box.
    - An image whose size differs from the results stays bare.

    The copy has ``width_px`` columns, for which lines and text are sized, and no labels in its ``top_px`` upper rows.

    Returns:
        (H * width_px / W, width_px, 3) uint8, blue, green, red.
    """
    scale = width_px / frame.image_bgr.shape[1]
    canvas = resized(frame.image_bgr, scale)
    if not frame.fits:
        return canvas
    pen = Pen.of(canvas.shape, scale)
    if not isinstance(frame.drivable, Absent):
        mask = cv2.resize(frame.drivable.astype(np.uint8), pen.size, interpolation=cv2.INTER_NEAREST)
        cv2.copyTo(cv2.LUT(canvas, _TINTED), mask, canvas)
    if not isinstance(frame.lanes, Absent):
        _draw_lanes(canvas, frame.lanes, pen)
    if not isinstance(frame.objects, Absent):
        _draw_objects(canvas, frame.objects.objects, pen, top_px)
    return canvas


def _draw_lanes(canvas: Image, lanes: Lanes, pen: Pen) -> None:
    for boundary in lanes.boundaries:
        if boundary.status != "lost" and len(boundary.line_px):
            edged_lines(canvas, [boundary.line_px], bgr(colours.BOUNDARY[boundary.status]), pen.broad_px, pen)
    # The thin raw line is on top of the broad smoothed one, so that both can be compared.
    for boundary in lanes.boundaries:
        if boundary.raw_px is not None:
            ends = np.array(boundary.raw_px).reshape(2, 2)
            dashed_line(canvas, ends, bgr(colours.RAW_LINE), pen.thin_px, _RAW_DASH * pen.line_px, pen)


def _draw_objects(canvas: Image, objects: Sequence[Object], pen: Pen, top_px: int) -> None:
    """Draw boxes from far to near, then labels that have a place, with a line to boxes that are not next to them."""
    boxes = [scaled_box(item.detection.box_px, pen) for item in objects]
    for index in reversed(by_nearness(objects)):
        _draw_box(canvas, objects[index], boxes[index], pen)
    text_sizes = [text_size(caption(item), pen) for item in objects]
    places = label_places(pen.size, top_px, objects, boxes, text_sizes)
    for item, box, place in zip(objects, boxes, places, strict=True):
        if place is not None and caption(item):
            _draw_tie(canvas, item, box, place)
    for item, place in zip(objects, places, strict=True):
        if place is not None and caption(item):
            colour = bgr(colours.OBJECT[item.verdict])
            write_on_plate(canvas, caption(item), (place.x_min, place.y_min), colour, pen)


def _draw_box(canvas: Image, item: Object, box: Box, pen: Pen) -> None:
    """Draw a box; a small one has thin lines, so that the object stays visible."""
    side_px = min(box.x_max - box.x_min, box.y_max - box.y_min)
    thickness_px = max(min(pen.line_px, round(side_px / _BOX_LINE)), 1)
    dash_px = None if item.kept else _BOX_DASH * pen.line_px
    box_outline(canvas, box, bgr(colours.OBJECT[item.verdict]), thickness_px, pen, dash_px)


def _draw_tie(canvas: Image, item: Object, box: Box, place: Box) -> None:
    """Draw a thin line from a label down to its box, if they are apart."""
    if box.y_min - place.y_max > (place.y_max - place.y_min) / 2:
        x = (box.x_min + box.x_max) / 2
        start = min(max(x, place.x_min + 1), place.x_max - 1), place.y_max
        tie = np.array((start, (x, box.y_min)))
        polyline(canvas, tie, bgr(colours.OBJECT[item.verdict]), 1, Pen.of(canvas.shape))


def draw_frame(frame: PerceivedFrame, metrics: FrameMetrics, since_start_s: float, width_px: int) -> Image:
    """``draw_results`` with a strip of the frame's numbers at the top.

    The picture has ``width_px`` columns; ``since_start_s`` are the seconds since the first frame.
    """
    rows, columns = frame.image_bgr.shape[:2]
    pen = Pen.of((max(round(rows * width_px / columns), 1), width_px))
    strip = lines_of((*frame_phrases(metrics, frame.objects, since_start_s), *LEGEND), pen)
    canvas = draw_results(frame, width_px, len(strip) * pen.row_px)
    draw_strip(canvas, strip)
    return canvas


def draw_strip(canvas: Image, strip: Sequence[Sequence[tuple[int, Phrase]]]) -> None:
    """Write lines of phrases, each with its first column, over the topmost rows of the image, (H, W, 3) uint8."""
    pen = Pen.of(canvas.shape)
    shaded = canvas[: len(strip) * pen.row_px]
    shaded[...] = cv2.addWeighted(shaded, 1 - _SHADE, np.full_like(shaded, DARK), _SHADE, 0)
    for row, line in enumerate(strip):
        for x, phrase in line:
            _draw_phrase(canvas, phrase, (x, row * pen.row_px), pen)


def _draw_phrase(canvas: Image, phrase: Phrase, at_px: tuple[int, int], pen: Pen) -> None:
    if not phrase.symbol:
        write(canvas, phrase.text, at_px, phrase.colour, pen)
        return
    x, y = at_px
    width, height = _symbol_size(pen)
    left, top = x + pen.margin_px, y + (pen.row_px - height) // 2
    _draw_symbol(canvas, phrase, Box(left, top, left + width - 1, top + height - 1), pen)
    write(canvas, phrase.text, (x + width + 2 * pen.margin_px, y), _PLAIN, pen)


def _draw_symbol(canvas: Image, entry: Phrase, place: Box, pen: Pen) -> None:
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
    yield Phrase(f"frame {metrics.frame}")
    yield Phrase(f"{since_start_s:.2f} s")
    yield from _lane("left", metrics.lane_left_status, metrics.lane_left_offset_m)
    yield from _lane("right", metrics.lane_right_status, metrics.lane_right_offset_m)
    if not isinstance(objects, Absent):
        yield from _objects(objects.nearest, objects.most_urgent)
    yield from _odometry(metrics)
    if metrics.surface_source is not None:
        yield Phrase(f"surface: {metrics.surface_source}")


def _lane(side: str, status: str | None, offset_m: float | None) -> Iterator[Phrase]:
    if status is not None:
        text = status if offset_m is None else f"{offset_m:+.2f} m"
        yield Phrase(f"lane {side} {text}", bgr(colours.BOUNDARY.get(status, colours.GREY)))


def _objects(nearest: Object | None, urgent: Object | None) -> Iterator[Phrase]:
    """The most urgent object, then the nearest: the smallest time to impact may belong to another object."""
    if urgent is not None and urgent is nearest:
        yield Phrase(f"nearest {_named(urgent)}, impact in {urgent.time_to_impact_s:.1f} s")
        return
    if urgent is not None:
        yield Phrase(f"impact: {_named(urgent)} in {urgent.time_to_impact_s:.1f} s")
    if nearest is not None:
        yield Phrase(f"nearest {_named(nearest)}")


def _named(item: Object) -> str:
    """Label, and distance if known."""
    name = item.detection.label or "object"
    return name if item.distance_m is None else f"{name} {item.distance_m:.1f} m"


def _odometry(metrics: FrameMetrics) -> Iterator[Phrase]:
    if metrics.step_m is not None:
        yield Phrase(f"step {metrics.step_m:.2f} m")
    elif metrics.odometry_status is not None:
        text = "without scale" if metrics.odometry_status == "tracked" else metrics.odometry_status
        yield Phrase(f"odometry {text}", bgr(colours.ORANGE) if metrics.odometry_status == "lost" else _PLAIN)


def lines_of(phrases: Iterable[Phrase], pen: Pen) -> list[list[tuple[int, Phrase]]]:
    """The phrases with their first columns, as many on a line as fit; a narrow image needs more lines."""
    lines: list[list[tuple[int, Phrase]]] = [[]]
    x = 0
    for phrase in phrases:
        width, _ = text_size(phrase.text, pen)
        if phrase.symbol:
            width += _symbol_size(pen)[0] + 2 * pen.margin_px
        if lines[-1] and x + width > pen.size[0]:
            lines.append([])
            x = 0
        lines[-1].append((x, phrase))
        x += width + round(_GAP_CHARACTERS * pen.text_px)
    return lines
