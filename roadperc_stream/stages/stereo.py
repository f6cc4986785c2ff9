"""Depth from a stereo pair by semi-global matching.

Method: Hirschmueller, Stereo Processing by Semiglobal Matching and Mutual Information, PAMI 2008, with the costs of
Birchfield and Tomasi, as OpenCV's StereoSGBM has it. Its three-direction form is used throughout: on the rendered
drives it is as accurate as eight directions in a third of the time. Its disparities lean towards whole pixels, which
moves the distance of far things by 5 % at half resolution: one step of Lucas and Kanade (An Iterative Image
Registration Technique, 1981) along the rows takes most of that away. Depth is Z = f b / d.
"""

from functools import lru_cache
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import StereoConfig
from roadperc_stream.datatypes import Absent, Image, Mask, StereoDepth
from roadperc_stream.geometry import Camera, Float, Float32, Lens, Plane, inverse, rays, transform_plane

_MULTIPLE: Final = 16
"""OpenCV tries a multiple of so many disparities."""
_PARTS: Final = 16
"""OpenCV gives disparities in sixteenths of a pixel."""
_NEARER: Final = 1.1
"""What lies nearer than the road: bumps, and the nose of a braking car going down."""
_STEP_PX: Final = 1.0
"""Disparities of neighbours farther apart than this, in pixels of the image, belong to two things."""
_MOST_REFINED_PX: Final = 0.5
"""A larger change than half a pixel matched contradicts the matching, which stands then."""
_SLOPE_NOISE: Final = 1.0
"""Variance of the slope, (grey levels per pixel)^2, that 8-bit pixels and their noise have without any texture."""
_MODELS: Final = ("", "plumb_bob", "rational_polynomial")
"""Distortion models whose coefficients are those of OpenCV's pinhole."""
_NOT_TURNED: Final = 1e-6
"""Largest entry of R R^T - 1 of a rotation."""


def match(
    cfg: StereoConfig,
    left: Camera,
    right: Camera | None,
    ego_T_left: Float,
    left_image: Image | None,
    right_image: Image | None,
) -> StereoDepth | Absent:
    """Depth of a stereo pair, as the left camera sees it once it is rectified.

    Args:
        cfg: method and thresholds.
        left: camera of ``left_image``.
        right: camera of ``right_image``, its ``baseline_m`` to the right of the left one along the rectified rows.
        ego_T_left: mounting of the left camera: how near the nearest road pixel is decides what must be tried.
        left_image: (H, W, 3) blue, green, red or (H, W) grey.
        right_image: the same of the right camera.

    Returns:
        (H, W) float32 metres along z, NaN where the pair does not tell: hidden from the right camera, outside its
        image, ambiguous, or so far away that the disparity is mostly error. Or why there is none.
    """
    if cfg.method == "off":
        return Absent("switched off")
    if left_image is None or right_image is None or right is None:
        given = {"left image": left_image, "right image": right_image, "calibration of the right camera": right}
        return Absent(", ".join(f"no {name}" for name, thing in given.items() if thing is None))
    baseline_m = right.baseline_m
    if baseline_m is None or not baseline_m > 0:
        said = "is 0" if baseline_m is None else f"gives a baseline of {baseline_m:g} m"
        return Absent(f"P[0][3] of the right camera {said}: expected -fx * baseline")
    fault = _fault(left, right, left_image, right_image)
    if fault is not None:
        return Absent(fault)
    count = disparities_needed(left, baseline_m, ego_T_left) if cfg.disparities == "auto" else cfg.disparities
    if count is None:
        return Absent("the mounting puts the left camera below the road: set stereo.disparities")
    disparity_px = _rectified_disparity(cfg, count, left, right, _grey(left_image), _grey(right_image))
    return StereoDepth(left.frame_id, depth_of(cfg, left, baseline_m, disparity_px))


def disparities_needed(left: Camera, baseline_m: float, ego_T_left: Float) -> int | None:
    """Disparities from 0 that reach the nearest road pixel: a multiple of 16, no more than the image is wide.

    On a plane disparity is linear in the pixel, d = -f b (n . ray) / height, so that the largest is in a corner.

    Returns:
        Pixels; None where the road the mounting promises is not below the camera.
    """
    road = transform_plane(inverse(ego_T_left), Plane.of(np.array([0.0, 0.0, 1.0]), 0.0))
    if road.offset_m <= 0:
        return None
    right, bottom = left.width - 1.0, left.height - 1.0
    corners = rays(left, np.array([[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]]))
    disparity_px = left.fx * baseline_m * float(np.max(-corners @ road.n)) / road.offset_m
    return _rounded_up(min(_NEARER * disparity_px, left.width))


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
    half = _refined(cfg, _matched(cfg, _rounded_up(count / 2), left, right), left, right)
    return _doubled(half)[:height, :width]


