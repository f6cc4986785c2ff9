"""The road of one frame: what depth and segmentation say of it, and which pixels show it."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np

from roadperc_stream.chain.stages.surface.plane import road_plane
from roadperc_stream.chain.stages.surface.spline import fit_height_grid
from roadperc_stream.core.config import SurfaceConfig
from roadperc_stream.core.datatypes import Absent, Image, Mask, Surface, SurfaceSource
from roadperc_stream.core.geometry import (
    Camera,
    Float,
    Float32,
    Plane,
    camera_pitch_roll,
    inverse,
    plane_distance,
    project,
    transform,
    transform_plane,
)
from roadperc_stream.core.ground import ego_points, height_above, height_at, part

_UP_EGO = np.array([0.0, 0.0, 1.0])
_LOWER_IMAGE = 0.6
"""Rows below this share of the image show the road in front of the car, where no segmentation says more."""

_FIELD_SAMPLES_M = np.arange(0.0, 201.0, 10.0), np.arange(-80.0, 81.0, 20.0)
"""Ego x and y at which a height field's highest row in the image is looked for: as far as heights are looked up."""


def fit_surface(
    cfg: SurfaceConfig,
    camera: Camera,
    ego_T_camera: Float,
    depth_m: Float32,
    road: Mask | None,
    rng: np.random.Generator,
) -> Surface | Absent:
    """The road from a depth image: its plane, and with the model ``spline`` its height field too.

    Args:
        cfg: thresholds.
        camera: the camera the depth belongs to.
        ego_T_camera: its mounting, which says roughly where up is.
        depth_m: (H, W) metres, NaN unknown.
        road: (H, W) pixels of a drivable class as the depth camera sees them; None where there is no segmentation,
            then the lower image stands in and the surface is marked ``lower_image``.
        rng: source of the hypotheses.

    Returns:
        The surface, or why there is none. Where too few points support a height field the plane stays.
    """
    source: SurfaceSource = "depth" if road is not None else "lower_image"
    usable = _usable(cfg, camera, depth_m, road)
    found = road_plane(cfg, _points(camera, depth_m, usable), inverse(ego_T_camera)[:3, :3] @ _UP_EGO, rng)
    if isinstance(found, Absent):
        return found
    surface = _surface(source, camera, ego_T_camera, *found)
    if cfg.model == "plane":
        return surface
    grid = fit_height_grid(cfg, surface, camera, ego_T_camera, depth_m, usable)
    return surface if grid is None else replace(surface, model="spline", height_grid=grid)


def assumed_surface(camera: Camera, ego_T_camera: Float) -> Surface:
    """The ground the mounting promises, where no depth tells: ego's plane z = 0, marked ``assumed``."""
    plane = transform_plane(inverse(ego_T_camera), Plane.of(_UP_EGO, 0.0))
    return _surface("assumed", camera, ego_T_camera, plane, None)


def drivable_mask(
    cfg: SurfaceConfig,
    surface: Surface | Absent,
    camera: Camera,
    depth_m: Float32 | None,
    road: Image | None,
    ego_T_camera: Float,
) -> Mask | Absent:
    """(H, W) pixels of a drivable class within ``drivable_m`` of the surface.

    The distance to a plane is taken at right angles, that to a height field vertically: on a slope of 10 % that is
    half a percent more. Without depth the class alone decides, without segmentation the surface alone.

    Args:
        cfg: thresholds.
        surface: the road, its plane in the frame of ``camera``.
        camera: the camera of depth and segmentation.
        depth_m: (H, W) metres as that camera sees them, NaN unknown.
        road: (H, W) 1 where the class is drivable.
        ego_T_camera: the camera's mounting, which places a height field before it.
    """
    if depth_m is None:
        return road.view(bool) if road is not None else Absent("neither depth nor segmentation")
    if isinstance(surface, Absent):
        return Absent(f"no surface: {surface.reason}")
    if surface.height_grid is None:
        return _near(cfg, plane_distance(camera, depth_m, surface.plane), road)
    top = max(_horizon_row(surface, camera, ego_T_camera), 0 if road is None else _first_row(road))
    mask = np.zeros(camera.size, bool)
    lower = ego_points(part(camera, top, 1, 1), ego_T_camera, depth_m[top:])
    mask[top:] = _near(cfg, height_above(surface, *lower), None if road is None else road[top:])
    return mask


def _near(cfg: SurfaceConfig, distance_m: Float32, road: Image | None) -> Mask:
    # A comparison with NaN is False in OpenCV as in numpy: unknown depth is never drivable.
    near = np.asarray(cv2.inRange(distance_m, -cfg.drivable_m, cfg.drivable_m), np.uint8)
    return (near if road is None else near * road).astype(bool)


def _first_row(road: Image) -> int:
    """The first row that shows a drivable class; the last one where none does."""
    rows = np.flatnonzero(road.view(bool).any(axis=1))
    return int(rows[0]) if len(rows) else len(road) - 1


def _horizon_row(surface: Surface, camera: Camera, ego_T_camera: Float) -> int:
    """A row above which no pixel lies on the surface, with a metre to spare; the image's last row at most."""
    x, y = np.meshgrid(*_FIELD_SAMPLES_M)
    points = np.stack((x, y, height_at(surface, x, y) + 1.0), axis=-1)
    rows = project(camera, transform(inverse(ego_T_camera), points))[..., 1]
    return int(np.clip(np.floor(np.nanmin(rows, initial=camera.height)), 0, camera.height - 1))


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


def _surface(
    source: SurfaceSource, camera: Camera, ego_T_camera: Float, plane: Plane, inlier_ratio: float | None
) -> Surface:
    pitch, roll = camera_pitch_roll(plane)
    ego_plane = transform_plane(ego_T_camera, plane)
    return Surface(source, camera.frame_id, plane, ego_plane, plane.offset_m, pitch, roll, inlier_ratio)
