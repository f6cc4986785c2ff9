"""Depth from a stereo pair, Z = f b / d, rectified where it must be, or why there is none."""

from functools import lru_cache
from typing import Final

import cv2
import numpy as np

from roadperc_stream.chain.stages.stereo.matching import STEP_PX, disparity, rounded_up
from roadperc_stream.config import StereoConfig
from roadperc_stream.geometry import (
    Camera,
    Float,
    Float32,
    Lens,
    Plane,
    inverse,
    pinhole_fault,
    project,
    rays,
    rigid,
    transform_plane,
)
from roadperc_stream.model import Absent, Image, Mask, Reason, StereoDepth

_MODELS: Final = ("", "plumb_bob", "rational_polynomial")
"""Distortion models whose coefficients are those of OpenCV's pinhole."""
_NOT_TURNED: Final = 1e-6
"""Largest entry of R R^T - 1 of a rotation."""
_COEFFICIENTS: Final = (4, 5, 8, 12, 14)
"""Numbers of distortion coefficients that OpenCV's pinhole may have."""
_LARGEST_COEFFICIENT: Final = 1e4
"""A rational lens may have coefficients of hundreds, none has this."""
_BASELINES_M: Final = (1e-3, 1e3)
"""Shortest and longest distance of a pair's cameras: what lies beyond is a mistake, and its depth no depth."""
_NEARER: Final = 1.1
"""What lies nearer than the road: bumps, and the nose of a braking car going down."""


def lens_fault(side: str, camera: Camera) -> Reason | None:
    """Why the images of a pair's camera cannot be rectified; None where they can or need not be."""
    lens = camera.lens
    if lens is None:
        return Reason("stereo", "lens_without_rotation", (side,)) if any(camera.distortion) else None
    pinhole = pinhole_fault(camera.width, camera.height, lens.fx, lens.fy, lens.cx, lens.cy)
    if pinhole is not None:
        return Reason("stereo", "lens_without_camera_matrix", (side, pinhole))
    if not _is_rotation(rectification(camera)):
        return Reason("stereo", "lens_rotation_invalid", (side, str(list(lens.R))))
    if lens.model not in _MODELS:
        return Reason("stereo", "lens_model_unknown", (side, lens.model, ", ".join(filter(None, _MODELS))))
    return _distortion_fault(side, camera.distortion)


def _is_rotation(R: Float) -> bool:
    """Whether a (3, 3) matrix turns and does not mirror; one that is not finite does neither."""
    if not np.isfinite(R).all():
        return False
    return bool(np.abs(R @ R.T - np.eye(3)).max() <= _NOT_TURNED and np.linalg.det(R) > 0)


def _distortion_fault(side: str, coefficients: tuple[float, ...]) -> Reason | None:
    """Why no image can be rectified by such coefficients; none at all are no distortion."""
    if coefficients and len(coefficients) not in _COEFFICIENTS:
        known = ", ".join(str(count) for count in _COEFFICIENTS)
        return Reason("stereo", "lens_coefficient_count", (side, len(coefficients), known))
    wild = [d for d in coefficients if not abs(d) <= _LARGEST_COEFFICIENT]
    if wild:
        return Reason("stereo", "lens_coefficient_size", (side, wild[0], _LARGEST_COEFFICIENT))
    return None


def rectification(camera: Camera) -> Float:
    """(3, 3) rotation from the camera as it is mounted to the rectified one."""
    return np.array(camera.lens.R if camera.lens else Lens.R).reshape(3, 3)


def resampled(camera: Camera, target: Camera, image: Image) -> tuple[Image, Mask]:
    """The image resampled to the rectified target camera, and which of its pixels lie in the image."""
    columns, rows, valid = _maps(camera, target)
    return np.asarray(cv2.remap(image, columns, rows, cv2.INTER_LINEAR), np.uint8), valid


