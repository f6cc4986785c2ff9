"""The cameras of a pair that is not rectified: their images resampled, and the disparities turned back again."""

from functools import lru_cache
from typing import Final

import cv2
import numpy as np

from roadperc_stream.chain.stages.stereo.matching import STEP_PX
from roadperc_stream.core.datatypes import Image, Mask, Reason
from roadperc_stream.core.geometry import Camera, Float, Float32, Lens, pinhole_fault, project, rays

_MODELS: Final = ("", "plumb_bob", "rational_polynomial")
"""Distortion models whose coefficients are those of OpenCV's pinhole."""
_NOT_TURNED: Final = 1e-6
"""Largest entry of R R^T - 1 of a rotation."""
_COEFFICIENTS: Final = (4, 5, 8, 12, 14)
"""Numbers of distortion coefficients that OpenCV's pinhole may have."""
_LARGEST_COEFFICIENT: Final = 1e4
"""A rational lens may have coefficients of hundreds, none has this."""


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
