"""Draws the results into a camera image, for reports and videos.

Viewers draw their own (``drawing`` writes what they need); here the drawing becomes pixels, sized for the image it goes
into, so that a thumbnail's text is as easy to read as a full frame's.
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
"""(1, 256, 3) what each level of each colour becomes where the road is drivable."""
_RAW_DASH: Final = 7.0
_BOX_DASH: Final = 4.0
"""Length of a dash by a line's width."""
_BOX_LINE: Final = 12.0
"""A box's line is its smaller side by this, as long as that is thinner than other lines."""


@dataclass(frozen=True)
class PerceivedFrame:
    """A camera image, (H, W, 3), and its results.

    ``fits`` says whether the image is of the size its calibration, and so all the results, speak of.
    """

    image_bgr: Image
    lanes: Lanes | Absent
    objects: Objects | Absent
    drivable: Mask | Absent
    fits: bool = True


def draw_results(frame: PerceivedFrame, width_px: int, top_px: int = 0) -> Image:
    """A copy of the image with the frame's results drawn in; what is absent is not drawn.

    The drivable pixels are tinted blue; a lane boundary is a broad line along the smoothed curve, green where measured
    and orange where held, with the raw line thin, dashed and yellow; kept objects have a solid box with label, distance
    and time to impact, yellow where nothing could judge them; dropped ones a dashed grey box. An image that does not
    fit the results stays bare.

    Args:
        frame: what is drawn.
        width_px: columns of the copy, for which lines and text are sized.
        top_px: rows at the copy's top where no label goes.

    Returns:
        (H * width_px / W, width_px, 3) uint8, blue, green, red.

    Raises:
        ValueError: the mask is not of the image's size.
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
    # Thin over broad: the raw line is what the smoothed one is compared with.
    for boundary in lanes.boundaries:
        if boundary.raw_px is not None:
            ends = np.array(boundary.raw_px).reshape(2, 2)
            dashed_line(canvas, ends, bgr(colours.RAW_LINE), pen.thin_px, _RAW_DASH * pen.line_px, pen)


def _draw_objects(canvas: Image, objects: Sequence[Object], pen: Pen, top_px: int) -> None:
    """Boxes from far to near, then the labels that find a place, tied to their boxes where they are apart."""
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
    """A small object has thin lines: it is to be seen as well."""
    side_px = min(box.x_max - box.x_min, box.y_max - box.y_min)
    thickness_px = max(min(pen.line_px, round(side_px / _BOX_LINE)), 1)
    dash_px = None if item.kept else _BOX_DASH * pen.line_px
    box_outline(canvas, box, bgr(colours.OBJECT[item.verdict]), thickness_px, pen, dash_px)


def _draw_tie(canvas: Image, item: Object, box: Box, place: Box) -> None:
    """A thin line from a label's lower edge to the box below it that is not at the label."""
    if box.y_min - place.y_max > (place.y_max - place.y_min) / 2:
        x = (box.x_min + box.x_max) / 2
        start = min(max(x, place.x_min + 1), place.x_max - 1), place.y_max
        polyline(canvas, np.array((start, (x, box.y_min))), bgr(colours.OBJECT[item.verdict]), 1, Pen.of(canvas))


def draw_frame(frame: PerceivedFrame, metrics: FrameMetrics, since_start_s: float, width_px: int) -> Image:
    """``draw_results`` with the frame's numbers above.

    Args:
        frame: what is drawn.
        metrics: its row.
        since_start_s: its time, from the first frame.
        width_px: columns of the picture.
    """
    rows, columns = frame.image_bgr.shape[:2]
    pen = Pen.of_size(columns=width_px, rows=max(round(rows * width_px / columns), 1))
    strip = lay_out_strip(pen, metrics, frame.objects, since_start_s)
    canvas = draw_results(frame, width_px, len(strip) * pen.row_px)
    draw_strip(canvas, strip)
    return canvas
