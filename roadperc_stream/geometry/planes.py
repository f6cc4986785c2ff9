"""Planes, and the road as a plane or a height field."""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry.arrays import Float, Float32, read_only
from roadperc_stream.geometry.cameras import Camera, rays
from roadperc_stream.geometry.rotations import transform

SurfaceSource = Literal["depth", "stereo", "lidar", "lower_image", "held", "estimated", "assumed", "truth"]
SurfaceModel = Literal["plane", "spline"]


@dataclass(frozen=True)
class Plane:
    """Points X with normal . X + offset_m = 0; the normal has unit length and points up, away from the road."""

    normal: tuple[float, float, float]
    offset_m: float

    @classmethod
    def of(cls, normal: Float, offset_m: float) -> "Plane":
        """A plane from a normal of any length above zero, scaled to unit length together with the offset."""
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


@dataclass(frozen=True, eq=False)
class HeightGrid:
    """Road height z in metres at x = x_min_m + column * step_m, y = y_min_m + row * step_m (ego frame).

    Grids are hashed by identity, so functions of a grid can be cached.
    """

    x_min_m: float
    y_min_m: float
    step_m: float
    z_m: Float32 = field(repr=False)

    def __post_init__(self) -> None:
        read_only(self.z_m, np.float32, (None, None), "z_m")


@dataclass(frozen=True, eq=False)
class PlaneSearch:
    """How RANSAC found a plane, for pictures. Points and triples are in the ego frame, metres.

    ``points`` (N, 3) is the subsample that decides. ``triples`` (K, 3, 3) are the three points of each of the best
    hypotheses, the best first, and ``shares`` (K,) their shares of points within ``inlier_m``. ``compared`` is the
    number of all hypotheses that were neither collinear nor tilted.
    """

    points: Float = field(repr=False)
    triples: Float = field(repr=False)
    shares: Float = field(repr=False)
    compared: int
    inlier_m: float

    def __post_init__(self) -> None:
        read_only(self.points, np.float64, (None, 3), "points")
        read_only(self.triples, np.float64, (None, 3, 3), "triples")
        read_only(self.shares, np.float64, (len(self.triples),), "shares")
        if not len(self.points) or not len(self.triples):
            raise ValueError("a search needs points and a hypothesis")

    def seen_from(self, a_T_b: Float) -> "PlaneSearch":
        """The same search with its points in frame a."""
        points, triples = (transform(a_T_b, points_b) for points_b in (self.points, self.triples))
        return replace(self, points=points, triples=triples)


@dataclass(frozen=True)
class Surface:
    """The road's plane in the frame ``frame_id`` of the camera its depth belongs to, and the same in the ego frame.

    ``pitch`` (nose down positive) and ``roll`` (right side down positive) are the camera's against the plane, radians.
    ``inlier_ratio`` is the share of the road's points on the plane, None for a plane that was not fitted to points.
    ``search`` tells how RANSAC found the plane, None for all others.
    """

    source: SurfaceSource
    frame_id: str
    plane: Plane
    ego_plane: Plane
    camera_height_m: float
    pitch: float
    roll: float
    inlier_ratio: float | None = None
    model: SurfaceModel = "plane"
    height_grid: HeightGrid | None = None
    search: PlaneSearch | None = field(default=None, repr=False, compare=False)

    @classmethod
    def of(
        cls,
        source: SurfaceSource,
        camera: Camera,
        ego_T_camera: Float,
        plane: Plane,
        inlier_ratio: float | None = None,
        search: PlaneSearch | None = None,
    ) -> "Surface":
        """The surface with a plane in the frame of a camera, whose mounting is (4, 4) ``ego_T_camera``."""
        pitch, roll = camera_pitch_roll(plane)
        ego_plane = transform_plane(ego_T_camera, plane)
        height_m = plane.offset_m
        return cls(source, camera.frame_id, plane, ego_plane, height_m, pitch, roll, inlier_ratio, search=search)

    def __str__(self) -> str:
        angles = f"pitch {np.degrees(self.pitch):.2f} deg, roll {np.degrees(self.roll):.2f} deg"
        return f"surface: {self.source}, camera {self.camera_height_m:.2f} m above the road, {angles}"

    @property
    def measured(self) -> bool:
        """Whether this frame's depth shows the road: the plane is not held, estimated or assumed."""
        return self.source not in ("held", "estimated", "assumed")

    @property
    def abd(self) -> tuple[float, float, float]:
        """The plane as a x + b y + z = d in the ego frame: a and b without unit, d in metres."""
        nx, ny, nz = self.ego_plane.normal
        return nx / nz, ny / nz, -self.ego_plane.offset_m / nz


def intersect_plane(camera: Camera, pixels: Float, plane: Plane) -> Float:
    """(..., 3) points where the pixels' rays meet the plane (camera frame); NaN without a point in front."""
    directions = rays(camera, pixels)
    slope = directions @ plane.n
    with np.errstate(divide="ignore"):
        depth = np.where(slope < 0, -plane.offset_m / slope, np.nan)
    return directions * depth[..., None]


def distance_per_depth(camera: Camera, plane: Plane) -> tuple[Float32, Float32]:
    """(W,) column and (H,) row terms of n . ray, the growth of the distance to a plane with depth.

    The signed distance of pixel (u, v) at depth z is z (n . ray) + offset, without computing points.
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

    The sign is free; see ``facing`` to choose it. With ``chosen`` (N,) only those points count. Source: the eigenvector
    of the smallest eigenvalue of the scatter matrix (Pearson 1901).

    Raises:
        ValueError: fewer than three points count.
    """
    weights = np.ones(len(points)) if chosen is None else chosen.astype(float)
    count = float(weights.sum())
    if count < 3:
        raise ValueError(f"a plane needs three points, got {count:.0f}")
    coordinates = points.T.astype(float, order="C")  # matrix products of three long rows are fast
    centroid = coordinates @ weights / count
    coordinates -= centroid[:, None]
    _, vectors = np.linalg.eigh(coordinates * weights @ coordinates.T)
    normal = vectors[:, 0]
    return Plane.of(normal, -float(normal @ centroid))


def facing(plane: Plane, point: Float) -> Plane:
    """The plane with its normal turned to the side on which the point lies."""
    return plane if float(plane.distance(point)) >= 0 else Plane.of(-plane.n, -plane.offset_m)


def camera_pitch_roll(plane: Plane) -> tuple[float, float]:
    """Pitch (nose down positive) and roll (right side down positive) in radians of a camera against a plane.

    The plane is given in the camera frame. A level camera over a level road has the normal (0, -1, 0).
    """
    nx, ny, nz = plane.normal
    return float(-np.arcsin(np.clip(nz, -1.0, 1.0))), float(np.arctan2(-nx, -ny))


def angle_between(a: Float, b: Float) -> float:
    """Angle in radians between two (3,) vectors, accurate for small angles."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
