"""The template of an object: how it last looked, and the search for it in another image."""

from dataclasses import dataclass

import cv2
import numpy as np

from roadperc_stream.chain.stages.objects.template_matching import correlate
from roadperc_stream.core.datatypes import Box, Correlation, Image, read_only

LARGEST_PX = 96
"""Longest side that is kept: the middle of a larger object is enough to find it."""
_SMALLEST_PX = 8
"""Fewer pixels are found everywhere."""


@dataclass(frozen=True)
class Template:
    """(h, w) grey pixels of an object of ``sides_px``, whose middle is ``off_px`` away from the object's.

    ``distance_m`` is how far the object was then, None where that was not known.
    """

    grey: Image
    off_px: tuple[float, float]
    sides_px: tuple[float, float]
    distance_m: float | None

    def __post_init__(self) -> None:
        read_only(self.grey, np.uint8, (None, None), "template")

    def search(self, image_grey: Image, around: Box, scale: float) -> Correlation | None:
        """How well it fits an image where the object is ``scale`` times as large; None where it is flat or too large.

        Args:
            image_grey: (H, W) uint8.
            around: where the object's middle may be.
            scale: 1 is the size at which it was cut out.
        """
        pixels = _resized(self.grey, scale)
        rows, columns = pixels.shape
        x, y = (off * scale for off in self.off_px)
        region = Box(
            around.x_min + x - columns / 2,
            around.y_min + y - rows / 2,
            around.x_max + x + columns / 2,
            around.y_max + y + rows / 2,
        )
        return correlate(image_grey, pixels, region)

    def whole(self, box_px: Box, scale: float) -> Box:
        """The whole object's box where the template, ``scale`` times as large, lies in a box."""
        x, y = (off * scale for off in self.off_px)
        centre_x, centre_y = (box_px.x_min + box_px.x_max) / 2 - x, (box_px.y_min + box_px.y_max) / 2 - y
        width, height = (side * scale for side in self.sides_px)
        return Box(centre_x - width / 2, centre_y - height / 2, centre_x + width / 2, centre_y + height / 2)


def cut(image_grey: Image, box_px: Box, distance_m: float | None) -> Template | None:
    """The middle of a box in the image, at most ``LARGEST_PX`` in either direction; None where it is too small."""
    height, width = image_grey.shape
    x0, y0, x1, y1 = box_px.rounded(width, height)
    x0, x1 = _middle(x0, x1)
    y0, y1 = _middle(y0, y1)
    if x1 - x0 < _SMALLEST_PX or y1 - y0 < _SMALLEST_PX:
        return None
    off_px = ((x0 + x1 - box_px.x_min - box_px.x_max) / 2, (y0 + y1 - box_px.y_min - box_px.y_max) / 2)
    sides_px = (box_px.x_max - box_px.x_min, box_px.y_max - box_px.y_min)
    return Template(image_grey[y0:y1, x0:x1].copy(), off_px, sides_px, distance_m)


def _middle(first: int, end: int) -> tuple[int, int]:
    cut_off = max(end - first - LARGEST_PX, 0)
    return first + cut_off // 2, end - (cut_off - cut_off // 2)


def _resized(grey: Image, scale: float) -> Image:
    rows, columns = (max(round(side * scale), 1) for side in grey.shape)
    if (rows, columns) == grey.shape:
        return grey
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(grey, (columns, rows), interpolation=how), np.uint8)
