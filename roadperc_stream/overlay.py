"""A camera image with what the chain saw drawn into it: for reports, videos and an eye's check.

Viewers draw their own (``drawing`` writes what they need); here the drawing becomes pixels, sized for the image it goes
into, so that a thumbnail's text is as easy to read as a full frame's.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from roadperc_stream.datatypes import Absent, Box, Image, Lanes, Mask, Object, Objects
from roadperc_stream.drawing import caption
from roadperc_stream.geometry import Float

Colour = tuple[int, int, int]
"""Blue, green, red, 0 to 255."""

_DRIVABLE: Final[Colour] = (220, 130, 30)
_TINT: Final = 0.28
_MEASURED: Final[Colour] = (70, 230, 40)
_HELD: Final[Colour] = (0, 150, 255)
_RAW: Final[Colour] = (30, 230, 255)
_KEPT: Final[Colour] = (70, 230, 40)
_UNJUDGED: Final[Colour] = (30, 230, 255)
_DROPPED: Final[Colour] = (170, 170, 170)
_BEHIND_TEXT: Final[Colour] = (25, 25, 25)
_STATUS_COLOURS: Final = {"measured": _MEASURED, "held": _HELD}
_LEAST_TEXT_PX: Final = 11
_TEXT_ROWS: Final = 40
"""A line of text takes this part of the image's rows, and ``_LEAST_TEXT_PX`` at least."""
_LINE_ROWS: Final = 200
_SUBPIXEL_BITS: Final = 4
_FAR_OUT: Final = 4
"""Points farther outside than this many image sizes are drawn there: OpenCV's integers end somewhere."""


@dataclass(frozen=True)
class _Pen:
    """What fits an image's size: (columns, rows), the scale of the pixels drawn into it, widths in pixels."""

    size: tuple[int, int]
    scale: float
    line_px: int
    text_px: int

    @classmethod
    def of(cls, image: Image, scale: float) -> "_Pen":
        rows, columns = image.shape[:2]
        line_px = max(round(rows / _LINE_ROWS), 1)
        return cls((columns, rows), scale, line_px, max(round(rows / _TEXT_ROWS), _LEAST_TEXT_PX))


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
    canvas = _resized(image_bgr, scale)
    pen = _Pen.of(canvas, scale)
    if not isinstance(drivable, Absent):
        _require_same_size(image_bgr, drivable)
        _tint(canvas, drivable, pen)
    if not isinstance(lanes, Absent):
        _draw_lanes(canvas, lanes, pen)
    if not isinstance(objects, Absent):
        _draw_objects(canvas, objects.objects, pen)
    return canvas


def _resized(image_bgr: Image, scale: float) -> Image:
    if scale == 1.0:
        return image_bgr.copy()
    rows, columns = image_bgr.shape[:2]
    size = max(round(columns * scale), 1), max(round(rows * scale), 1)
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return cv2.resize(image_bgr, size, interpolation=method).astype(np.uint8, copy=False)


def _require_same_size(image_bgr: Image, drivable: Mask) -> None:
    if drivable.shape != image_bgr.shape[:2]:
        raise ValueError(f"drivable: expected the image's {image_bgr.shape[:2]} pixels, got {drivable.shape}")


def _tint(canvas: Image, drivable: Mask, pen: _Pen) -> None:
    mask = cv2.resize(drivable.astype(np.uint8), pen.size, interpolation=cv2.INTER_NEAREST).astype(bool)
    mixed = (1 - _TINT) * canvas[mask] + _TINT * np.array(_DRIVABLE, float)
    canvas[mask] = np.rint(mixed).astype(np.uint8)


