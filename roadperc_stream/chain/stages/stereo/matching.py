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

from roadperc_stream.chain.kernels import doubled, refined_disparities
from roadperc_stream.config import StereoConfig
from roadperc_stream.geometry import Float32
from roadperc_stream.model import Image

_MULTIPLE: Final = 16
"""OpenCV tries a multiple of so many disparities."""
_PARTS: Final = 16
"""OpenCV gives disparities in sixteenths of a pixel."""
STEP_PX: Final = 1.0
"""Disparities of neighbours farther apart than this, in pixels of the image, belong to two things."""


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
        return _found(cfg, count, left, right)
    height, width = left.shape
    left, right = _halved(left), _halved(right)
    return doubled(_found(cfg, rounded_up(count / 2), left, right), STEP_PX)[:height, :width]


def rounded_up(count: float) -> int:
    """The least number of disparities OpenCV can try that is no less."""
    return max(int(np.ceil(count / _MULTIPLE)), 1) * _MULTIPLE


def _found(cfg: StereoConfig, count: int, left: Image, right: Image) -> Float32:
    """(H, W) disparities in pixels of these images, refined if that is asked for; NaN unknown."""
    sixteenths = _matched(cfg, count, left, right)
    if cfg.refine_px:
        return refined_disparities(sixteenths, left, right, cfg.refine_px)
    return np.where(sixteenths > 0, sixteenths * np.float32(1 / _PARTS), np.float32(np.nan))


def matcher_of(cfg: StereoConfig, count: int) -> cv2.StereoSGBM:
    """OpenCV's matcher by the settings, for a number of disparities that it can try."""
    return cv2.StereoSGBM.create(
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


def _matched(cfg: StereoConfig, count: int, left: Image, right: Image) -> NDArray[np.int16]:
    """(H, W) disparities in sixteenths of a pixel of these images.

    OpenCV marks the unknown with -1; 0 is what it finds where no disparity fits better than another.

    OpenCV gives no disparity in the first ``count`` columns, where not all of them can be tried. Both images get that
    many columns more: with 192 of 1280 columns that is a quarter more time, and a seventh more of the image.
    """
    matcher = matcher_of(cfg, count)
    wide = [cv2.copyMakeBorder(image, 0, 0, count, 0, cv2.BORDER_REPLICATE) for image in (left, right)]
    sixteenths: NDArray[np.int16] = np.asarray(matcher.compute(*wide), np.int16)
    return sixteenths[:, count:]


def _halved(image: Image) -> Image:
    """Means of two by two pixels; an odd last row or column counts twice."""
    height, width = image.shape
    even = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(even, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)
