"""The drivable surface: a plane through the road's points, and the pixels that lie on it.

Method: RANSAC (Fischler and Bolles 1981) over a seeded subsample, hypotheses from three points evaluated in batches,
then total least squares over all inliers. The road plane is nearly parallel to the optical axis, so the fit minimises
the distance to the plane, never an error along one axis.
"""

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import SurfaceConfig
from roadperc_stream.datatypes import Absent, Image, Mask, Surface, SurfaceSource
from roadperc_stream.geometry import (
    Camera,
    Float,
    Float32,
    Plane,
    camera_pitch_roll,
    facing,
    fit_plane,
    inverse,
    plane_distance,
    transform_plane,
)

_UP_EGO = np.array([0.0, 0.0, 1.0])
_CAMERA_CENTRE = np.zeros(3)
_LOWER_IMAGE = 0.6
"""Rows below this share of the image show the road in front of the car, where no segmentation says more."""
_COLLINEAR = 1e-3
"""Sine of the angle between two sides of a triangle below which its three points are taken for a line."""


def fit_surface(
    cfg: SurfaceConfig,
    camera: Camera,
    ego_T_camera: Float,
    depth_m: Float32,
    road: Mask | None,
    rng: np.random.Generator,
) -> Surface | Absent:
    """The road's plane from a depth image.

    Args:
        cfg: thresholds.
        camera: the camera the depth belongs to.
        ego_T_camera: its mounting, which says roughly where up is.
        depth_m: (H, W) metres, NaN unknown.
        road: (H, W) pixels of a drivable class as the depth camera sees them; None where there is no segmentation,
            then the lower image stands in and the surface is marked ``lower_image``.
        rng: source of the hypotheses.

    Returns:
        The surface, or why there is none.
    """
    source: SurfaceSource = "depth" if road is not None else "lower_image"
    points = _points(camera, depth_m, _usable(cfg, camera, depth_m, road))
    if len(points) < 3:
        return Absent(f"{len(points)} road pixels with known depth, a plane needs three")
    sample = points[rng.integers(0, len(points), min(cfg.subsample, len(points)))].astype(float)
    plane = _ransac(cfg, sample, inverse(ego_T_camera)[:3, :3] @ _UP_EGO, rng)
    if plane is None:
        return Absent(f"no plane through {len(points)} road points holds {cfg.min_inliers:.0%} of them")
    for cloud in (sample, points):  # the sample's refit is cheap, and leaves one pass over all points to do
        close = _close(cfg, plane, cloud)
        if np.count_nonzero(close) < 3:
            return Absent("no plane holds three of the road's points")
        plane = facing(fit_plane(cloud, close), _CAMERA_CENTRE)
    ratio = float(np.mean(_close(cfg, plane, points)))
    return _surface(source, camera, ego_T_camera, plane, ratio)


def assumed_surface(camera: Camera, ego_T_camera: Float) -> Surface:
    """The ground the mounting promises, where no depth tells: ego's plane z = 0, marked ``assumed``."""
    plane = transform_plane(inverse(ego_T_camera), Plane.of(_UP_EGO, 0.0))
    return _surface("assumed", camera, ego_T_camera, plane, None)


def drivable_mask(
    cfg: SurfaceConfig, surface: Surface | Absent, camera: Camera, depth_m: Float32 | None, road: Image | None
) -> Mask | Absent:
    """(H, W) pixels of a drivable class within ``drivable_m`` of the plane.

    Without depth the class alone decides, without segmentation the plane alone.

    Args:
        cfg: thresholds.
        surface: the plane, in the frame of ``camera``.
        camera: the camera of depth and segmentation.
        depth_m: (H, W) metres as that camera sees them, NaN unknown.
        road: (H, W) 1 where the class is drivable.
    """
    if depth_m is None:
        return road.view(bool) if road is not None else Absent("neither depth nor segmentation")
    if isinstance(surface, Absent):
        return Absent(f"no surface: {surface.reason}")
    distance = plane_distance(camera, depth_m, surface.plane)
    # A comparison with NaN is False in OpenCV as in numpy: unknown depth is never drivable.
    near = np.asarray(cv2.inRange(distance, -cfg.drivable_m, cfg.drivable_m), np.uint8)
    return (near if road is None else near * road).astype(bool)


