"""Draws lines, boxes and text into an image, at sizes that fit the image."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from roadperc_stream.geometry import Float
from roadperc_stream.model import Box, Image

Colour = tuple[int, int, int]
"""Blue, green, red, 0 to 255."""
Point = tuple[float, float]
"""Column and row."""

DARK: Final[Colour] = (25, 25, 25)
"""Drawn behind text and on both sides of lines, for contrast on any background."""
_LEAST_TEXT_PX: Final = 11
_TEXT_ROWS: Final = 45
"""The image height is divided by this for the text height, ``_LEAST_TEXT_PX`` or more."""
_TEXT_WEIGHT: Final = 500
"""Medium. OpenCV's glyph cache ignores the weight: with two weights, pixels would depend on earlier texts."""
_LINE_ROWS: Final = 320
_SUBPIXEL_BITS: Final = 4
_FAR_OUT: Final = 4
"""Points are clipped to this many image sizes, because OpenCV's integers overflow."""


@dataclass(frozen=True)
class Pen:
    """Widths in pixels for an image of ``size`` (columns, rows), and the scale from original pixels to this image."""

    size: tuple[int, int]
    scale: float
    line_px: int
    text_px: int

    @classmethod
    def of(cls, shape: tuple[int, ...], scale: float = 1.0) -> "Pen":
        """A pen for an image of this shape (rows, columns, ...), ``scale`` times as large as the original."""
        rows, columns = shape[:2]
        line_px = max(round(rows / _LINE_ROWS), 1)
        return cls((columns, rows), scale, line_px, max(round(rows / _TEXT_ROWS), _LEAST_TEXT_PX))

    def scaled(self, pixels: Float) -> Float:
        """(N, 2) pixels of the copy from pixels of the original; pixel centres are integers in both."""
        return np.asarray((pixels + 0.5) * self.scale - 0.5, float)

    @property
    def broad_px(self) -> int:
        """Width of the most important lines."""
        return 2 * self.line_px

    @property
    def thin_px(self) -> int:
        """Width of lines over or beside the broad ones."""
        return max(self.line_px - 1, 1)

    @property
    def row_px(self) -> int:
        """Height of a line of text with its margin."""
        return round(1.3 * self.text_px)

    @property
    def margin_px(self) -> int:
        """Free columns at either end of a text."""
        return max(round(0.25 * self.text_px), 2)

    @property
    def edge_px(self) -> int:
        """Width of the dark edge on either side of a line; 0 in small images."""
        return self.line_px // 2


def resized(image_bgr: Image, scale: float) -> Image:
    """A copy of the image, ``scale`` times as large."""
    if scale == 1.0:
        return image_bgr.copy()
    rows, columns = image_bgr.shape[:2]
    size = max(round(columns * scale), 1), max(round(rows * scale), 1)
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return cv2.resize(image_bgr, size, interpolation=method).astype(np.uint8, copy=False)


def dashes(start: Point, end: Point, length_px: float) -> list[tuple[Point, Point]]:
    """Every second piece of a line, each about ``length_px`` long, including the first and the last."""
    a, b = np.array(start), np.array(end)
    pieces = 2 * int(np.linalg.norm(b - a) / (2 * length_px)) + 1
    points = [a + (b - a) * k / pieces for k in range(pieces + 1)]
    return [((points[k][0], points[k][1]), (points[k + 1][0], points[k + 1][1])) for k in range(0, pieces, 2)]


def scaled_box(box: Box, pen: Pen) -> Box:
    """The box in pixels of the copy, clipped to the image; its corners are its outermost pixels."""
    corners = np.array([(box.x_min, box.y_min), (box.x_max - 1, box.y_max - 1)])
    (x0, y0), (x1, y1) = np.clip(pen.scaled(corners), 0, np.array(pen.size) - 1)
    return Box(float(x0), float(y0), float(x1), float(y1))


def text_size(text: str, pen: Pen) -> tuple[int, int]:
    """Columns and rows of a text with its margin."""
    _, _, width, _ = cv2.getTextSize(pen.size, text, (0, 0), _face(), pen.text_px, _TEXT_WEIGHT)
    return width + 2 * pen.margin_px, pen.row_px