@lru_cache(maxsize=4)
def _maps(camera: Camera, target: Camera) -> tuple[Float32, Float32, Mask]:
    """Where in the camera's image each of the target's pixels lies: (H, W) columns and rows, and whether inside."""
    lens = camera.lens or Lens(camera.fx, camera.fy, camera.cx, camera.cy)
    size = (target.width, target.height)
    distortion, R = np.array(camera.distortion), rectification(camera)
    columns, rows = cv2.initUndistortRectifyMap(lens.K, distortion, R, target.K, size, cv2.CV_32FC1)
    valid = (columns >= 0) & (columns <= camera.width - 1) & (rows >= 0) & (rows <= camera.height - 1)
    return np.asarray(columns, np.float32), np.asarray(rows, np.float32), valid


def turned_back(left: Camera, disparity_px: Float32) -> Float32:
    """The disparities f b / z of the left camera's own pixels (H, W), of those of the rectified camera's.

    Both stand in one place, so nothing hides anything: each pixel's ray samples the rectified pixel it goes through.
    """
    if np.array_equal(rectification(left), np.eye(3)):
        return disparity_px
    columns, rows, z = _turned_rays(left)
    nearest, smooth = (
        np.asarray(cv2.remap(disparity_px, columns, rows, how, borderValue=np.nan), np.float32)
        for how in (cv2.INTER_NEAREST, cv2.INTER_LINEAR)
    )
    return _within_one_thing(nearest, smooth) * z


@lru_cache(maxsize=4)
def _turned_rays(left: Camera) -> tuple[Float32, Float32, Float32]:
    """Where each pixel of the left camera lies in the rectified one: (H, W) columns, rows, and z of its ray there."""
    rows, columns = np.indices(left.size, dtype=float)
    turned = rays(left, np.stack((columns, rows), axis=-1)) @ rectification(left).T
    pixels = project(left, turned).astype(np.float32)
    return pixels[..., 0], pixels[..., 1], turned[..., 2].astype(np.float32)


def _within_one_thing(nearest: Float32, smooth: Float32) -> Float32:
    """Interpolated disparities, but the nearest at the border of two things: between them is a point in mid-air."""
    with np.errstate(invalid="ignore"):
        within = np.abs(smooth - nearest) < np.float32(STEP_PX)
    return np.where(within, smooth, nearest)


def match(
    cfg: StereoConfig,
    left: Camera,
    right: Camera,
    ego_T_left: Float,
    left_image: Image | None,
    right_image: Image | None,
) -> StereoDepth | Absent:
    """Depth of a stereo pair in the left camera's image: with its rectified intrinsics, but turned as it is mounted.

    Args:
        cfg: method, not ``off``, and thresholds.
        left: camera of ``left_image``.
        right: camera of ``right_image``, its ``baseline_m`` to the right of the left one along the rectified rows.
        ego_T_left: mounting of the left camera: how near the nearest road pixel is decides which disparities are tried.
        left_image: (H, W) grey; None where it could not be decoded.
        right_image: the same of the right camera.

    Returns:
        (H, W) float32 metres along z, NaN where the pair does not show it: hidden from the right camera, outside its
        image, ambiguous, or so far away that the disparity is mostly error. Or why there is none.
    """
    if left_image is None or right_image is None:
        return Absent(_without_images(left_image, right_image))
    baseline_m = _baseline_m(right)
    if isinstance(baseline_m, Reason):
        return Absent(baseline_m)
    fault = _fault(left, right, left_image, right_image)
    if fault is not None:
        return Absent(fault)
    ego_T_rectified = ego_T_left @ rigid(rectification(left).T, np.zeros(3))
    count = disparities_needed(left, baseline_m, ego_T_rectified) if cfg.disparities == "auto" else cfg.disparities
    if count is None:
        return Absent(Reason("stereo", "camera_below_road"))
    disparity_px = _rectified_disparity(cfg, count, left, right, left_image, right_image)
    return StereoDepth(left.frame_id, depth_of(cfg, left, baseline_m, turned_back(left, disparity_px)))