def _draw_lanes(canvas: Image, lanes: Lanes, pen: _Pen) -> None:
    for boundary in lanes.boundaries:
        if boundary.status in _STATUS_COLOURS and len(boundary.line_px):
            _polyline(canvas, boundary.line_px, _STATUS_COLOURS[boundary.status], 2 * pen.line_px, pen)
    # Thin over broad: the raw line is what the smoothed one is compared with.
    for boundary in lanes.boundaries:
        if boundary.raw_px is not None:
            _polyline(canvas, np.array(boundary.raw_px).reshape(2, 2), _RAW, max(pen.line_px // 2, 1), pen)


def _draw_objects(canvas: Image, objects: Sequence[Object], pen: _Pen) -> None:
    """Boxes from far to near, then text where it finds room, from near to far: the nearest matter most."""
    near_first = sorted(objects, key=_nearness)
    for item in reversed(near_first):
        _draw_box(canvas, item, pen)
    taken: list[Box] = []
    for item in near_first:
        place = _label_place(canvas, item, taken, pen)
        if place is not None:
            taken.append(place)
            _draw_label(canvas, item, place, pen)


def _nearness(item: Object) -> tuple[bool, float]:
    return not item.kept, np.inf if item.distance_m is None else item.distance_m


def _draw_box(canvas: Image, item: Object, pen: _Pen) -> None:
    box = _scaled_box(item.detection.box_px, pen)
    corners = [(box.x_min, box.y_min), (box.x_max, box.y_min), (box.x_max, box.y_max), (box.x_min, box.y_max)]
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        pieces = [(start, end)] if item.kept else _dashes(start, end, 4.0 * pen.line_px)
        for a, b in pieces:
            cv2.line(canvas, _whole(a), _whole(b), _colour_of(item), pen.line_px)


def _dashes(
    start: tuple[float, float], end: tuple[float, float], length_px: float
) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Every other piece of about ``length_px`` of a line, the first and the last among them."""
    a, b = np.array(start), np.array(end)
    pieces = 2 * int(np.linalg.norm(b - a) / (2 * length_px)) + 1
    points = [a + (b - a) * k / pieces for k in range(pieces + 1)]
    return [((points[k][0], points[k][1]), (points[k + 1][0], points[k + 1][1])) for k in range(0, pieces, 2)]


def _scaled_box(box: Box, pen: _Pen) -> Box:
    """The box in the copy's pixels, its corners those of the outermost pixels inside, clipped to the image."""
    corners = np.array([(box.x_min, box.y_min), (box.x_max - 1, box.y_max - 1)])
    (x0, y0), (x1, y1) = np.clip(_scaled(corners, pen), 0, np.array(pen.size) - 1)
    return Box(float(x0), float(y0), float(x1), float(y1))


def _colour_of(item: Object) -> Colour:
    if not item.kept:
        return _DROPPED
    return _UNJUDGED if item.class_ratio is None else _KEPT


def _label_place(canvas: Image, item: Object, taken: Iterable[Box], pen: _Pen) -> Box | None:
    """Where the text goes: above the box, inside at its top or below it, whichever is free; None where none is."""
    box = _scaled_box(item.detection.box_px, pen)
    width, height = _text_size(canvas, caption(item), pen)
    columns, rows = pen.size
    x = float(np.clip(box.x_min, 0, max(columns - width, 0)))
    taken = tuple(taken)
    for y in (box.y_min - height, box.y_min, box.y_max):
        place = Box(x, y, x + width, y + height)
        if 0 <= y <= rows - height and not any(place.overlap(other) for other in taken):
            return place
    return None


def _draw_label(canvas: Image, item: Object, place: Box, pen: _Pen) -> None:
    start, end = _whole((place.x_min, place.y_min)), _whole((place.x_max, place.y_max))
    cv2.rectangle(canvas, start, end, _BEHIND_TEXT, cv2.FILLED)
    baseline = round(place.y_min + 0.95 * pen.text_px)
    cv2.putText(canvas, caption(item), (start[0] + 2, baseline), _colour_of(item), _face(), pen.text_px)


def _text_size(canvas: Image, text: str, pen: _Pen) -> tuple[int, int]:
    """Columns and rows a text takes with a little room around it."""
    _, _, width, _ = cv2.getTextSize(canvas.shape[1::-1], text, (0, 0), _face(), pen.text_px)
    return width + 4, round(1.25 * pen.text_px)


def _face() -> cv2.FontFace:
    """OpenCV's built-in sans: unlike the stroke fonts it stays legible when small, and knows more than ASCII."""
    return cv2.FontFace("sans")


def _polyline(canvas: Image, pixels: Float, colour: Colour, thickness_px: int, pen: _Pen) -> None:
    """A line through (N, 2) pixels; points that are not finite are left out."""
    scaled = _scaled(pixels[np.isfinite(pixels).all(axis=1)], pen)
    reach = _FAR_OUT * max(pen.size)
    fixed = np.rint(np.clip(scaled, -reach, reach) * 2**_SUBPIXEL_BITS).astype(np.int32)
    cv2.polylines(canvas, [fixed], False, colour, thickness_px, cv2.LINE_AA, _SUBPIXEL_BITS)


def _scaled(pixels: Float, pen: _Pen) -> Float:
    """(N, 2) pixels of the original in the copy: pixel centres are whole numbers in both."""
    return np.asarray((pixels + 0.5) * pen.scale - 0.5, float)


def _whole(point: tuple[float, float]) -> tuple[int, int]:
    return round(point[0]), round(point[1])