def _usable(cfg: SurfaceConfig, camera: Camera, depth_m: Float32, road: Mask | None) -> Mask:
    """Pixels that may belong to the road and whose depth is known (a comparison with NaN is False)."""
    with np.errstate(invalid="ignore"):
        usable: Mask = depth_m < np.float32(cfg.max_depth_m)
    if road is not None:
        return usable & road
    usable[: int(camera.height * _LOWER_IMAGE)] = False
    return usable


def _points(camera: Camera, depth_m: Float32, mask: Mask) -> Float32:
    """(N, 3) points in the camera frame of the pixels of a mask.

    There are many: single precision, and each coordinate lies in one piece of memory.
    """
    x, y = _ray_grids(camera)
    z = depth_m[mask]
    return np.stack((x[mask] * z, y[mask] * z, z)).T


@lru_cache(maxsize=4)
def _ray_grids(camera: Camera) -> tuple[Float32, Float32]:
    """(H, W) x and y of every pixel's ray with z = 1."""
    x = ((np.arange(camera.width) - camera.cx) / camera.fx).astype(np.float32)
    y = ((np.arange(camera.height) - camera.cy) / camera.fy).astype(np.float32)
    return np.tile(x, (camera.height, 1)), np.tile(y[:, None], (1, camera.width))


def _close(cfg: SurfaceConfig, plane: Plane, points: NDArray[np.floating[Any]]) -> Mask:
    """Which of (N, 3) points lie within ``inlier_m`` of a plane."""
    distance = points @ plane.n.astype(points.dtype) + points.dtype.type(plane.offset_m)
    close: Mask = np.abs(distance) <= cfg.inlier_m
    return close


def _ransac(cfg: SurfaceConfig, points: Float, up: Float, rng: np.random.Generator) -> Plane | None:
    """The hypothesis that most points support; None where none is supported enough."""
    best, best_share = None, cfg.min_inliers
    for tried in range(0, cfg.hypotheses, cfg.batch):
        if best_share >= cfg.enough_inliers:
            break
        normals, offsets = _hypotheses(points, up, cfg.max_tilt_deg, min(cfg.batch, cfg.hypotheses - tried), rng)
        if not len(normals):
            continue
        shares = np.count_nonzero(np.abs(points @ normals.T + offsets) <= cfg.inlier_m, axis=0) / len(points)
        top = int(np.argmax(shares))
        if shares[top] > best_share:
            best, best_share = Plane.of(normals[top], float(offsets[top])), float(shares[top])
    return best


def _hypotheses(
    points: Float, up: Float, max_tilt_deg: float, count: int, rng: np.random.Generator
) -> tuple[Float, Float]:
    """Normals (M, 3), pointing up, and offsets (M,) of planes through three points that are no line and no wall."""
    a, b, c = np.moveaxis(points[rng.integers(0, len(points), (count, 3))], 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    sides = np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    proper = lengths > _COLLINEAR * sides
    normals = normals[proper] / lengths[proper, None]
    cosines = normals @ up
    normals *= np.where(cosines < 0, -1.0, 1.0)[:, None]
    level = np.abs(cosines) >= np.cos(np.radians(max_tilt_deg))
    normals = normals[level]
    return normals, -np.sum(normals * a[proper][level], axis=1)


def _surface(
    source: SurfaceSource, camera: Camera, ego_T_camera: Float, plane: Plane, inlier_ratio: float | None
) -> Surface:
    pitch, roll = camera_pitch_roll(plane)
    ego_plane = transform_plane(ego_T_camera, plane)
    return Surface(source, camera.frame_id, plane, ego_plane, plane.offset_m, pitch, roll, inlier_ratio)
