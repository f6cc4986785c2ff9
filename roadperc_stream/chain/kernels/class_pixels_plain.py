"""What ``class_pixels_compiled`` does, in numpy and OpenCV; the compiled form alone checks the sizes."""

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


def mark(tags: Image, of_class: Image) -> Image:
    """1 at the pixels of a class, 0 at the others.

    Args:
        tags: (H, W).
        of_class: (256,) 1 at the tags of the class, else 0.
    """
    return np.asarray(cv2.LUT(np.ascontiguousarray(tags), of_class), np.uint8)


def mark_together(tags: Image, of_class: Image, least: int, marked: Image) -> None:
    """Write 1 at pixels of a class with enough of it around them, 0 at the others.

    Args:
        tags: (h, w), at least one pixel.
        of_class: (256,) 1 at the tags of the class, else 0.
        least: pixels of the 3x3 around each that are of the class; mirrored at the border, as OpenCV's default has it.
        marked: (h, w), written.
    """
    found = mark(tags, of_class)
    marked[...] = found & (cv2.boxFilter(found, -1, (3, 3), normalize=False) >= least)


def count_of_class(tags: Image, of_class: Image) -> int:
    """How many of (h, w) tags are of a class: not 0 in (256,)."""
    return int(np.count_nonzero(of_class[tags]))
