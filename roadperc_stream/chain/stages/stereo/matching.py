"""Disparities of a rectified pair by semi-global matching.

Method: Hirschmueller, Stereo Processing by Semiglobal Matching and Mutual Information, PAMI 2008, with the costs of
Birchfield and Tomasi, as OpenCV's StereoSGBM has it. Its three-direction form is used throughout: on the rendered
drives it is as accurate as eight directions in a third of the time. Its disparities lean towards whole pixels, which
moves the distance of far things by 5 % at half resolution: one step of Lucas and Kanade (An Iterative Image
Registration Technique, 1981) along the rows takes most of that away.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.config import StereoConfig
from roadperc_stream.core.datatypes import Image
from roadperc_stream.core.geometry import Float32

_MULTIPLE: Final = 16
"""OpenCV tries a multiple of so many disparities."""
_PARTS: Final = 16
"""OpenCV gives disparities in sixteenths of a pixel."""
_STEP_PX: Final = 1.0
"""Disparities of neighbours farther apart than this, in pixels of the image, belong to two things."""
_MOST_REFINED_PX: Final = 0.5
"""A larger change than half a pixel matched contradicts the matching, which stands then."""
_SLOPE_NOISE: Final = 1.0
"""Variance of the slope, (grey levels per pixel)^2, that 8-bit pixels and their noise have without any texture."""


def disparity(cfg: StereoConfig, count: int, left: Image, right: Image) -> Float32:
    """Disparities of a rectified pair, left column minus right column.

    Args:
        cfg: its method is not ``off``.
        count: disparities tried, from 0, pixels of the image; a multiple of 16.
        left: (H, W) grey.
        right: (H, W) grey.

    Returns:
        (H, W) float32 pixels, NaN unknown; with ``full`` and without refinement they are multiples of 1/16.
    """
    if cfg.method == "full":
        return _refined(cfg, _matched(cfg, count, left, right), left, right)
    height, width = left.shape
    left, right = _halved(left), _halved(right)
    half = _refined(cfg, _matched(cfg, rounded_up(count / 2), left, right), left, right)
    return _doubled(half)[:height, :width]


def rounded_up(count: float) -> int:
    """The least number of disparities OpenCV can try that is no less."""
    return max(int(np.ceil(count / _MULTIPLE)), 1) * _MULTIPLE


def _matched(cfg: StereoConfig, count: int, left: Image, right: Image) -> Float32:
    """(H, W) disparities in pixels of these images, NaN unknown.

    OpenCV gives no disparity in the first ``count`` columns, where not all of them can be tried. Both images get that
    many columns more: with 192 of 1280 columns that is a quarter more time, and a seventh more of the image.
    """
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=count,
        blockSize=cfg.block_px,
        P1=cfg.p1,
        P2=cfg.p2,
        disp12MaxDiff=cfg.left_right_px,
        uniquenessRatio=cfg.uniqueness_percent,
        speckleWindowSize=cfg.speckle_px,
        speckleRange=cfg.speckle_step_px,
        mode=cv2.StereoSGBM_MODE_SGBM_3WAY,
    )
    wide = [cv2.copyMakeBorder(image, 0, 0, count, 0, cv2.BORDER_REPLICATE) for image in (left, right)]
    sixteenths: NDArray[np.int16] = np.asarray(matcher.compute(*wide), np.int16)[:, count:]
    found = sixteenths * np.float32(1 / _PARTS)
    # OpenCV marks the unknown with -1; 0 is what it finds where no disparity fits better than another.
    found[sixteenths <= 0] = np.nan
    return found


def _refined(cfg: StereoConfig, disparity_px: Float32, left: Image, right: Image) -> Float32:
    """Disparities (H, W) moved by the step that best explains what is left of the difference, in each pixel's square.

    Least squares of ``left = moved right - step * slope + offset`` over the square's known pixels; the offset takes up
    cameras that are not equally bright.
    """
    if cfg.refine_px == 0:
        return disparity_px
    height, width = disparity_px.shape
    known = np.isfinite(disparity_px)
    columns = np.arange(width, dtype=np.float32) - np.where(known, disparity_px, np.float32(0))
    rows = np.tile(np.arange(height, dtype=np.float32)[:, None], (1, width))
    grey = right.astype(np.float32)
    weight = known.astype(np.float32)
    slopes = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    slope = np.asarray(cv2.remap(slopes, columns, rows, cv2.INTER_LINEAR), np.float32) * weight
    moved = np.asarray(cv2.remap(grey, columns, rows, cv2.INTER_LINEAR), np.float32)
    difference = (left - moved) * weight

    def mean(values: Float32) -> Float32:
        return np.asarray(cv2.boxFilter(values, -1, (cfg.refine_px, cfg.refine_px)), np.float32)

    share = np.maximum(mean(weight), np.float32(1 / cfg.refine_px**2))
    mean_slope = mean(slope)
    covariance = mean(slope * difference) - mean_slope * mean(difference) / share
    variance = mean(slope * slope) - mean_slope**2 / share
    step = -covariance / (variance + _SLOPE_NOISE)
    return np.where(np.abs(step) <= _MOST_REFINED_PX, disparity_px + step, disparity_px)


def _halved(image: Image) -> Image:
    """Means of two by two pixels; an odd last row or column counts twice."""
    height, width = image.shape
    even = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(even, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)


def _doubled(half: Float32) -> Float32:
    """(2h, 2w) disparities in pixels of the image, of (h, w) in pixels half as fine; the road has no steps."""
    size = (2 * half.shape[1], 2 * half.shape[0])
    doubled = half * np.float32(2)
    nearest = np.asarray(cv2.resize(doubled, size, interpolation=cv2.INTER_NEAREST), np.float32)
    smooth = np.asarray(cv2.resize(doubled, size, interpolation=cv2.INTER_LINEAR), np.float32)
    return within_one_thing(nearest, smooth)


def within_one_thing(nearest: Float32, smooth: Float32) -> Float32:
    """Interpolated disparities, but the nearest at the border of two things: between them is a point in mid-air."""
    with np.errstate(invalid="ignore"):
        within = np.abs(smooth - nearest) < np.float32(_STEP_PX)
    return np.where(within, smooth, nearest)
