"""The functions of ``stereo_compiled`` in numpy and OpenCV; only the compiled ones check sizes (ValueError)."""

from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
_PARTS: Final = 16
_MOST_PX: Final = 0.5
"""Largest change by the refinement; a larger one contradicts the matching and is dropped."""
_SLOPE_NOISE: Final = 1.0
"""Variance of the slope, (grey levels per pixel)^2, of 8-bit pixels and their noise without texture."""


def refined_disparities(
    sixteenths: NDArray[np.int16], left: NDArray[np.uint8], right: NDArray[np.uint8], size: int
) -> Float32:
    """(H, W) disparities in pixels, NaN unknown, moved by the step that best explains the remaining difference.

    ``sixteenths`` (H, W) are disparities in sixteenths of a pixel, unknown if not above 0; ``left`` and ``right`` are
    (H, W) grey. Least squares of ``left = moved right - step * slope + offset`` over the known pixels of each pixel's
    square of odd side ``size``. The offset allows for cameras of different brightness.
    """
    height, width = sixteenths.shape
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


def doubled(half: Float32, step_px: float) -> Float32:
    """(2H, 2W) disparities of an image from (H, W) disparities at half its resolution; NaN unknown.

    They are interpolated linearly, with one rounding along a row and one along a column. Where they then differ from
    the nearest pixel by ``step_px`` of the image or more, or are unknown, the nearest pixel counts: interpolation
    between two objects would give a point in mid-air.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        twice = half * np.float32(2)
        nearest = np.repeat(np.repeat(twice, 2, axis=0), 2, axis=1)
        smooth = _with_between(_with_between(twice).T).T
        within = np.abs(smooth - nearest) < np.float32(step_px)
    return np.where(within, smooth, nearest)


def _with_between(values: Float32) -> Float32:
    """(H, 2W) values a quarter of the way from each of (H, W) to its neighbours; at the ends the value itself.

    In float64: for disparities this rounds as the fused multiply-add that OpenCV uses.
    """
    here, following = values[:, :-1], values[:, 1:]
    between = np.repeat(values, 2, axis=1)
    rise = (following - here).astype(float)
    between[:, 1:-1:2] = here + rise * 0.25
    between[:, 2:-1:2] = here + rise * 0.75
    return between


class DisparityLimits(NamedTuple):
    """A disparity is ``scale_px_m`` / depth. It is bad if its error exceeds ``bad_px`` and ``bad_share`` of the truth.

    Pixels from a true depth of ``max_depth_m`` on do not count.
    """

    scale_px_m: float
    max_depth_m: float
    bad_px: float
    bad_share: float


def disparity_errors(
    estimated_m: Float32, true_m: Float32, seen: NDArray[np.bool_], limits: DisparityLimits
) -> tuple[Float32, Float32, int, int]:
    """Errors of an (H, W) estimated depth over the ``seen`` (H, W) pixels within the largest true depth, in float32.

    Returns:
        (N,) absolute errors of the disparity and (N,) relative errors of the depth at known pixels, row by row; the
        number of pixels that count, and of bad disparities. Pixels without a finite estimated disparity are unknown.
    """
    scale_px_m, max_depth_m, bad_px, bad_share = limits
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        estimated_px, true_px = (np.float32(scale_px_m) / depth_m for depth_m in (estimated_m, true_m))
        counted = seen & (true_m < np.float32(max_depth_m))
        known = counted & np.isfinite(estimated_px)
        error_px = np.abs(estimated_px - true_px)
        bad = known & (error_px > np.float32(bad_px)) & (error_px > np.float32(bad_share) * true_px)
        relative = np.abs(estimated_m - true_m) / true_m
    return error_px[known], relative[known], int(np.count_nonzero(counted)), int(np.count_nonzero(bad))


def seen_by_both(disparity_px: NDArray[np.float32], occlusion_px: float) -> NDArray[np.bool_]:
    """(H, W) pixels that no pixel with a disparity larger by more than ``occlusion_px`` hides from the right camera.

    Each pixel is drawn into the two columns of the right image that it falls between. A true disparity (H, W) that is
    not above 0, or NaN, is not seen.
    """
    height, width = disparity_px.shape
    partner = np.arange(width, dtype=np.float32) - disparity_px
    inside = (disparity_px > 0) & (partner >= 0)
    starts = np.repeat(width * np.arange(height), np.count_nonzero(inside, axis=1))
    partner, seen_px = partner[inside], disparity_px[inside]
    nearest_px = np.zeros(height * width, np.float32)
    for column in (np.floor(partner), np.ceil(partner)):  # maximum.at is twice as fast with one flat index
        np.maximum.at(nearest_px, starts + column.astype(np.intp), seen_px)
    nearest_there = nearest_px[starts + np.rint(partner).astype(np.intp)]
    inside[inside] = nearest_there <= seen_px + np.float32(occlusion_px)
    return inside
