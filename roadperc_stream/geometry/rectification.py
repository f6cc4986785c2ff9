"""Rectification: images, pixels and the camera without the distortion of a lens.

Models and their coefficients are those of OpenCV: ``plumb_bob`` (Brown and Conrady), ``rational_polynomial``, and
``equidistant`` (Kannala and Brandt, A Generic Camera Model, PAMI 2006), which ROS drivers also call ``fisheye``.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry.arrays import Float, Float32, Mask
from roadperc_stream.geometry.cameras import Camera, Lens, pinhole_fault

P = TypeVar("P", np.uint8, np.uint16, np.float32)
FISHEYE_MODELS: Final = ("equidistant", "fisheye")
MODELS: Final = ("", "plumb_bob", "rational_polynomial", *FISHEYE_MODELS)
"""Known distortion models; without a name the coefficients are those of OpenCV's pinhole."""
_COEFFICIENTS: Final = (4, 5, 8, 12, 14)
"""Numbers of distortion coefficients that OpenCV's pinhole may have; a fisheye has the first."""
_LARGEST_COEFFICIENT: Final = 1e4
"""Rational lenses have coefficients of up to some hundreds."""
_NOT_TURNED: Final = 1e-6
"""Largest entry of R R^T - 1 of a rotation."""
_CACHED: Final = 6
"""Maps in memory: the front, depth, left and right camera of a log, and two after a change."""
_ITERATIONS: Final = (50, 1e-3)
"""Most iterations of undistorting a point, and the error in pixels that is small enough; OpenCV's 5 leave 0.2 px."""
_BETWEEN: Final = 9
"""Points along each side of a box; straight sides become curves."""


def is_rectified(camera: Camera) -> bool:
    """Whether the images of a camera are those of its pinhole."""
    return camera.lens is None and not any(camera.distortion)


def lens_of(camera: Camera) -> Lens:
    """The lens of a camera; without one, the camera's own pinhole with unknown rotation if it has distortion."""
    if camera.lens is not None:
        return camera.lens
    return Lens(camera.fx, camera.fy, camera.cx, camera.cy, () if any(camera.distortion) else Lens.R)


def rotation_of(camera: Camera) -> Float:
    """(3, 3) rotation from the mounted camera to the rectified camera; the identity if it is unknown."""
    return np.array(lens_of(camera).R or Lens.R).reshape(3, 3)


def rectified(camera: Camera) -> Camera:
    """The camera of the rectified image."""
    return replace(camera, distortion=(), lens=None)


def not_turned(camera: Camera) -> Camera:
    """The camera with a lens that is rectified without the rotation, so that its mounting stays."""
    return replace(camera, lens=replace(lens_of(camera), R=Lens.R))


def lens_fault(camera: Camera) -> tuple[str, tuple[Any, ...]] | None:
    """The code of a reason and its details if the lens is impossible or unknown; None if it can be undone.

    The codes are those of ``model.reason`` that begin with ``lens_``.
    """
    lens, coefficients = lens_of(camera), camera.distortion  # an empty list means no distortion
    pinhole = pinhole_fault(camera.width, camera.height, lens.fx, lens.fy, lens.cx, lens.cy)
    if pinhole is not None:
        return "lens_without_camera_matrix", (pinhole,)
    if not _is_rotation(rotation_of(camera)):
        return "lens_rotation_invalid", (str(list(lens.R)),)
    if lens.model not in MODELS:
        return "lens_model_unknown", (lens.model, ", ".join(filter(None, MODELS)))
    counts = _COEFFICIENTS[:1] if lens.model in FISHEYE_MODELS else _COEFFICIENTS
    if coefficients and len(coefficients) not in counts:
        return "lens_coefficient_count", (len(coefficients), ", ".join(map(str, counts)))
    wild = [d for d in coefficients if not abs(d) <= _LARGEST_COEFFICIENT]
    return ("lens_coefficient_size", (wild[0], _LARGEST_COEFFICIENT)) if wild else None


def _is_rotation(R: Float) -> bool:
    """Whether a (3, 3) matrix is finite, orthonormal and does not mirror."""
    if not np.isfinite(R).all():
        return False
    return bool(np.abs(R @ R.T - np.eye(3)).max() <= _NOT_TURNED and np.linalg.det(R) > 0)


@lru_cache(maxsize=_CACHED)
def rectification_maps(camera: Camera, target: Camera) -> tuple[Float32, Float32, Mask]:
    """(H, W) columns and rows in the camera's image of the target's pixels, and whether they lie inside it."""
    import cv2

    lens, D = lens_of(camera), np.array(camera.distortion)
    size = (target.width, target.height)
    fisheye = lens.model in FISHEYE_MODELS and D.size
    undistort = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
    columns, rows = undistort(lens.K, D, rotation_of(camera), target.K, size, cv2.CV_32FC1)
    valid = (columns >= 0) & (columns <= camera.width - 1) & (rows >= 0) & (rows <= camera.height - 1)
    return np.asarray(columns, np.float32), np.asarray(rows, np.float32), valid


def resampled(camera: Camera, target: Camera, image: NDArray[P], *, nearest: bool = False) -> NDArray[P]:
    """The (H, W) or (H, W, channels) image resampled to the target camera, with 0 outside the image (NaN in floats).

    ``nearest`` keeps values that cannot be mixed, such as tags and depth.
    """
    import cv2

    columns, rows, _ = rectification_maps(camera, target)
    border = np.nan if image.dtype.kind == "f" else 0
    interpolation = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
    found: NDArray[P] = cv2.remap(image, columns, rows, interpolation, borderValue=(border,) * 4)  # type: ignore[assignment]
    return found


def rectified_pixels(camera: Camera, target: Camera, pixels: Float) -> Float:
    """(N, 2) pixels of the target camera of (N, 2) pixels of the camera's image."""
    import cv2

    lens, D = lens_of(camera), np.array(camera.distortion)
    points, R = np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2), rotation_of(camera)
    if lens.model in FISHEYE_MODELS and D.size:
        found = cv2.fisheye.undistortPoints(points, lens.K, D, R=R, P=target.K)
    else:
        ends = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, *_ITERATIONS)
        found = cv2.undistortPoints(points, lens.K, D, R=R, P=target.K, criteria=ends)
    return np.asarray(found, np.float64).reshape(-1, 2)


def rectified_box(camera: Camera, target: Camera, box_px: tuple[float, ...]) -> tuple[float, float, float, float]:
    """The half-open box x_min, y_min, x_max, y_max around a box's curved sides in the target's image, clipped to it."""
    x_min, y_min, x_max, y_max = np.array(box_px) - 0.5  # sides lie between pixel centres
    x, y = np.linspace(x_min, x_max, _BETWEEN), np.linspace(y_min, y_max, _BETWEEN)
    along = [(x, np.full_like(x, y_min)), (x, np.full_like(x, y_max)), (np.full_like(y, x_min), y)]
    along.append((np.full_like(y, x_max), y))
    inside = np.concatenate([np.stack(side, axis=-1) for side in along])
    found = rectified_pixels(camera, target, np.clip(inside, -0.5, np.array([camera.width, camera.height]) - 0.5)) + 0.5
    found = np.clip(found, 0.0, (target.width, target.height))
    (left, top), (right, bottom) = found.min(axis=0), found.max(axis=0)
    return float(left), float(top), float(right), float(bottom)
