"""Pinhole cameras: projection, rays, and projection matrices.

Camera frames are optical (x right, y down, z forward). Pixel centres are at integers from 0.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry.arrays import Float

_SQUARE: Final = 0.05
_SINGULAR: Final = 1e-9
"""Relative size below which a number counts as rounding error."""
_FOCAL_LENGTHS: Final = (1e-3, 1e3)
"""Shortest and longest plausible focal length, in image widths."""
_FARTHEST_CENTRE: Final = 10.0
"""Largest distance of the principal point from the first pixel, in image widths or heights; images may be cropped."""
_HALF_PIXEL: Final = 0.5
_SAME_PX: Final = 1e-9
"""Points that are nearer to each other are one point."""
_FOCAL_DIGITS: Final = 9
"""Decimals of a focal length, so that 90 degrees give exactly w / 2."""


@dataclass(frozen=True)
class Lens:
    """The optics of an unrectified image: a distorted pinhole camera and its rotation.

    ``R`` is the (3, 3) rotation, row by row, from this lens's frame to the rectified camera's, empty if it is unknown;
    ``model`` names the meaning of the camera's ``distortion``, as foxglove.CameraCalibration does.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    R: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    model: str = ""

    @property
    def K(self) -> Float:
        """(3, 3) intrinsic matrix, pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Camera:
    """A rectified pinhole camera; ``baseline_m`` is set on the right camera of a rectified pair (P[0, 3] = -fx b).

    With a ``lens`` or ``distortion`` its images are unrectified; ``geometry.rectification`` rectifies them.
    """

    frame_id: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    baseline_m: float | None = None
    distortion: tuple[float, ...] = ()
    lens: Lens | None = None

    @property
    def K(self) -> Float:
        """(3, 3) intrinsic matrix, pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns, as an array's shape."""
        return (self.height, self.width)

    @property
    def square_pixels(self) -> bool:
        """Whether fx and fy differ by at most 5 %; those of real cameras and CARLA differ by far less."""
        return abs(self.fx - self.fy) <= _SQUARE * max(self.fx, self.fy)

    def same_view(self, other: "Camera") -> bool:
        """Whether both cameras map a ray to the same pixel."""
        ours = (self.width, self.height, self.fx, self.fy, self.cx, self.cy)
        return ours == (other.width, other.height, other.fx, other.fy, other.cx, other.cy)


def pinhole_fault(width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> str | None:
    """Why these numbers are invalid for a pinhole camera with images of this size; None if they are valid.

    Beyond these limits, depths would only be rounding errors.
    """
    shortest, longest = (length * width for length in _FOCAL_LENGTHS)
    for name, found in (("fx", fx), ("fy", fy)):
        if not shortest <= found <= longest:  # this form also rejects NaN
            return f"{name} {found:g}: expected {shortest:g} to {longest:g} pixels for an image {width} pixels wide"
    for name, found, side in (("cx", cx, width), ("cy", cy, height)):
        if not abs(found) <= _FARTHEST_CENTRE * side:
            return f"{name} {found:g}: expected at most {_FARTHEST_CENTRE * side:g} pixels from 0 in an image of {side}"
    return None


Pinhole = tuple[float, float, float, float]
"""fx, fy, cx, cy in pixels, pixel centres at integers from 0."""


def pinhole_of_K(K: Float, pixel_origin: str) -> Pinhole:
    """The pinhole of K, moved by half a pixel if the principal point counts from the pixel's corner."""
    shift = _HALF_PIXEL if pixel_origin == "corner" else 0.0
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]) - shift, float(K[1, 2]) - shift


def pinhole_of_fov(fov_deg: float, width: int, height: int) -> Pinhole:
    """A pinhole with square pixels: f = w / (2 tan(fov / 2)), principal point at the image's centre."""
    f = round(float(width / (2.0 * np.tan(np.deg2rad(fov_deg) / 2.0))), _FOCAL_DIGITS)
    return f, f, (width - 1) / 2.0, (height - 1) / 2.0


