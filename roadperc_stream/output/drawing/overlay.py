"""A camera image with what the chain saw drawn into it: for reports, videos and an eye's check.

Viewers draw their own (``drawing`` writes what they need); here the drawing becomes pixels, sized for the image it goes
into, so that a thumbnail's text is as easy to read as a full frame's.
"""

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from roadperc_stream.core.datatypes import Absent, Box, Image, Lanes, Mask, Object, Objects
from roadperc_stream.output.drawing import colours
from roadperc_stream.output.drawing.annotations import caption
from roadperc_stream.output.drawing.canvas import (
    BEHIND_TEXT,
    Pen,
    dashes,
    polyline,
    resized,
    scaled_box,
    text_size,
    whole,
    write,
)
from roadperc_stream.output.drawing.captions import by_nearness, caption_places
from roadperc_stream.output.drawing.colours import bgr

_TINT: Final = 0.28
_LEVELS: Final = np.arange(256)[None, :, None]
_TINTED: Final = np.rint((1 - _TINT) * _LEVELS + _TINT * np.array(bgr(colours.DRIVABLE))).astype(np.uint8)
"""(1, 256, 3) what each level of each colour becomes where the road is drivable."""


def draw_overlay(
    image_bgr: Image,
    lanes: Lanes | Absent,
    objects: Objects | Absent,
    drivable: Mask | Absent,
    *,
    width_px: int | None = None,
) -> Image:
    """A copy of the image with the frame's results drawn into it; what is absent is not drawn.

    The drivable pixels are tinted blue; a lane boundary is a broad line along the smoothed curve, green where measured
    and orange where held, with the raw line thin and yellow; kept objects have a solid box with label, distance and
    time to impact, yellow where nothing could judge them; dropped ones a dashed grey box.

    Args:
        image_bgr: (H, W, 3) the camera image the results belong to.
        lanes: the ego lane's boundaries, in pixels of ``image_bgr``.
        objects: the detections, boxes in pixels of ``image_bgr``.
        drivable: (H, W) the drivable pixels.
        width_px: columns of the copy, None for those of ``image_bgr``; lines and text are sized for the copy.

    Returns:
        (H * width_px / W, width_px, 3) uint8, blue, green, red.

    Raises:
        ValueError: the mask is not of the image's size.
    """
    scale = 1.0 if width_px is None else width_px / image_bgr.shape[1]
    canvas = resized(image_bgr, scale)
    pen = Pen.of(canvas, scale)
    if not isinstance(drivable, Absent):
        _require_same_size(image_bgr, drivable)
        _tint(canvas, drivable, pen)
    if not isinstance(lanes, Absent):
        _draw_lanes(canvas, lanes, pen)
    if not isinstance(objects, Absent):
        _draw_objects(canvas, objects.objects, pen)
    return canvas


def _require_same_size(image_bgr: Image, drivable: Mask) -> None:
    if drivable.shape != image_bgr.shape[:2]:
        raise ValueError(f"drivable: expected the image's {image_bgr.shape[:2]} pixels, got {drivable.shape}")


def _tint(canvas: Image, drivable: Mask, pen: Pen) -> None:
    mask = cv2.resize(drivable.astype(np.uint8), pen.size, interpolation=cv2.INTER_NEAREST)
    cv2.copyTo(cv2.LUT(canvas, _TINTED), mask, canvas)


def _draw_lanes(canvas: Image, lanes: Lanes, pen: Pen) -> None:
    for boundary in lanes.boundaries:
        if boundary.status != "lost" and len(boundary.line_px):
            polyline(canvas, boundary.line_px, bgr(colours.BOUNDARY[boundary.status]), 2 * pen.line_px, pen)
    # Thin over broad: the raw line is what the smoothed one is compared with.
    for boundary in lanes.boundaries:
        if boundary.raw_px is not None:
            polyline(
                canvas, np.array(boundary.raw_px).reshape(2, 2), bgr(colours.RAW_LINE), max(pen.line_px // 2, 1), pen
            )


def _draw_objects(canvas: Image, objects: Sequence[Object], pen: Pen) -> None:
    """Boxes from far to near, then the captions that find room."""
    for index in reversed(by_nearness(objects)):
        _draw_box(canvas, objects[index], pen)
    boxes = [scaled_box(item.detection.box_px, pen) for item in objects]
    text_sizes = [text_size(canvas, caption(item), pen) for item in objects]
    places = caption_places(pen.size, objects, boxes, text_sizes)
    for item, place in zip(objects, places, strict=True):
        if place is not None:
            _draw_label(canvas, item, place, pen)


def _draw_box(canvas: Image, item: Object, pen: Pen) -> None:
    box = scaled_box(item.detection.box_px, pen)
    corners = [(box.x_min, box.y_min), (box.x_max, box.y_min), (box.x_max, box.y_max), (box.x_min, box.y_max)]
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        pieces = [(start, end)] if item.kept else dashes(start, end, 4.0 * pen.line_px)
        for a, b in pieces:
            cv2.line(canvas, whole(a), whole(b), bgr(colours.OBJECT[item.verdict]), pen.line_px)


def _draw_label(canvas: Image, item: Object, place: Box, pen: Pen) -> None:
    start, end = whole((place.x_min, place.y_min)), whole((place.x_max, place.y_max))
    cv2.rectangle(canvas, start, end, BEHIND_TEXT, cv2.FILLED)
    write(canvas, caption(item), start, bgr(colours.OBJECT[item.verdict]), pen)
