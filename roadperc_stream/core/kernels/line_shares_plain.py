"""What ``line_shares_compiled`` does, in numpy and OpenCV."""

import cv2
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Image = NDArray[np.uint8]


def line_shares(lines: Float, mask: Image, margin: int) -> Float:
    """(N,) how much of each line lies on a mask that is widened, pixel by pixel: one for every column or every row.

    Args:
        lines: (N, 4) x1, y1, x2, y2 in the image.
        mask: (H, W) 1 in 0.
        margin: pixels by which it reaches farther to all sides, the corners too.

    Raises:
        ValueError: a line is not in the image.
    """
    _require_inside(lines, mask)
    if not len(lines):
        return np.empty(0)
    start, end = lines[:, :2], lines[:, 2:]
    steps = np.abs(end - start).max(axis=1).astype(int)
    first = np.cumsum(steps + 1) - (steps + 1)
    owner = np.repeat(np.arange(len(lines)), steps + 1)
    along = np.arange(len(owner)) - first[owner]
    places = along[:, None] * ((end - start) / np.maximum(steps, 1)[:, None])[owner] + start[owner]
    places[first + steps] = end
    columns, rows = np.rint(places).astype(int).T
    widened = _widened(mask, margin, int(rows.min()), int(rows.max()) + 1)
    shares: Float = np.add.reduceat(widened[rows, columns], first, dtype=float) / (steps + 1)
    return shares


def _require_inside(lines: Float, mask: Image) -> None:
    height, width = mask.shape
    if not ((lines >= 0) & (lines <= (width - 1, height - 1, width - 1, height - 1))).all():
        raise ValueError(f"expected lines in an image of {height}x{width}")


def _widened(mask: Image, margin: int, top: int, end: int) -> Image:
    """(H, W) 1 at and around the mask, known in the rows from ``top`` to ``end``."""
    part = slice(max(top - margin, 0), end + margin)
    widened = np.zeros(mask.shape, np.uint8)
    widened[part] = cv2.dilate(mask[part], np.ones((2 * margin + 1, 2 * margin + 1), np.uint8))
    return widened