def write(canvas: Image, text: str, at_px: Point, colour: Colour, pen: Pen) -> None:
    """Write a line of text; ``at_px`` is the top left corner of its ``text_size``."""
    left, baseline = round(at_px[0]) + pen.margin_px, round(at_px[1] + pen.text_px)
    cv2.putText(canvas, text, (left, baseline), colour, _face(), pen.text_px, _TEXT_WEIGHT)


def write_on_plate(canvas: Image, text: str, at_px: Point, colour: Colour, pen: Pen) -> None:
    """Write a line of text on a dark plate with the top left corner ``at_px``, moved to be inside the image."""
    width, height = text_size(text, pen)
    sides = zip(_nearest_pixel(at_px), pen.size, (width, height), strict=True)
    left, top = (max(min(at, size - side), 0) for at, size, side in sides)
    cv2.rectangle(canvas, (left, top), (left + width - 1, top + height - 1), DARK, cv2.FILLED)
    write(canvas, text, (left, top), colour, pen)


def _face() -> cv2.FontFace:
    """OpenCV's built-in sans, which is legible at small sizes and has more than ASCII, unlike the stroke fonts."""
    return cv2.FontFace("sans")


def polyline(canvas: Image, pixels: Float, colour: Colour, thickness_px: int, pen: Pen) -> None:
    """Draw an anti-aliased line through (N, 2) pixels, without points that are not finite."""
    inside = pen.scaled(pixels[np.isfinite(pixels).all(axis=1)])
    reach = _FAR_OUT * max(pen.size)
    fixed = np.rint(np.clip(inside, -reach, reach) * 2**_SUBPIXEL_BITS).astype(np.int32)
    cv2.polylines(canvas, [fixed], False, colour, thickness_px, cv2.LINE_AA, _SUBPIXEL_BITS)


def edged_lines(canvas: Image, lines: Sequence[Float], colour: Colour, thickness_px: int, pen: Pen) -> None:
    """Draw lines, each through (N, 2) pixels, with a dark edge on either side."""
    edges = [(DARK, thickness_px + 2 * pen.edge_px)] if pen.edge_px else []
    for line_colour, width_px in (*edges, (colour, thickness_px)):
        for line in lines:
            polyline(canvas, line, line_colour, width_px, pen)


def dashed_line(canvas: Image, ends: Float, colour: Colour, thickness_px: int, dash_px: float, pen: Pen) -> None:
    """Draw a dashed line with a dark edge between two ends, (2, 2) pixels; dashes are about ``dash_px`` long."""
    (x0, y0), (x1, y1) = ends.tolist()
    pieces = [np.array(piece) for piece in dashes((x0, y0), (x1, y1), dash_px / pen.scale)]
    edged_lines(canvas, pieces, colour, thickness_px, pen)


def box_outline(
    canvas: Image, box: Box, colour: Colour, thickness_px: int, pen: Pen, dash_px: float | None = None
) -> None:
    """Draw a box with a dark edge on whole pixels, for sharp sides; its corners are pixels of the copy."""
    corners = [(box.x_min, box.y_min), (box.x_max, box.y_min), (box.x_max, box.y_max), (box.x_min, box.y_max)]
    sides = list(zip(corners, [*corners[1:], corners[0]], strict=True))
    pieces = sides if dash_px is None else [piece for side in sides for piece in dashes(*side, dash_px)]
    edges = [(pen.edge_px, DARK)] if pen.edge_px else []
    for edge_px, line_colour in (*edges, (0, colour)):
        before, behind = (thickness_px - 1) // 2 + edge_px, thickness_px // 2 + edge_px
        for start, end in pieces:
            (x0, y0), (x1, y1) = _nearest_pixel(start), _nearest_pixel(end)
            first, last = (min(x0, x1) - before, min(y0, y1) - before), (max(x0, x1) + behind, max(y0, y1) + behind)
            cv2.rectangle(canvas, first, last, line_colour, cv2.FILLED)


def _nearest_pixel(point: Point) -> tuple[int, int]:
    return round(point[0]), round(point[1])
