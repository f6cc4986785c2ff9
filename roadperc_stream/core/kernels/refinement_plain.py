"""Disparities moved to where the two images fit best, by numpy and OpenCV."""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
_PARTS: Final = 16
_MOST_PX: Final = 0.5
"""A larger change than half a pixel matched contradicts the matching, which stands then."""
_SLOPE_NOISE: Final = 1.0
"""Variance of the slope, (grey levels per pixel)^2, that 8-bit pixels and their noise have without any texture."""


def refined_disparities(
    sixteenths: NDArray[np.int16], left: NDArray[np.uint8], right: NDArray[np.uint8], size: int
) -> Float32:
    """Disparities moved by the step that best explains what is left of the difference, in each pixel's square.

    Least squares of ``left = moved right - step * slope + offset`` over the square's known pixels; the offset takes up
    cameras that are not equally bright.

    Args:
        sixteenths: (H, W) disparities in sixteenths of a pixel; what is not above 0 is unknown.
        left: (H, W) grey.
        right: (H, W) grey.
        size: side of the squares, odd.

    Returns:
        (H, W) pixels, NaN unknown.

    Raises:
        ValueError: other sizes.
    """
    height, width = sixteenths.shape
    if not sixteenths.shape == left.shape == right.shape:
        raise ValueError(
            f"{height}x{width} disparities of {left.shape[0]}x{left.shape[1]} and "
            f"{right.shape[0]}x{right.shape[1]} pixels: expected one size"
        )
    if size < 1 or size % 2 == 0:
        raise ValueError(f"squares of {size} pixels: expected an odd number")
    if not sixteenths.size:
        return np.empty((height, width), np.float32)
    known = sixteenths > 0
    disparity_px = sixteenths * np.float32(1 / _PARTS)
    columns = np.arange(width, dtype=np.float32) - np.where(known, disparity_px, np.float32(0))
    rows = np.tile(np.arange(height, dtype=np.float32)[:, None], (1, width))
    grey = right.astype(np.float32)
    weight = known.astype(np.float32)
    slopes = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    slope = np.asarray(cv2.remap(slopes, columns, rows, cv2.INTER_LINEAR), np.float32) * weight
    moved = np.asarray(cv2.remap(grey, columns, rows, cv2.INTER_LINEAR), np.float32)
    difference = (left - moved) * weight

    def mean(values: Float32) -> Float32:
        return np.asarray(cv2.boxFilter(values, -1, (size, size)), np.float32)

    share = np.maximum(mean(weight), np.float32(1 / size**2))
    mean_slope = mean(slope)
    covariance = mean(slope * difference) - mean_slope * mean(difference) / share
    variance = mean(slope * slope) - mean_slope**2 / share
    step_px = -covariance / (variance + np.float32(_SLOPE_NOISE))
    moved_px = np.where(np.abs(step_px) <= _MOST_PX, disparity_px + step_px, disparity_px)
    return np.where(known, moved_px, np.float32(np.nan))
