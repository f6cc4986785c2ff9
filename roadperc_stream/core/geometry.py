"""Pinhole cameras, rigid transforms and planes: pure functions on arrays.

Names follow ``a_T_b``: a (4, 4) matrix that maps coordinates in frame b to frame a. Camera frames are optical (x right,
y down, z forward), ego and odom are x forward, y left, z up. Pixel centres are at integers from 0.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]

EGO_R_OPTICAL: Final[Float] = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation of a camera that looks along ego's x axis, level."""
_SQUARE: Final = 0.05
_SINGULAR: Final = 1e-9
"""Share of a matrix's or a position's size below which a number is rounding."""
_FOCAL_LENGTHS: Final = (1e-3, 1e3)
"""Shortest and longest focal length of a camera, in image widths: far wider and far narrower than any lens."""
_FARTHEST_CENTRE: Final = 10.0
"""Image widths or heights by which the principal point may lie from the first pixel: the image may be cut out."""


@dataclass(frozen=True)
class Lens:
    """The optics of an image that is not rectified yet: a pinhole of its own, distorted, and turned.

    ``R`` is the (3, 3) rotation, row by row, from this lens's frame to the rectified camera's; ``model`` names the
    meaning of the camera's ``distortion``, as foxglove.CameraCalibration does.
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

    With a ``lens`` its images are not rectified yet, and the lens says how to; with ``distortion`` but no lens nobody
    knows how.
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
        """Whether fx and fy differ by no more than 5 %: those of real cameras and of CARLA's differ by far less."""
        return abs(self.fx - self.fy) <= _SQUARE * max(self.fx, self.fy)

    def same_view(self, other: "Camera") -> bool:
        """Whether both cameras map a ray to the same pixel."""
        ours = (self.width, self.height, self.fx, self.fy, self.cx, self.cy)
        return ours == (other.width, other.height, other.fx, other.fy, other.cx, other.cy)


def pinhole_fault(width: int, height: int, fx: float, fy: float, cx: float, cy: float) -> str | None:
    """Why pixels of an image of that size cannot be those of a pinhole camera; None where they can.

    Numbers beyond these limits are no camera's, and what follows from them is no depth but rounding.
    """
    shortest, longest = (length * width for length in _FOCAL_LENGTHS)
    for name, found in (("fx", fx), ("fy", fy)):
        if not shortest <= found <= longest:  # so put, NaN is refused too
            return f"{name} {found:g}: expected {shortest:g} to {longest:g} pixels for an image {width} pixels wide"
    for name, found, side in (("cx", cx, width), ("cy", cy, height)):
        if not abs(found) <= _FARTHEST_CENTRE * side:
            return f"{name} {found:g}: expected at most {_FARTHEST_CENTRE * side:g} pixels from 0 in an image of {side}"
    return None


def decompose_projection(P: Float) -> tuple[Float, Float, Float]:
    """K, R and the camera's centre of a projection matrix P ~ K [R | -R centre].

    P is known up to a factor of either sign. What is left free by the RQ decomposition of P's left half is fixed thus:
    the diagonal of K is positive, K[2, 2] = 1 and det R = +1, so that R is a rotation and never a mirror.
    Source: Hartley and Zisserman, Multiple View Geometry, 2004, section 6.2.4.

    Args:
        P: (3, 4), pixels.

    Returns:
        (3, 3) upper triangular K in pixels, (3, 3) rotation from the world's frame to the camera's, and the (3,) centre
        -R^T K^-1 p4 in the world's frame.

    Raises:
        ValueError: P is of another shape, not finite, or singular: it has no camera at a finite place.
    """
    if P.shape != (3, 4) or not np.isfinite(P).all():
        raise ValueError(f"expected a finite (3, 4) projection matrix, got {P.tolist()}")
    M = P[:, :3].astype(float)
    determinant = float(np.linalg.det(M))
    if abs(determinant) <= _SINGULAR * float(np.prod(np.linalg.norm(M, axis=1))):
        raise ValueError(f"no projection matrix of a camera: its left half is singular: {P.tolist()}")
    upper, rotation = _rq(M * np.sign(determinant))
    signs = np.sign(np.diag(upper))
    K = upper * signs
    return K / K[2, 2], signs[:, None] * rotation, -np.linalg.solve(M, P[:, 3])


def _rq(M: Float) -> tuple[Float, Float]:
    """Upper triangular and orthogonal factor of a (3, 3) matrix: the QR decomposition of its mirror image."""
    Q, R = np.linalg.qr(M[::-1].T)
    return R.T[::-1, ::-1], Q.T[::-1]


def baseline_of(P_left: Float, P_right: Float) -> float:
    """Distance in metres of the centres of two (3, 4) projection matrices that share a world.

    Raises:
        ValueError: a matrix is no projection, or both have one centre.
    """
    left, right = decompose_projection(P_left)[2], decompose_projection(P_right)[2]
    baseline_m = float(np.linalg.norm(right - left))
    if baseline_m <= _SINGULAR * float(np.linalg.norm(left)):
        raise ValueError("both projection matrices have one and the same centre: no stereo pair")
    return baseline_m


