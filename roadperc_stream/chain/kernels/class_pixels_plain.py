"""The functions of ``class_pixels_compiled`` in numpy and OpenCV; only the compiled ones check sizes."""

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


def mark(tags: Image, of_class: Image) -> Image:
    """(H, W) 1 at pixels of a class, else 0; ``of_class`` is (256,) 1 at the tags of the class, else 0."""
    return np.asarray(cv2.LUT(np.ascontiguousarray(tags), of_class), np.uint8)


def mark_together(tags: Image, of_class: Image, least: int, marked: Image) -> None:
    """Write to ``marked`` (h, w) 1 at pixels of a class with ``least`` pixels of it in their 3x3 square, else 0.

    ``tags`` has at least one pixel. Borders are mirrored, as by OpenCV's default.
    """
    found = mark(tags, of_class)
    marked[...] = found & (cv2.boxFilter(found, -1, (3, 3), normalize=False) >= least)
