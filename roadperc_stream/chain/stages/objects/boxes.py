"""Many boxes at once: a detector may give thousands, and each is compared with all of another kind."""

from collections.abc import Iterable

import numpy as np

from roadperc_stream.core.datatypes import Box
from roadperc_stream.core.geometry import Float


def corners(boxes: Iterable[Box]) -> Float:
    """(4, N) x_min, y_min, x_max and y_max."""
    return np.array([(b.x_min, b.y_min, b.x_max, b.y_max) for b in boxes], np.float64).reshape(-1, 4).T


def areas(of_corners: Float) -> Float:
    """(N,) square pixels of (4, N) corners."""
    x0, y0, x1, y1 = of_corners
    inside: Float = np.maximum(x1 - x0, 0.0) * np.maximum(y1 - y0, 0.0)
    return inside


def shared_areas(ours: Float, theirs: Float) -> Float:
    """(M, N) square pixels that (4, M) and (4, N) corners have in common."""
    x0, y0, x1, y1 = ours[:, :, None]
    width = np.minimum(x1, theirs[2]) - np.maximum(x0, theirs[0])
    height = np.minimum(y1, theirs[3]) - np.maximum(y0, theirs[1])
    shared: Float = np.where((width > 0) & (height > 0), width * height, 0.0)
    return shared


def overlaps(ours: Float, theirs: Float) -> Float:
    """(M, N) intersection over union of (4, M) with (4, N) corners: ``Box.overlap`` of all pairs."""
    shared = shared_areas(ours, theirs)
    union = areas(ours)[:, None] + areas(theirs) - shared
    quotients: Float = np.divide(shared, union, out=np.zeros_like(shared), where=shared > 0)
    return quotients