@dataclass(frozen=True)
class Plane:
    """Points X with normal . X + offset_m = 0; the normal has unit length and points up, away from the road."""

    normal: tuple[float, float, float]
    offset_m: float

    @classmethod
    def of(cls, normal: Float, offset_m: float) -> "Plane":
        """A plane from any normal that is not zero; it is scaled to unit length, offset included."""
        length = float(np.linalg.norm(normal))
        x, y, z = (float(c) / length for c in normal)
        return cls((x, y, z), float(offset_m) / length)

    @property
    def n(self) -> Float:
        """(3,) the normal as an array."""
        return np.array(self.normal)

    def distance(self, points: Float) -> Float:
        """Signed distance in metres of (..., 3) points, positive above the plane."""
        result: Float = points @ self.n + self.offset_m
        return result


def rigid(rotation: Float, translation: Float) -> Float:
    """(4, 4) transform from a (3, 3) rotation and a (3,) translation in metres."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, translation
    return T


def inverse(a_T_b: Float) -> Float:
    """b_T_a of a rigid transform."""
    R = a_T_b[:3, :3].T
    return rigid(R, -R @ a_T_b[:3, 3])


def adjoint(a_T_b: Float) -> Float:
    """(6, 6) matrix that brings a small translation and rotation, fixed to a body, from frame b's axes to frame a's.

    Source: Murray, Li and Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, section 2.4.2.
    """
    R, lever = a_T_b[:3, :3], a_T_b[:3, 3]
    result = np.zeros((6, 6))
    result[:3, :3] = result[3:, 3:] = R
    result[:3, 3:] = np.cross(lever, R, axisb=0, axisc=0)
    return result


def transform(a_T_b: Float, points_b: Float) -> Float:
    """(..., 3) points in frame a."""
    result: Float = points_b @ a_T_b[:3, :3].T + a_T_b[:3, 3]
    return result


def level_mounting(height_m: float) -> Float:
    """ego_T_camera of a level camera above the ego origin, looking along ego's x axis."""
    return rigid(EGO_R_OPTICAL, np.array([0.0, 0.0, height_m]))


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


def intersect_plane(camera: Camera, pixels: Float, plane: Plane) -> Float:
    """(..., 3) points where the pixels' rays meet the plane (camera frame); NaN where they never do in front."""
    directions = rays(camera, pixels)
    slope = directions @ plane.n
    with np.errstate(divide="ignore"):
        depth = np.where(slope < 0, -plane.offset_m / slope, np.nan)
    return directions * depth[..., None]


def distance_per_depth(camera: Camera, plane: Plane) -> tuple[Float32, Float32]:
    """(W,) part of every column, and (H,) of every row, of n . ray, by which the distance to a plane grows with depth.

    The signed distance of pixel (u, v) at depth z is z (n . ray) + offset: no points are needed.

    Args:
        camera: of the depth.
        plane: in its frame.
    """
    nx, ny, nz = plane.normal
    column = (np.arange(camera.width) - camera.cx) * (nx / camera.fx)
    row = (np.arange(camera.height) - camera.cy) * (ny / camera.fy) + nz
    return column.astype(np.float32), row.astype(np.float32)


def transform_plane(a_T_b: Float, plane_b: Plane) -> Plane:
    """The same plane in frame a."""
    normal = a_T_b[:3, :3] @ plane_b.n
    return Plane.of(normal, plane_b.offset_m - float(normal @ a_T_b[:3, 3]))


def fit_plane(points: NDArray[np.floating[Any]], chosen: NDArray[np.bool_] | None = None) -> Plane:
    """Total least squares plane of (N, 3) points: the direction of least scatter about the centroid.

    The sign is free; see ``facing`` to choose it. Source: the eigenvector of the smallest eigenvalue of the scatter
    matrix (Pearson 1901).

    Args:
        points: metres.
        chosen: (N,) the points that count; None for all.

    Raises:
        ValueError: fewer than three points count.
    """
    weights = np.ones(len(points), points.dtype) if chosen is None else chosen.astype(points.dtype)
    count = float(weights.sum())
    if count < 3:
        raise ValueError(f"a plane needs three points, got {count:.0f}")
    centroid = (weights @ points).astype(float) / count
    centred = (points - centroid.astype(points.dtype)).T
    # Six dot products, for the lower triangle alone is read: a matrix product of two such thin ones takes far longer.
    scatter, weighted = np.zeros((3, 3)), np.empty_like(weights)
    for i, coordinate in enumerate(centred):
        np.multiply(weights, coordinate, out=weighted)
        scatter[i, : i + 1] = [weighted @ other for other in centred[: i + 1]]
    return plane_of_scatter(centroid, scatter)


def plane_of_scatter(centroid: Float, scatter: Float) -> Plane:
    """The plane through a (3,) centroid in the direction of least scatter, as of ``fit_plane``.

    Args:
        centroid: metres.
        scatter: (3, 3) about the centroid; what lies above the diagonal is not read.
    """
    _, vectors = np.linalg.eigh(scatter, UPLO="L")
    normal = vectors[:, 0]
    return Plane.of(normal, -float(normal @ centroid))


def facing(plane: Plane, point: Float) -> Plane:
    """The plane with its normal turned to the side on which the point lies."""
    if float(plane.distance(point)) >= 0:
        return plane
    return Plane.of(-plane.n, -plane.offset_m)


def camera_pitch_roll(plane: Plane) -> tuple[float, float]:
    """Pitch (nose down positive) and roll (right side down positive) in radians of a camera against a plane.

    The plane is given in the camera frame. A level camera over a level road has the normal (0, -1, 0).
    """
    nx, ny, nz = plane.normal
    return float(-np.arcsin(np.clip(nz, -1.0, 1.0))), float(np.arctan2(-nx, -ny))


def angle_between(a: Float, b: Float) -> float:
    """Angle in radians between two (3,) vectors, accurate for small angles."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
