"""What is free and what is occupied around the car: a bird's-eye grid in the ego frame from depth and tags.

Occupied are cells with points that stand above the road, or belong to an obstacle. Free are cells with drivable points,
and cells whose middle, projected into the image, is drivable and as far away as the cell: far ahead neighbouring rows
of the image are metres apart, and this inverse mapping leaves no gaps between them. Everything else is unknown, so also
what lies behind an obstacle. Occupied wins over free.

Of a lidar's few points every one counts, and a cell whose middle is visible as drivable is free without one. Heights
alone decide there what is an obstacle: a point that an obstacle hides from the camera but not from the lidar has the
obstacle's tag.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.config import OccupancyConfig, scaled
from roadperc_stream.core.datatypes import Absent, Mask, Occupancy, Reason, Surface
from roadperc_stream.core.geometry import Camera, Float32, inverse, project, transform
from roadperc_stream.core.ground import ego_points, height_above, height_at, part
from roadperc_stream.core.scene import Scene

UNKNOWN: Final = -1
FREE: Final = 0
OCCUPIED: Final = 100

_MEDIAN_PX: Final = 3
"""A single drivable pixel among others frees no cell, a single hole among drivable ones leaves none unknown."""


def build(cfg: OccupancyConfig, scene: Scene, surface: Surface | Absent, drivable: Mask | Absent) -> Occupancy | Absent:
    """The grid of one frame.

    Args:
        cfg: extent, resolution and thresholds.
        scene: the frame; without tags heights alone decide what is an obstacle.
        surface: the road, from which heights are measured, in the front camera's frame.
        drivable: (H, W) drivable pixels.

    Returns:
        The grid, or why there is none.
    """
    if scene.depth_m is None:
        return Absent(Reason("occupancy", "no_depth"))
    if isinstance(surface, Absent):
        return Absent(Reason("occupancy", "no_surface", cause=surface.reason))
    if isinstance(drivable, Absent):
        return Absent(Reason("occupancy", "no_drivable_surface", cause=drivable.reason))
    dense = scene.dense_depth_m is not None
    if dense and not surface.measured:
        return Absent(Reason("occupancy", "heights_unknown"))
    step = _pixel_step(cfg, scene.camera) if dense else 1
    x, y, z = ego_points(part(scene.camera, 0, step, step), scene.ego_T_camera, scene.depth_m[::step, ::step])
    height = height_above(surface, x, y, z)
    occupied = _occupied(cfg, height, _obstacles(cfg, scene, step) if dense else None)
    free = drivable[::step, ::step] & np.isfinite(height)
    cells = np.full(_shape(cfg), UNKNOWN, np.int8)
    cells[_enough(cfg, x[free], y[free])] = FREE
    cells[_visible_drivable(cfg, scene, surface, drivable)] = FREE
    cells[_enough(cfg, x[occupied], y[occupied])] = OCCUPIED
    return Occupancy(cfg.x_min_m, -cfg.half_width_m, cfg.resolution_m, cells)


def _pixel_step(cfg: OccupancyConfig, camera: Camera) -> int:
    return max(round(scaled(cfg.pixel_step, camera.height)), 1)


def _shape(cfg: OccupancyConfig) -> tuple[int, int]:
    """Rows along y and columns along x; a part of a cell at the end is left out."""
    rows, columns = 2 * cfg.half_width_m / cfg.resolution_m, (cfg.x_max_m - cfg.x_min_m) / cfg.resolution_m
    return int(rows + 1e-6), int(columns + 1e-6)


def _obstacles(cfg: OccupancyConfig, scene: Scene, step: int) -> Mask | None:
    """Every ``step``-th pixel in both directions that is of an obstacle's class; None without tags."""
    if scene.tags is None or scene.table is None:
        return None
    few = np.ascontiguousarray(scene.tags[::step, ::step])
    return np.asarray(cv2.LUT(few, scene.table.lookup(cfg.obstacle_classes)), np.uint8).view(np.bool_)


def _occupied(cfg: OccupancyConfig, height_m: Float32, obstacles: Mask | None) -> Mask:
    """Points high enough, or of an obstacle, and not so high that one passes below."""
    with np.errstate(invalid="ignore"):
        high = height_m >= np.float32(cfg.min_height_m)
        result: Mask = (high if obstacles is None else high | obstacles) & (height_m <= np.float32(cfg.max_height_m))
    return result


def _enough(cfg: OccupancyConfig, x: Float32, y: Float32) -> Mask:
    """(rows, columns) cells in which at least ``min_points`` of (N,) known points lie."""
    rows, columns = _shape(cfg)
    i = np.floor((x - cfg.x_min_m) / cfg.resolution_m).astype(np.int64)
    j = np.floor((y + cfg.half_width_m) / cfg.resolution_m).astype(np.int64)
    inside = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
    counts: NDArray[np.intp] = np.bincount(j[inside] * columns + i[inside], minlength=rows * columns)
    result: Mask = (counts >= cfg.min_points).reshape(rows, columns)
    return result


def _visible_drivable(cfg: OccupancyConfig, scene: Scene, surface: Surface, drivable: Mask) -> Mask:
    """(rows, columns) cells whose middle is visible as drivable road, at its own distance where the depth is dense."""
    camera, depth_m = scene.camera, scene.dense_depth_m
    rows, columns = _shape(cfg)
    x, y = np.meshgrid(
        cfg.x_min_m + cfg.resolution_m * (np.arange(columns) + 0.5),
        -cfg.half_width_m + cfg.resolution_m * (np.arange(rows) + 0.5),
    )
    middles = transform(inverse(scene.ego_T_camera), np.stack((x, y, height_at(surface, x, y)), axis=-1))
    pixels = np.rint(np.nan_to_num(project(camera, middles), nan=-1.0))
    inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=-1)
    u, v = pixels[inside].astype(np.intp).T
    road = np.asarray(cv2.medianBlur(drivable.view(np.uint8), _MEDIAN_PX), np.uint8).view(np.bool_)
    result = np.zeros((rows, columns), bool)
    result[inside] = road[v, u]
    if depth_m is not None:
        distance = middles[inside][:, 2]
        with np.errstate(invalid="ignore"):
            result[inside] &= np.abs(depth_m[v, u] - distance) <= cfg.depth_tolerance * distance + cfg.resolution_m
    return result