def disparities_needed(left: Camera, baseline_m: float, ego_T_rectified: Float) -> int | None:
    """Disparities from 0 that reach the nearest road pixel: a multiple of 16, no more than the image is wide.

    On a plane disparity is linear in the pixel, d = -f b (n . ray) / height, so that the largest is in a corner.

    Returns:
        Pixels; None where the road the mounting promises is not below the camera.
    """
    road = transform_plane(inverse(ego_T_rectified), Plane.of(np.array([0.0, 0.0, 1.0]), 0.0))
    if road.offset_m <= 0:
        return None
    right, bottom = left.width - 1.0, left.height - 1.0
    corners = rays(left, np.array([[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]]))
    disparity_px = left.fx * baseline_m * float(np.max(-corners @ road.n)) / road.offset_m
    return rounded_up(min(_NEARER * disparity_px, left.width))


def depth_of(cfg: StereoConfig, left: Camera, baseline_m: float, disparity_px: Float32) -> Float32:
    """(H, W) metres along z of (H, W) disparities in pixels; NaN below ``min_disparity_px`` and where unknown."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        depth_m = np.divide(np.float32(left.fx * baseline_m), disparity_px)
        np.copyto(depth_m, np.float32(np.nan), where=~(disparity_px >= np.float32(cfg.min_disparity_px)))
    return depth_m


def _baseline_m(right: Camera) -> float | Reason:
    """The distance of the pair's cameras, or why it cannot be theirs."""
    if right.baseline_m is None:
        return Reason("stereo", "no_baseline", _BASELINES_M)
    if not _BASELINES_M[0] <= right.baseline_m <= _BASELINES_M[1]:
        return Reason("stereo", "wrong_baseline", (right.baseline_m, *_BASELINES_M))
    return right.baseline_m


def _without_images(left_image: Image | None, right_image: Image | None) -> Reason:
    if left_image is None and right_image is None:
        return Reason("stereo", "no_left_no_right_image")
    return Reason("stereo", "no_left_image" if left_image is None else "no_right_image")


def _fault(left: Camera, right: Camera, left_image: Image, right_image: Image) -> Reason | None:
    """Why the two images are no pair that can be matched."""
    if left.size != right.size:
        return Reason("stereo", "pair_of_two_sizes", (left.width, left.height, right.width, right.height))
    for side, camera, image in (("left", left, left_image), ("right", right, right_image)):
        if image.shape != camera.size:
            return Reason("stereo", "pair_of_wrong_size", (side, *image.shape[::-1], camera.width, camera.height))
        fault = lens_fault(side, camera)
        if fault is not None:
            return fault
    return None


def _rectified_disparity(
    cfg: StereoConfig, count: int, left: Camera, right: Camera, left_grey: Image, right_grey: Image
) -> Float32:
    """(H, W) disparities visible to both cameras; images not rectified, or to other intrinsics, are resampled."""
    if left.lens is None and right.lens is None and right.same_view(left):
        disparity_px = disparity(cfg, count, left_grey, right_grey)
        disparity_px[_hidden_from_right(disparity_px, None)] = np.nan
        return disparity_px
    left_rectified, left_valid = resampled(left, left, left_grey)
    right_rectified, right_valid = resampled(right, left, right_grey)
    disparity_px = disparity(cfg, count, left_rectified, right_rectified)
    disparity_px[~left_valid] = np.nan
    disparity_px[_hidden_from_right(disparity_px, right_valid)] = np.nan
    return disparity_px


def _hidden_from_right(disparity_px: Float32, right_valid: Mask | None) -> Mask:
    """(H, W) pixels whose partner is unknown, outside the right image, or one of its pixels that are not valid."""
    columns = np.arange(disparity_px.shape[1], dtype=np.float32)
    with np.errstate(invalid="ignore"):
        inside = disparity_px <= columns
    if right_valid is not None:
        partner = np.rint(np.where(inside, columns - disparity_px, 0)).astype(np.intp)
        inside &= np.take_along_axis(right_valid, partner, axis=1)
    return ~inside
