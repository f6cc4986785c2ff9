"""Pixels to draw into: lines, boxes and text, sized for the image they go into."""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from roadperc_stream.core.datatypes import Box, Image
from roadperc_stream.core.geometry import Float

Colour = tuple[int, int, int]
"""Blue, green, red, 0 to 255."""

BEHIND_TEXT: Final[Colour] = (25, 25, 25)
_LEAST_TEXT_PX: Final = 11
_TEXT_ROWS: Final = 40
"""A line of text takes this part of the image's rows, and ``_LEAST_TEXT_PX`` at least."""
_LINE_ROWS: Final = 200
_SUBPIXEL_BITS: Final = 4
_FAR_OUT: Final = 4
"""Points farther outside than this many image sizes are drawn there: OpenCV's integers end somewhere."""


@dataclass(frozen=True)
class Pen:
    """What fits an image's size: (columns, rows), the scale of the pixels drawn into it, widths in pixels."""

    size: tuple[int, int]
    scale: float
    line_px: int
    text_px: int

    @classmethod
    def of(cls, image: Image, scale: float) -> "Pen":
        """A pen for an image, into which pixels go that were ``1 / scale`` times as many."""
        rows, columns = image.shape[:2]
        line_px = max(round(rows / _LINE_ROWS), 1)
        return cls((columns, rows), scale, line_px, max(round(rows / _TEXT_ROWS), _LEAST_TEXT_PX))

    def scaled(self, pixels: Float) -> Float:
        """(N, 2) pixels of the original in the copy: pixel centres are whole numbers in both."""
        return np.asarray((pixels + 0.5) * self.scale - 0.5, float)

    @property
    def row_px(self) -> int:
        """Rows a line of text takes with a little room around it."""
        return round(1.25 * self.text_px)


def resized(image_bgr: Image, scale: float) -> Image:
    """A copy of the image, ``scale`` times as large."""
    if scale == 1.0:
        return image_bgr.copy()
    rows, columns = image_bgr.shape[:2]
    size = max(round(columns * scale), 1), max(round(rows * scale), 1)
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return cv2.resize(image_bgr, size, interpolation=method).astype(np.uint8, copy=False)


def dashes(
    start: tuple[float, float], end: tuple[float, float], length_px: float
) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Every other piece of about ``length_px`` of a line, the first and the last among them."""
    a, b = np.array(start), np.array(end)
    pieces = 2 * int(np.linalg.norm(b - a) / (2 * length_px)) + 1
    points = [a + (b - a) * k / pieces for k in range(pieces + 1)]
    return [((points[k][0], points[k][1]), (points[k + 1][0], points[k + 1][1])) for k in range(0, pieces, 2)]


def scaled_box(box: Box, pen: Pen) -> Box:
    """The box in the copy's pixels, its corners those of the outermost pixels inside, clipped to the image."""
    corners = np.array([(box.x_min, box.y_min), (box.x_max - 1, box.y_max - 1)])
    (x0, y0), (x1, y1) = np.clip(pen.scaled(corners), 0, np.array(pen.size) - 1)
    return Box(float(x0), float(y0), float(x1), float(y1))


def text_size(canvas: Image, text: str, pen: Pen) -> tuple[int, int]:
    """Columns and rows a text takes with a little room around it."""
    _, _, width, _ = cv2.getTextSize(canvas.shape[1::-1], text, (0, 0), _face(), pen.text_px)
    return width + 4, pen.row_px


def write(canvas: Image, text: str, at_px: tuple[float, float], colour: Colour, pen: Pen) -> None:
    """A line of text; ``at_px`` is the top left corner of the room it takes."""
    left, baseline = round(at_px[0]) + 2, round(at_px[1] + 0.95 * pen.text_px)
    cv2.putText(canvas, text, (left, baseline), colour, _face(), pen.text_px)


def _face() -> cv2.FontFace:
    """OpenCV's built-in sans: unlike the stroke fonts it stays legible when small, and knows more than ASCII."""
    return cv2.FontFace("sans")


def polyline(canvas: Image, pixels: Float, colour: Colour, thickness_px: int, pen: Pen) -> None:
    """A line through (N, 2) pixels; points that are not finite are left out."""
    inside = pen.scaled(pixels[np.isfinite(pixels).all(axis=1)])
    reach = _FAR_OUT * max(pen.size)
    fixed = np.rint(np.clip(inside, -reach, reach) * 2**_SUBPIXEL_BITS).astype(np.int32)
    cv2.polylines(canvas, [fixed], False, colour, thickness_px, cv2.LINE_AA, _SUBPIXEL_BITS)


def whole(point: tuple[float, float]) -> tuple[int, int]:
    """The nearest pixel."""
    return round(point[0]), round(point[1])
