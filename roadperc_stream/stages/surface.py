"""The drivable surface: a plane through the road's points, and the pixels that lie on it.

Method: RANSAC (Fischler and Bolles 1981) over a seeded subsample, hypotheses from three points evaluated in batches,
then total least squares over all inliers. The road plane is nearly parallel to the optical axis, so the fit minimises
the distance to the plane, never an error along one axis.
"""

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
    unproject,
)

_UP_EGO = np.array([0.0, 0.0, 1.0])
_CAMERA_CENTRE = np.zeros(3)
_LOWER_IMAGE = 0.6
"""Rows below this share of the image show the road in front of the car, where no segmentation says more."""
_COLLINEAR = 1e-3
"""Sine of the angle between two sides of a triangle below which its three points are taken for a line."""
_REFITS = 2


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
    pixels = np.flatnonzero(_usable(cfg, camera, depth_m, road))
    if len(pixels) < 3:
        return Absent(f"{len(pixels)} road pixels with known depth, a plane needs three")
    sample = _points(camera, depth_m, rng.choice(pixels, min(cfg.subsample, len(pixels)), replace=False))
    plane = _ransac(cfg, sample, inverse(ego_T_camera)[:3, :3] @ _UP_EGO, rng)
    if plane is None:
        return Absent(f"no plane through {len(sample)} road points holds {cfg.min_inliers:.0%} of them")
    points = _points(camera, depth_m, pixels)
    for _ in range(_REFITS):
        inliers = points[np.abs(plane.distance(points)) <= cfg.inlier_m]
        if len(inliers) < 3:
            return Absent("no plane holds three of the road's points")
        plane = facing(fit_plane(inliers), _CAMERA_CENTRE)
    ratio = float(np.mean(np.abs(plane.distance(points)) <= cfg.inlier_m))
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
        return road.astype(bool) if road is not None else Absent("neither depth nor segmentation")
    if isinstance(surface, Absent):
        return Absent(f"no surface: {surface.reason}")
    with np.errstate(invalid="ignore"):
        near: Mask = np.abs(plane_distance(camera, depth_m, surface.plane)) <= cfg.drivable_m
    return near if road is None else near & road.astype(bool)


def _usable(cfg: SurfaceConfig, camera: Camera, depth_m: Float32, road: Mask | None) -> Mask:
    """Pixels that may belong to the road and whose depth is known (a comparison with NaN is False)."""
    with np.errstate(invalid="ignore"):
        usable: Mask = depth_m < np.float32(cfg.max_depth_m)
    if road is not None:
        return usable & road
    usable[: int(camera.height * _LOWER_IMAGE)] = False
    return usable


def _points(camera: Camera, depth_m: Float32, pixels: NDArray[np.intp]) -> Float:
    """(N, 3) points in the camera frame of flat pixel indices."""
    rows, columns = np.divmod(pixels, camera.width)
    return unproject(camera, np.stack((columns, rows), axis=-1).astype(float), depth_m.ravel()[pixels])


def _ransac(cfg: SurfaceConfig, points: Float, up: Float, rng: np.random.Generator) -> Plane | None:
    """The hypothesis that most points support; None where none is supported enough."""
    best, best_share = None, cfg.min_inliers
    for _ in range(0, cfg.hypotheses, cfg.batch):
        normals, offsets = _hypotheses(points, up, cfg, rng)
        if not len(normals):
            continue
        shares = (np.abs(points @ normals.T + offsets) <= cfg.inlier_m).mean(axis=0)
        top = int(np.argmax(shares))
        if shares[top] > best_share:
            best, best_share = Plane.of(normals[top], float(offsets[top])), float(shares[top])
        if best_share >= cfg.enough_inliers:
            break
    return best


def _hypotheses(points: Float, up: Float, cfg: SurfaceConfig, rng: np.random.Generator) -> tuple[Float, Float]:
    """Normals (M, 3), pointing up, and offsets (M,) of planes through three points that are no line and no wall."""
    a, b, c = np.moveaxis(points[rng.integers(0, len(points), (cfg.batch, 3))], 1, 0)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    sides = np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    proper = lengths > _COLLINEAR * sides
    normals = normals[proper] / lengths[proper, None]
    cosines = normals @ up
    normals *= np.where(cosines < 0, -1.0, 1.0)[:, None]
    level = np.abs(cosines) >= np.cos(np.radians(cfg.max_tilt_deg))
    normals = normals[level]
    return normals, -np.sum(normals * a[proper][level], axis=1)


def _surface(
    source: SurfaceSource, camera: Camera, ego_T_camera: Float, plane: Plane, inlier_ratio: float | None
) -> Surface:
    pitch, roll = camera_pitch_roll(plane)
    ego_plane = transform_plane(ego_T_camera, plane)
    return Surface(source, camera.frame_id, plane, ego_plane, plane.offset_m, pitch, roll, inlier_ratio)
