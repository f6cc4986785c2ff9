"""Free and occupied space around the car: a bird's-eye grid in the ego frame from depth and tags.

A cell is occupied if it has points above the road or points of an obstacle class. A cell is free if it has drivable
points, or if its middle projects to a drivable pixel at the cell's distance. This inverse mapping leaves no gaps far
ahead, where neighbouring image rows are metres apart. All other cells are unknown, also those behind an obstacle.
Occupied wins over free.

Every point of a lidar counts. Without a point, a cell is free if its middle is visible as drivable. For lidar points
only heights decide what is an obstacle: a point that the camera does not see carries the tag of the obstacle before it.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import OccupancyConfig, scaled
from roadperc_stream.geometry import Float32, inverse
from roadperc_stream.geometry.ground import ego_points, ego_rays, height_above, height_at, part
from roadperc_stream.kernels import count_points
from roadperc_stream.kernels.occupancy_plain import Cells, KnownPixels
from roadperc_stream.model import Absent, Image, Mask, Occupancy, Reason, Surface
from roadperc_stream.model.frame import Frame

Counts = NDArray[np.int64]

UNKNOWN: Final = -1
FREE: Final = 0
OCCUPIED: Final = 100

_NEAREST_M: Final = 1e-6


def build(cfg: OccupancyConfig, frame: Frame, surface: Surface | Absent, drivable: Mask | Absent) -> Occupancy | Absent:
    """The grid of one frame.

    Without tags heights alone decide what is an obstacle. ``surface`` is in the front camera's frame; ``drivable`` is
    (H, W).

    Returns:
        The grid or ``Absent``.
    """
    if frame.depth_m is None:
        return Absent(Reason("occupancy", "no_depth"))
    if isinstance(surface, Absent):
        return Absent(Reason("occupancy", "no_surface", cause=surface.reason))
    if isinstance(drivable, Absent):
        return Absent(Reason("occupancy", "no_drivable_surface", cause=drivable.reason))
    dense = frame.dense_depth_m is not None
    if dense and not surface.measured:
        return Absent(Reason("occupancy", "heights_unknown"))
    free, occupied = _points_in_cells(cfg, frame, surface, drivable, frame.depth_m)
    cells = np.full(_shape(cfg), UNKNOWN, np.int8)
    cells[free >= cfg.min_points] = FREE
    cells[_visible_drivable(cfg, frame, surface, drivable)] = FREE
    cells[occupied >= cfg.min_points] = OCCUPIED
    return Occupancy(cfg.x_min_m, -cfg.half_width_m, cfg.resolution_m, cells)


def _points_in_cells(
    cfg: OccupancyConfig, frame: Frame, surface: Surface, drivable: Mask, depth_m: Float32
) -> tuple[Counts, Counts]:
    """(rows, columns) counts of drivable points and of obstacle points in each cell."""
    step = 1
    if frame.dense_depth_m is not None:
        step = max(round(scaled(cfg.pixel_step, frame.camera.height)), 1)
    camera, depth_m, marks = part(frame.camera, step, step), depth_m[::step, ::step], drivable[::step, ::step]
    tags, obstacle_tags = _obstacles(cfg, frame, step)
    cells = Cells(cfg.x_min_m, -cfg.half_width_m, cfg.resolution_m, cfg.min_height_m, cfg.max_height_m)
    abd = np.array(surface.abd, np.float32)
    free, occupied = np.zeros(_shape(cfg), np.int64), np.zeros(_shape(cfg), np.int64)
    heights = None
    if surface.height_grid is not None:
        heights = height_above(surface, *ego_points(camera, frame.ego_T_camera, depth_m))
    rays = ego_rays(camera, frame.ego_T_camera, 0, camera.height)
    pixels = KnownPixels(depth_m, heights, marks.view(np.uint8), tags, obstacle_tags)
    count_points(cells, pixels, rays, abd, free, occupied)
    return free, occupied


def _shape(cfg: OccupancyConfig) -> tuple[int, int]:
    """Rows along y and columns along x; an incomplete cell at the end is left out."""
    rows, columns = 2 * cfg.half_width_m / cfg.resolution_m, (cfg.x_max_m - cfg.x_min_m) / cfg.resolution_m
    return int(rows + 1e-6), int(columns + 1e-6)


def _obstacles(cfg: OccupancyConfig, frame: Frame, step: int) -> tuple[Image, Image]:
    """Tags of every ``step``-th pixel in both directions, and (256,) 1 at the tags of obstacles.

    Without tags, and for lidar points, no tag is an obstacle.
    """
    if frame.tags is None or frame.table is None or frame.dense_depth_m is None:
        size = part(frame.camera, step, step).size
        return np.broadcast_to(np.zeros((), np.uint8), size), np.zeros(256, np.uint8)
    return frame.tags[::step, ::step], frame.table.lookup(cfg.obstacle_classes)


def _visible_drivable(cfg: OccupancyConfig, frame: Frame, surface: Surface, drivable: Mask) -> Mask:
    """(rows, columns) cells whose middle is visible as drivable road, at its own distance where the depth is dense.

    A pixel counts if most pixels of its 3x3 square are drivable; single pixels do not matter.
    """
    camera, depth_m = frame.camera, frame.dense_depth_m
    rows, columns = _shape(cfg)
    along = cfg.x_min_m + cfg.resolution_m * (np.arange(columns, dtype=float) + 0.5)
    across = (cfg.resolution_m * (np.arange(rows, dtype=float) + 0.5) - cfg.half_width_m)[:, None]
    x, y, z = (at.astype(np.float32) for at in (along, across, height_at(surface, along, across)))
    camera_T_ego = inverse(frame.ego_T_camera).astype(np.float32)
    right, down, ahead = ((T[0] * x + T[3]) + T[1] * y + T[2] * z for T in camera_T_ego[:3])
    with np.errstate(all="ignore"):
        per_m = 1.0 / ahead
        per_m[ahead <= _NEAREST_M] = np.nan  # cells behind the camera do not count
        u, v = right * per_m * camera.fx + camera.cx, down * per_m * camera.fy + camera.cy
    top = max(int(np.fmin.reduce(v, axis=None, initial=camera.height - 1)) - 2, 0)
    seen = cv2.remap(cv2.medianBlur(drivable[top:].view(np.uint8), 3), u, v - top, cv2.INTER_NEAREST) > 0
    if depth_m is not None:  # a comparison with NaN is False
        there_m = cv2.remap(depth_m, u, v, cv2.INTER_NEAREST, borderValue=np.nan)
        seen &= np.abs(there_m - ahead) <= cfg.depth_tolerance * ahead + cfg.resolution_m
    return seen
