"""Draws the results into a camera image, for reports and videos.

Lines and text are sized for the target image, so the text of a thumbnail is as legible as that of a full frame.
Viewers draw the results themselves, from the messages of ``drawing.annotations``. The strip at the top of a frame has
its numbers and the legend.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final, Literal

import cv2
import numpy as np

from roadperc_stream.model import Absent, Box, Image, Lanes, Mask, Object, Objects
from roadperc_stream.output.drawing import colours
from roadperc_stream.output.drawing.annotations import caption
from roadperc_stream.output.drawing.canvas import DARK, Canvas, Colour
from roadperc_stream.output.drawing.captions import by_nearness, label_places
from roadperc_stream.output.drawing.colours import bgr
from roadperc_stream.schemas.columns import FrameMetrics

_PLAIN: Final[Colour] = (240, 240, 240)
_SHADE: Final = 0.7
_GAP_CHARACTERS: Final = 0.6
"""Gap between two phrases, in heights of the text."""
_SYMBOL_DASHES: Final = 4.0
_MOST_COVERED: Final = 0.15
"""Share of the image that numbers and legend may cover; a small image has no legend."""


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
    canvas = Canvas.resized(frame.image_bgr, width_px / frame.image_bgr.shape[1])
    _draw_into(canvas, frame, top_px)
    return canvas.pixels


def _draw_into(canvas: Canvas, frame: PerceivedFrame, top_px: int) -> None:
    if not frame.fits:
        return
    if not isinstance(frame.drivable, Absent):
        mask = cv2.resize(frame.drivable.astype(np.uint8), canvas.size, interpolation=cv2.INTER_NEAREST)
        cv2.copyTo(cv2.LUT(canvas.pixels, _TINTED), mask, canvas.pixels)
    if not isinstance(frame.lanes, Absent):
        _draw_lanes(canvas, frame.lanes)
    if not isinstance(frame.objects, Absent):
        _draw_objects(canvas, frame.objects.objects, top_px)


def _draw_lanes(canvas: Canvas, lanes: Lanes) -> None:
    for boundary in lanes.boundaries:
        if boundary.status != "lost" and len(boundary.line_px):
            canvas.edged_lines([boundary.line_px], bgr(colours.BOUNDARY[boundary.status]), canvas.broad_px)
    # The thin raw line is on top of the broad smoothed one, so that both can be compared.
    for boundary in lanes.boundaries:
        if boundary.raw_px is not None:
            ends = np.array(boundary.raw_px).reshape(2, 2)
            canvas.dashed_line(ends, bgr(colours.RAW_LINE), canvas.thin_px, _RAW_DASH * canvas.line_px)


def _draw_objects(canvas: Canvas, objects: Sequence[Object], top_px: int) -> None:
    """Draw boxes from far to near, then labels that have a place, with a line to boxes that are not next to them."""
    boxes = [canvas.scaled_box(item.detection.box_px) for item in objects]
    for index in reversed(by_nearness(objects)):
        _draw_box(canvas, objects[index], boxes[index])
    text_sizes = [canvas.text_size(caption(item)) for item in objects]
    places = label_places(canvas.size, top_px, objects, boxes, text_sizes)
    found = zip(objects, boxes, places, strict=True)
    labelled = [(item, box, place) for item, box, place in found if place is not None and caption(item)]
    for item, box, place in labelled:
        _draw_tie(canvas, item, box, place)
    for item, _, place in labelled:
        canvas.write_on_plate(caption(item), (place.x_min, place.y_min), bgr(colours.OBJECT[item.verdict]))


def _draw_box(canvas: Canvas, item: Object, box: Box) -> None:
    """Draw a box; a small one has thin lines, so that the object stays visible."""
    side_px = min(box.x_max - box.x_min, box.y_max - box.y_min)
    thickness_px = max(min(canvas.line_px, round(side_px / _BOX_LINE)), 1)
    dash_px = None if item.kept else _BOX_DASH * canvas.line_px
    canvas.box_outline(box, bgr(colours.OBJECT[item.verdict]), thickness_px, dash_px)


def _draw_tie(canvas: Canvas, item: Object, box: Box, place: Box) -> None:
    """Draw a thin line from a label down to its box, if they are apart."""
    if box.y_min - place.y_max > (place.y_max - place.y_min) / 2:
        x = (box.x_min + box.x_max) / 2
        start = min(max(x, place.x_min + 1), place.x_max - 1), place.y_max
        tie = np.array((start, (x, box.y_min)))
        canvas.unscaled().polyline(tie, bgr(colours.OBJECT[item.verdict]), 1)


def draw_frame(frame: PerceivedFrame, metrics: FrameMetrics, since_start_s: float, width_px: int) -> Image:
    """``draw_results`` with a strip of the frame's numbers and the legend at the top.

    The picture has ``width_px`` columns; ``since_start_s`` are the seconds since the first frame.
    """
    return draw_captioned(frame, tuple(frame_phrases(metrics, frame.objects, since_start_s)), width_px)


def draw_captioned(frame: PerceivedFrame, phrases: Sequence[Phrase], width_px: int) -> Image:
    """``draw_results`` with a strip of phrases and the legend at the top, without the legend if it needs much space."""
    canvas = Canvas.resized(frame.image_bgr, width_px / frame.image_bgr.shape[1])
    strip = lines_of((*phrases, *legend_of(frame)), canvas)
    if len(strip) * canvas.row_px > _MOST_COVERED * canvas.size[1]:
        strip = lines_of(phrases, canvas)
    _draw_into(canvas, frame, len(strip) * canvas.row_px)
    draw_strip(canvas.unscaled(), strip)
    return canvas.pixels


def legend_of(frame: PerceivedFrame) -> Iterator[Phrase]:
    """The legend of the results that the frame has."""
    parts = (frame.drivable, LEGEND[:1]), (frame.lanes, LEGEND[1:4]), (frame.objects, LEGEND[4:])
    for result, entries in parts:
        if frame.fits and not isinstance(result, Absent):
            yield from entries


def draw_strip(canvas: Canvas, strip: Sequence[Sequence[tuple[int, Phrase]]]) -> None:
    """Write lines of phrases, each with its first column, over the topmost rows of the image."""
    shaded = canvas.pixels[: len(strip) * canvas.row_px]
    shaded[...] = cv2.addWeighted(shaded, 1 - _SHADE, np.full_like(shaded, DARK), _SHADE, 0)
    for row, line in enumerate(strip):
        for x, phrase in line:
            _draw_phrase(canvas, phrase, (x, row * canvas.row_px))


def _draw_phrase(canvas: Canvas, phrase: Phrase, at_px: tuple[int, int]) -> None:
    if not phrase.symbol:
        canvas.write(phrase.text, at_px, phrase.colour)
        return
    x, y = at_px
    width, height = _symbol_size(canvas)
    left, top = x + canvas.margin_px, y + (canvas.row_px - height) // 2
    _draw_symbol(canvas, phrase, Box(left, top, left + width - 1, top + height - 1))
    canvas.write(phrase.text, (x + width + 2 * canvas.margin_px, y), _PLAIN)


def _draw_symbol(canvas: Canvas, entry: Phrase, place: Box) -> None:
    """Draw a sample of the overlay's drawing, at the same line width."""
    y = (place.y_min + place.y_max) / 2
    dash_px = (place.x_max - place.x_min) / _SYMBOL_DASHES
    ends = np.array(((place.x_min, y), (place.x_max, y)))
    if entry.symbol == "area":
        first, last = (int(place.x_min), int(place.y_min)), (int(place.x_max), int(place.y_max))
        cv2.rectangle(canvas.pixels, first, last, entry.colour, cv2.FILLED)
    elif entry.symbol == "line":
        canvas.edged_lines([ends], entry.colour, canvas.broad_px)
    elif entry.symbol == "dashed line":
        canvas.dashed_line(ends, entry.colour, canvas.thin_px, dash_px)
    else:
        canvas.box_outline(place, entry.colour, canvas.thin_px, dash_px if entry.symbol == "dashed box" else None)