def decompose_projection(P: Float) -> tuple[Float, Float, Float]:
    """K, R and the camera's centre of a projection matrix P ~ K [R | -R centre].

    P is known up to a factor of either sign. These choices make the RQ decomposition of P's left half unique: the
    diagonal of K is positive, K[2, 2] = 1 and det R = +1, so R is a rotation. Source: Hartley and Zisserman, Multiple
    View Geometry, 2004, section 6.2.4. P is (3, 4), in pixels.

    Returns:
        (3, 3) upper triangular K in pixels, (3, 3) rotation from the world's frame to the camera's, and the (3,) centre
        -R^T K^-1 p4 in the world's frame.

    Raises:
        ValueError: P has another shape, or is not finite, or its left half is singular.
    """
    if P.shape != (3, 4) or not np.isfinite(P).all():
        raise ValueError(f"expected a finite (3, 4) projection matrix, got {P.tolist()}")
    M = P[:, :3].astype(float)
    determinant = float(np.linalg.det(M))
    if abs(determinant) <= _SINGULAR * float(np.prod(np.linalg.norm(M, axis=1))):
        raise ValueError(f"expected a camera's projection matrix, got one with a singular left half: {P.tolist()}")
    upper, rotation = _rq(M * np.sign(determinant))
    signs = np.sign(np.diag(upper))
    K = upper * signs
    return K / K[2, 2], signs[:, None] * rotation, -np.linalg.solve(M, P[:, 3])


def _rq(M: Float) -> tuple[Float, Float]:
    """Upper triangular and orthogonal factor of a (3, 3) matrix: the QR decomposition of its mirror image."""
    Q, R = np.linalg.qr(M[::-1].T)
    return R.T[::-1, ::-1], Q.T[::-1]


def baseline_of(P_left: Float, P_right: Float) -> float:
    """Distance in metres between the centres of two (3, 4) projection matrices of one world frame.

    Raises:
        ValueError: a matrix is not a projection matrix, or both have the same centre.
    """
    left, right = decompose_projection(P_left)[2], decompose_projection(P_right)[2]
    baseline_m = float(np.linalg.norm(right - left))
    if baseline_m <= _SINGULAR * float(np.linalg.norm(left)):
        raise ValueError("both projection matrices have one and the same centre: expected two cameras of a stereo pair")
    return baseline_m


def project(camera: Camera, points: Float) -> Float:
    """(..., 2) pixels of (..., 3) points in the camera frame; NaN at or behind the camera."""
    z = np.where(points[..., 2] > 1e-6, points[..., 2], np.nan)
    pixels = np.empty((*z.shape, 2), z.dtype)
    pixels[..., 0] = camera.fx * points[..., 0] / z + camera.cx
    pixels[..., 1] = camera.fy * points[..., 1] / z + camera.cy
    return pixels


def rays(camera: Camera, pixels: Float) -> Float:
    """(..., 3) directions with z = 1 of (..., 2) pixels."""
    x = (pixels[..., 0] - camera.cx) / camera.fx
    y = (pixels[..., 1] - camera.cy) / camera.fy
    return np.stack((x, y, np.ones_like(x)), axis=-1)


def unproject(camera: Camera, pixels: Float, depth_m: NDArray[np.floating[Any]]) -> Float:
    """(..., 3) points in the camera frame of (..., 2) pixels with depth along z."""
    return rays(camera, pixels) * np.asarray(depth_m)[..., None]


def inside_image(line_px: Float, camera: Camera) -> Float:
    """(M, 2) part of an (N, 2) line inside the image, cut at its border; empty if none.

    Y.-D. Liang, B. A. Barsky, A new concept and method for line clipping, 1984.
    """
    start, step = line_px[:-1], np.diff(line_px, axis=0)
    low, high = np.full(2, -_HALF_PIXEL), np.array((camera.width, camera.height)) - _HALF_PIXEL
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = (low - start) / step, (high - start) / step
    enters = np.fmin(*crossings).max(axis=1, initial=0.0)
    leaves = np.fmax(*crossings).min(axis=1, initial=1.0)
    ends = np.stack([start + at[:, None] * step for at in (enters, leaves)], axis=1)
    inside: Float = ends[enters < leaves].reshape(-1, 2)
    apart = np.abs(np.diff(inside, axis=0)).max(axis=1, initial=0.0) > _SAME_PX
    line: Float = inside[np.append(True, apart)[: len(inside)]]
    return line