def depth_of(cfg: StereoConfig, left: Camera, baseline_m: float, disparity_px: Float32) -> Float32:
    """(H, W) metres along z of (H, W) disparities in pixels; NaN below ``min_disparity_px`` and where unknown."""
    depth_m = np.full_like(disparity_px, np.nan)
    with np.errstate(invalid="ignore"):
        known = disparity_px >= np.float32(cfg.min_disparity_px)
    np.divide(np.float32(left.fx * baseline_m), disparity_px, out=depth_m, where=known)
    return depth_m


def _rounded_up(count: float) -> int:
    return max(int(np.ceil(count / _MULTIPLE)), 1) * _MULTIPLE


def _grey(image: Image) -> Image:
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def _fault(left: Camera, right: Camera, left_image: Image, right_image: Image) -> str | None:
    """Why the two images are no pair that can be matched."""
    if left.size != right.size:
        return f"the left camera has {left.width}x{left.height} pixels, the right one {right.width}x{right.height}"
    for side, camera, image in (("left", left, left_image), ("right", right, right_image)):
        height, width = image.shape[:2]
        if (height, width) != camera.size:
            return f"{side} image: {width}x{height} pixels, its calibration says {camera.width}x{camera.height}"
        fault = _lens_fault(camera)
        if fault is not None:
            return f"not rectified: the {side} camera {fault}"
    return None


def _lens_fault(camera: Camera) -> str | None:
    lens = camera.lens
    if lens is None:
        return "has distortion but no R" if any(camera.distortion) else None
    R = np.array(lens.R).reshape(3, 3)
    if np.abs(R @ R.T - np.eye(3)).max() > _NOT_TURNED or np.linalg.det(R) < 0:
        return f"has an R that is no rotation: {list(lens.R)}"
    if lens.model not in _MODELS:
        return f"has distortion of model {lens.model!r}; known: {', '.join(filter(None, _MODELS))}"
    return None


def _rectified_disparity(
    cfg: StereoConfig, count: int, left: Camera, right: Camera, left_grey: Image, right_grey: Image
) -> Float32:
    """(H, W) disparities seen by both cameras; images that are not rectified, or to other intrinsics, are resampled."""
    if left.lens is None and right.lens is None and right.same_view(left):
        disparity_px = disparity(cfg, count, left_grey, right_grey)
        return _seen_by_right(disparity_px, None)
    left_rectified, left_seen = _resampled(left, left, left_grey)
    right_rectified, right_seen = _resampled(right, left, right_grey)
    disparity_px = disparity(cfg, count, left_rectified, right_rectified)
    disparity_px[~left_seen] = np.nan
    return _seen_by_right(disparity_px, right_seen)


def _seen_by_right(disparity_px: Float32, right_seen: Mask | None) -> Float32:
    """The disparities (H, W) whose partner lies in the right image, at one of its pixels that were seen at all."""
    partner = np.arange(disparity_px.shape[1], dtype=np.float32) - disparity_px
    with np.errstate(invalid="ignore"):
        inside = partner >= 0
    if right_seen is not None:
        columns = np.rint(np.where(inside, partner, 0)).astype(np.intp)
        inside &= np.take_along_axis(right_seen, columns, axis=1)
    return np.where(inside, disparity_px, np.float32(np.nan))


def _resampled(camera: Camera, target: Camera, image: Image) -> tuple[Image, Mask]:
    """The image as the rectified target camera would see it, and which of its pixels the image holds."""
    columns, rows, seen = _maps(camera, target)
    return np.asarray(cv2.remap(image, columns, rows, cv2.INTER_LINEAR), np.uint8), seen


@lru_cache(maxsize=4)
def _maps(camera: Camera, target: Camera) -> tuple[Float32, Float32, Mask]:
    """Where in the camera's image each of the target's pixels lies: (H, W) columns and rows, and whether inside."""
    lens = camera.lens or Lens(camera.fx, camera.fy, camera.cx, camera.cy)
    size = (target.width, target.height)
    R = np.array(lens.R).reshape(3, 3)
    distortion = np.array(camera.distortion)
    columns, rows = cv2.initUndistortRectifyMap(lens.K, distortion, R, target.K, size, cv2.CV_32FC1)
    seen = (columns >= 0) & (columns <= camera.width - 1) & (rows >= 0) & (rows <= camera.height - 1)
    return np.asarray(columns, np.float32), np.asarray(rows, np.float32), seen


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
    # OpenCV marks the unknown with -1; 0 is what it finds where nothing tells one disparity from another.
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
    """(2h, 2w) disparities in pixels of the image, of (h, w) in pixels half as fine.

    Interpolated, so that the road has no steps; but not across the border of two things, where the value between them
    would be a point in mid-air.
    """
    size = (2 * half.shape[1], 2 * half.shape[0])
    doubled = half * np.float32(2)
    nearest = np.asarray(cv2.resize(doubled, size, interpolation=cv2.INTER_NEAREST), np.float32)
    smooth = np.asarray(cv2.resize(doubled, size, interpolation=cv2.INTER_LINEAR), np.float32)
    with np.errstate(invalid="ignore"):
        within = np.abs(smooth - nearest) < np.float32(_STEP_PX)
    return np.where(within, smooth, nearest)