def _symbol_size(canvas: Canvas) -> tuple[int, int]:
    return round(1.4 * canvas.text_px), round(0.6 * canvas.text_px)


def frame_phrases(metrics: FrameMetrics, objects: Objects | Absent, since_start_s: float) -> Iterator[Phrase]:
    """Phrases of a frame's row and of its nearest and most urgent objects, the most important numbers first."""
    yield Phrase(f"frame {metrics.frame}")
    yield Phrase(f"{since_start_s:.2f} s")
    yield from _lane("left", metrics.lane_left_status, metrics.lane_left_offset_m)
    yield from _lane("right", metrics.lane_right_status, metrics.lane_right_offset_m)
    if metrics.lane_left_status is None and metrics.lane_right_status is None:
        yield from _why_absent("lanes", metrics)
    if isinstance(objects, Absent):
        yield from _why_absent("objects", metrics)
    else:
        yield from _objects(objects.nearest, objects.most_urgent)
    yield from _odometry(metrics)
    if metrics.surface_source is not None:
        yield Phrase(f"surface: {metrics.surface_source}")


def _lane(side: str, status: str | None, offset_m: float | None) -> Iterator[Phrase]:
    if status is not None:
        text = status if offset_m is None else f"{offset_m:+.2f} m"
        yield Phrase(f"lane {side} {text}", bgr(colours.BOUNDARY.get(status, colours.GREY)))


def _why_absent(stage: str, metrics: FrameMetrics) -> Iterator[Phrase]:
    reasons = (Phrase(str(reason), bgr(colours.GREY)) for reason in metrics.reasons if reason.source == stage)
    yield from islice(reasons, 1)


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


def lines_of(phrases: Iterable[Phrase], canvas: Canvas) -> list[list[tuple[int, Phrase]]]:
    """The phrases with their first columns, as many on a line as fit; a narrow image needs more lines."""
    lines: list[list[tuple[int, Phrase]]] = [[]]
    x = 0
    for phrase in phrases:
        width, _ = canvas.text_size(phrase.text)
        if phrase.symbol:
            width += _symbol_size(canvas)[0] + 2 * canvas.margin_px
        if lines[-1] and x + width > canvas.size[0]:
            lines.append([])
            x = 0
        lines[-1].append((x, phrase))
        x += width + round(_GAP_CHARACTERS * canvas.text_px)
    return lines
