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

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.kernels import count_points, mark_visible
from roadperc_stream.chain.kernels.occupancy_plain import Cells, KnownPixels, Middles
from roadperc_stream.chain.kernels.odometry_plain import Projection
from roadperc_stream.config import OccupancyConfig, scaled
from roadperc_stream.geometry import Float32, inverse
from roadperc_stream.geometry.ground import ego_points, ego_rays, height_above, height_at, part
from roadperc_stream.model import Absent, Image, Mask, Occupancy, Reason, Surface
from roadperc_stream.model.scene import Scene

Counts = NDArray[np.int64]

UNKNOWN: Final = -1
FREE: Final = 0
OCCUPIED: Final = 100

_ROWS_AT_ONCE: Final = 64
"""Rows whose points stay in the processor's cache from one operation on them to the next."""


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
    free, occupied = _points_in_cells(cfg, scene, surface, drivable, scene.depth_m)
    cells = np.full(_shape(cfg), UNKNOWN, np.int8)
    cells[free >= cfg.min_points] = FREE
    cells[_visible_drivable(cfg, scene, surface, drivable)] = FREE
    cells[occupied >= cfg.min_points] = OCCUPIED
    return Occupancy(cfg.x_min_m, -cfg.half_width_m, cfg.resolution_m, cells)


def _points_in_cells(
    cfg: OccupancyConfig, scene: Scene, surface: Surface, drivable: Mask, depth_m: Float32
) -> tuple[Counts, Counts]:
    """(rows, columns) numbers of drivable points and of points that are obstacles in each cell."""
    step = 1
    if scene.dense_depth_m is not None:
        step = max(round(scaled(cfg.pixel_step, scene.camera.height)), 1)
    camera, depth_m, marks = part(scene.camera, step, step), depth_m[::step, ::step], drivable[::step, ::step]
    tags, obstacle_tags = _obstacles(cfg, scene, step)
    cells = Cells(cfg.x_min_m, -cfg.half_width_m, cfg.resolution_m, cfg.min_height_m, cfg.max_height_m)
    abd = np.array(surface.abd, np.float32)
    free, occupied = np.zeros(_shape(cfg), np.int64), np.zeros(_shape(cfg), np.int64)
    for top in range(0, camera.height, _ROWS_AT_ONCE):
        rows = slice(top, top + _ROWS_AT_ONCE)
        heights = None
        if surface.height_grid is not None:
            heights = height_above(surface, *ego_points(camera, scene.ego_T_camera, depth_m[rows], top))
        rays = ego_rays(camera, scene.ego_T_camera, top, len(depth_m[rows]))
        pixels = KnownPixels(depth_m[rows], heights, marks[rows].view(np.uint8), tags[rows], obstacle_tags)
        count_points(cells, pixels, rays, abd, free, occupied)
    return free, occupied


def _shape(cfg: OccupancyConfig) -> tuple[int, int]:
    """Rows along y and columns along x; a part of a cell at the end is left out."""
    rows, columns = 2 * cfg.half_width_m / cfg.resolution_m, (cfg.x_max_m - cfg.x_min_m) / cfg.resolution_m
    return int(rows + 1e-6), int(columns + 1e-6)


def _obstacles(cfg: OccupancyConfig, scene: Scene, step: int) -> tuple[Image, Image]:
    """Tags of every ``step``-th pixel in both directions, and (256,) 1 of those of an obstacle.

    Without tags, and among a lidar's points, none is.
    """
    if scene.tags is None or scene.table is None or scene.dense_depth_m is None:
        size = part(scene.camera, step, step).size
        return np.broadcast_to(np.zeros((), np.uint8), size), np.zeros(256, np.uint8)
    return scene.tags[::step, ::step], scene.table.lookup(cfg.obstacle_classes)


def _visible_drivable(cfg: OccupancyConfig, scene: Scene, surface: Surface, drivable: Mask) -> Mask:
    """(rows, columns) cells whose middle is visible as drivable road, at its own distance where the depth is dense."""
    camera = scene.camera
    rows, columns = _shape(cfg)
    x = cfg.x_min_m + cfg.resolution_m * (np.arange(columns, dtype=float) + 0.5)
    y = cfg.resolution_m * (np.arange(rows, dtype=float) + 0.5) - cfg.half_width_m
    visible = mark_visible(
        Projection(camera.fx, camera.fy, camera.cx, camera.cy),
        inverse(scene.ego_T_camera),
        Middles(x, y, height_at(surface, x, y[:, None])),
        drivable.view(np.uint8),
        scene.dense_depth_m,
        (cfg.depth_tolerance, cfg.resolution_m),
    )
    return visible.view(bool)
