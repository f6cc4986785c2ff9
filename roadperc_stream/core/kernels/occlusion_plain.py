"""What ``occlusion_compiled`` does, in numpy."""

import numpy as np
from numpy.typing import NDArray


def seen_by_both(disparity_px: NDArray[np.float32], occlusion_px: float) -> NDArray[np.bool_]:
    """(H, W) pixels that nothing hides whose disparity is more than ``occlusion_px`` larger.

    Each pixel is drawn into the right image, into the two columns it falls between.

    Args:
        disparity_px: (H, W) true disparities; what is not above 0, as NaN, is not seen.
        occlusion_px: pixels.
    """
    height, width = disparity_px.shape
    partner = np.arange(width, dtype=np.float32) - disparity_px
    inside = (disparity_px > 0) & (partner >= 0)
    starts = np.repeat(width * np.arange(height), np.count_nonzero(inside, axis=1))
    partner, seen_px = partner[inside], disparity_px[inside]
    nearest_px = np.zeros(height * width, np.float32)
    for column in (np.floor(partner), np.ceil(partner)):  # flat places: maximum.at is twice as fast with one index
        np.maximum.at(nearest_px, starts + column.astype(np.intp), seen_px)
    nearest_there = nearest_px[starts + np.rint(partner).astype(np.intp)]
    inside[inside] = nearest_there <= seen_px + np.float32(occlusion_px)
    return inside
