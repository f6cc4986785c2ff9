"""Draws the results into a camera image, for reports and videos.

Lines and text are sized for the target image, so the text of a thumbnail is as legible as that of a full frame.
Viewers draw the results themselves, from the messages of ``drawing.annotations``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from roadperc_stream.model import Absent, Box, Image, Lanes, Mask, Object, Objects
from roadperc_stream.output.drawing import colours
from roadperc_stream.output.drawing.annotations import caption
from roadperc_stream.output.drawing.canvas import (
    Pen,
    box_outline,
    dashed_line,
    edged_lines,
    polyline,
    resized,
    scaled_box,
    text_size,
    write_on_plate,
)
from roadperc_stream.output.drawing.captions import by_nearness, label_places
from roadperc_stream.output.drawing.colours import bgr
from roadperc_stream.output.drawing.strip import draw_strip, lay_out_strip
from roadperc_stream.schemas.columns import FrameMetrics

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

    Raises:
        ValueError: the sizes of mask and image differ.
    """
    scale = width_px / frame.image_bgr.shape[1]
    canvas = resized(frame.image_bgr, scale)
    if not frame.fits:
        return canvas
    pen = Pen.of(canvas, scale)
    if not isinstance(frame.drivable, Absent):
        if frame.drivable.shape != frame.image_bgr.shape[:2]:
            raise ValueError(
                f"drivable: expected the image's {frame.image_bgr.shape[:2]} pixels, got {frame.drivable.shape}"
            )
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
        polyline(canvas, np.array((start, (x, box.y_min))), bgr(colours.OBJECT[item.verdict]), 1, Pen.of(canvas))


def draw_frame(frame: PerceivedFrame, metrics: FrameMetrics, since_start_s: float, width_px: int) -> Image:
    """``draw_results`` with a strip of the frame's numbers at the top.

    The picture has ``width_px`` columns; ``since_start_s`` are the seconds since the first frame.
    """
    rows, columns = frame.image_bgr.shape[:2]
    pen = Pen.of_size(columns=width_px, rows=max(round(rows * width_px / columns), 1))
    strip = lay_out_strip(pen, metrics, frame.objects, since_start_s)
    canvas = draw_results(frame, width_px, len(strip) * pen.row_px)
    draw_strip(canvas, strip)
    return canvas
