"""What ``doubling_compiled`` does, in numpy."""

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]


def doubled(half: Float32, step_px: float) -> Float32:
    """Disparities in pixels of an image, of such in pixels half as fine.

    Between pixels they are linear, rounded once along a row and once along a column, but at the border of two things
    the nearest pixel's: between them is a point in mid-air. So they are where one of the neighbours is unknown.

    Args:
        half: (H, W), NaN unknown.
        step_px: disparities that differ by as much, in pixels of the image, belong to two things.

    Returns:
        (2H, 2W), NaN unknown.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        twice = half * np.float32(2)
        nearest = np.repeat(np.repeat(twice, 2, axis=0), 2, axis=1)
        smooth = _with_between(_with_between(twice).T).T
        within = np.abs(smooth - nearest) < np.float32(step_px)
    return np.where(within, smooth, nearest)


def _with_between(values: Float32) -> Float32:
    """(H, 2W) values a quarter of the way from each of (H, W) to the next and the one before; at the ends its own.

    In float64: disparities are near enough to each other for that to round as a processor does that multiplies and adds
    at once, as OpenCV has it do.
    """
    here, following = values[:, :-1], values[:, 1:]
    between = np.repeat(values, 2, axis=1)
    rise = (following - here).astype(float)
    between[:, 1:-1:2] = here + rise * 0.25
    between[:, 2:-1:2] = here + rise * 0.75
    return between
