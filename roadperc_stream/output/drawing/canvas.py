"""Draws lines, boxes and text into an image, at sizes that fit the image."""

from collections.abc import Sequence
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


class Canvas:
    """An image to draw into, and widths in pixels that fit its size.

    Args:
        pixels: (H, W, 3) uint8, blue, green, red.
        scale: its size relative to the original image. Lines and boxes are in pixels of the original.
    """

    def __init__(self, pixels: Image, scale: float = 1.0) -> None:
        rows, columns = pixels.shape[:2]
        self.pixels, self.scale = pixels, scale
        self.size = columns, rows
        self.line_px = max(round(rows / _LINE_ROWS), 1)
        self.broad_px = 2 * self.line_px
        """Width of the most important lines."""
        self.thin_px = max(self.line_px - 1, 1)
        """Width of lines over or beside the broad ones."""
        self.edge_px = self.line_px // 2
        """Width of the dark edge on either side of a line; 0 in small images."""
        self.text_px = max(round(rows / _TEXT_ROWS), _LEAST_TEXT_PX)
        self.row_px = round(1.3 * self.text_px)
        """Height of a line of text with its margin."""
        self.margin_px = max(round(0.25 * self.text_px), 2)
        """Free columns at either end of a text."""

    @classmethod
    def resized(cls, image_bgr: Image, scale: float) -> "Canvas":
        """A copy of an image, ``scale`` times as large."""
        if scale == 1.0:
            return cls(image_bgr.copy())
        rows, columns = image_bgr.shape[:2]
        size = max(round(columns * scale), 1), max(round(rows * scale), 1)
        method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        return cls(cv2.resize(image_bgr, size, interpolation=method).astype(np.uint8, copy=False), scale)

    def unscaled(self) -> "Canvas":
        """The same pixels, for lines in pixels of the copy."""
        return Canvas(self.pixels)

    def scaled(self, pixels: Float) -> Float:
        """(N, 2) pixels of the copy from pixels of the original; pixel centres are integers in both."""
        return np.asarray((pixels + 0.5) * self.scale - 0.5, float)

    def scaled_box(self, box: Box) -> Box:
        """The box in pixels of the copy, clipped to the image; its corners are its outermost pixels."""
        corners = np.array([(box.x_min, box.y_min), (box.x_max - 1, box.y_max - 1)])
        (x0, y0), (x1, y1) = np.clip(self.scaled(corners), 0, np.array(self.size) - 1)
        return Box(float(x0), float(y0), float(x1), float(y1))

    def text_size(self, text: str) -> tuple[int, int]:
        """Columns and rows of a text with its margin."""
        _, _, width, _ = cv2.getTextSize(self.size, text, (0, 0), _face(), self.text_px, _TEXT_WEIGHT)
        return width + 2 * self.margin_px, self.row_px

    def write(self, text: str, at_px: Point, colour: Colour) -> None:
        """Write a line of text; ``at_px`` is the top left corner of its ``text_size``."""
        left, baseline = round(at_px[0]) + self.margin_px, round(at_px[1] + self.text_px)
        cv2.putText(self.pixels, text, (left, baseline), colour, _face(), self.text_px, _TEXT_WEIGHT)

    def write_on_plate(self, text: str, at_px: Point, colour: Colour) -> None:
        """Write a line of text on a dark plate with the top left corner ``at_px``, moved to be inside the image."""
        width, height = self.text_size(text)
        sides = zip(_nearest_pixel(at_px), self.size, (width, height), strict=True)
        left, top = (max(min(at, size - side), 0) for at, size, side in sides)
        cv2.rectangle(self.pixels, (left, top), (left + width - 1, top + height - 1), DARK, cv2.FILLED)
        self.write(text, (left, top), colour)

    def polyline(self, line: Float, colour: Colour, thickness_px: int) -> None:
        """Draw an anti-aliased line through (N, 2) pixels, without points that are not finite."""
        inside = self.scaled(line[np.isfinite(line).all(axis=1)])
        reach = _FAR_OUT * max(self.size)
        fixed = np.rint(np.clip(inside, -reach, reach) * 2**_SUBPIXEL_BITS).astype(np.int32)
        cv2.polylines(self.pixels, [fixed], False, colour, thickness_px, cv2.LINE_AA, _SUBPIXEL_BITS)

    def edged_lines(self, lines: Sequence[Float], colour: Colour, thickness_px: int) -> None:
        """Draw lines, each through (N, 2) pixels, with a dark edge on either side."""
        edges = [(DARK, thickness_px + 2 * self.edge_px)] if self.edge_px else []
        for line_colour, width_px in (*edges, (colour, thickness_px)):
            for line in lines:
                self.polyline(line, line_colour, width_px)

    def dashed_line(self, ends: Float, colour: Colour, thickness_px: int, dash_px: float) -> None:
        """Draw a dashed line with a dark edge between two ends, (2, 2) pixels; dashes are about ``dash_px`` long."""
        (x0, y0), (x1, y1) = ends.tolist()
        pieces = [np.array(piece) for piece in dashes((x0, y0), (x1, y1), dash_px / self.scale)]
        self.edged_lines(pieces, colour, thickness_px)

    def box_outline(self, box: Box, colour: Colour, thickness_px: int, dash_px: float | None = None) -> None:
        """Draw a box with a dark edge on whole pixels, for sharp sides; its corners are pixels of the copy."""
        corners = [(box.x_min, box.y_min), (box.x_max, box.y_min), (box.x_max, box.y_max), (box.x_min, box.y_max)]
        sides = list(zip(corners, [*corners[1:], corners[0]], strict=True))
        pieces = sides if dash_px is None else [piece for side in sides for piece in dashes(*side, dash_px)]
        edges = [(self.edge_px, DARK)] if self.edge_px else []
        for edge_px, line_colour in (*edges, (0, colour)):
            before, behind = (thickness_px - 1) // 2 + edge_px, thickness_px // 2 + edge_px
            for start, end in pieces:
                (x0, y0), (x1, y1) = _nearest_pixel(start), _nearest_pixel(end)
                first, last = (min(x0, x1) - before, min(y0, y1) - before), (max(x0, x1) + behind, max(y0, y1) + behind)
                cv2.rectangle(self.pixels, first, last, line_colour, cv2.FILLED)


def dashes(start: Point, end: Point, length_px: float) -> list[tuple[Point, Point]]:
    """Every second piece of a line, each about ``length_px`` long, including the first and the last."""
    a, b = np.array(start), np.array(end)
    pieces = 2 * int(np.linalg.norm(b - a) / (2 * length_px)) + 1
    points = [a + (b - a) * k / pieces for k in range(pieces + 1)]
    return [((points[k][0], points[k][1]), (points[k + 1][0], points[k + 1][1])) for k in range(0, pieces, 2)]


def _face() -> cv2.FontFace:
    """OpenCV's built-in sans, which is legible at small sizes and has more than ASCII, unlike the stroke fonts."""
    return cv2.FontFace("sans")


def _nearest_pixel(point: Point) -> tuple[int, int]:
    return round(point[0]), round(point[1])
