"""Ground truth of the road in a frame: the boundaries of the ego lane, and the surface."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float, camera_pitch_roll, facing, fit_plane, inverse, transform, transform_plane

from .cameras import CameraPair
from .lanes import Edge
from .scenes import RenderedScene, Terrain
from .view import Snapshot

LINE_LENGTH_M: Final = 60
GRID_X_M: Final = (0, 60)
GRID_Y_M: Final = (-8, 8)
PLANE_AHEAD_M: Final = (3.0, 15.0)
PLANE_ASIDE_M: Final = 4.0
PLANE_STEP_M: Final = 0.5
DERIVATIVE_STEP_M: Final = 0.5
FOUND_M: Final = 1e-4
"""Largest error of a point on an edge; with a larger error the edge does not exist there."""


def lanes_truth(snapshot: Snapshot, *, with_change: bool) -> dict[str, Any]:
    """Return the inner edges of the lane with the car's reference point, in the ego frame; None if absent.

    ``with_change`` adds lane changes.
    """
    lane = snapshot.scene.road.lanes.at(snapshot.s_m, snapshot.d_m)
    sides: dict[str, Any] = {side: lane and _boundary(snapshot, getattr(lane, side)) for side in ("left", "right")}
    if with_change:
        sides |= {"lane_change": snapshot.lane_change.direction, "lane_changes": snapshot.lane_change.count}
    return sides


def _boundary(snapshot: Snapshot, edge: Edge) -> dict[str, Any] | None:
    step = DERIVATIVE_STEP_M
    around, there = line_at(snapshot, edge, np.array([-step, 0.0, step]))
    if not there[1]:
        return None
    y = around[:, 1]
    slope, bend = (y[2] - y[0]) / (2 * step), (y[0] - 2 * y[1] + y[2]) / step**2
    line, there = line_at(snapshot, edge, np.arange(LINE_LENGTH_M + 1.0))
    # Keep the part that is connected to the car.
    line = line[: int(np.append(there, False).argmin())]
    return {
        "offset_m": round(float(y[1]), 6),
        "heading": round(float(slope), 7),
        "curvature_per_m": round(float(bend), 7),
        "line_ego_m": line.round(5).tolist(),
        "inside": "road",
        "outside": edge.outside,
    }


def line_at(snapshot: Snapshot, edge: Edge, x_ego_m: Float) -> tuple[Float, NDArray[np.bool_]]:
    """Return (N, 3) points of an edge in the ego frame at (N,) ego x, and (N,) True where the edge exists.

    Newton's method along s; within the first 60 m the angle to the ego x axis is at most 45 degrees.
    """
    scene, ego_T_world = snapshot.scene, inverse(snapshot.world_T_ego)
    s = snapshot.s_m + x_ego_m
    points = _on_road(scene, s, edge, ego_T_world)
    for _ in range(20):
        ahead = _on_road(scene, s + 0.01, edge, ego_T_world)
        # Stay within the edge: after a crossing the road may never reach this x.
        with np.errstate(divide="ignore", invalid="ignore"):
            new = np.clip(s + (x_ego_m - points[:, 0]) / ((ahead[:, 0] - points[:, 0]) / 0.01), edge.from_m, edge.to_m)
        if np.array_equal(new, s):
            break
        s, points = new, _on_road(scene, new, edge, ego_T_world)
    return points, np.abs(points[:, 0] - x_ego_m) < FOUND_M


def _on_road(scene: RenderedScene, s_m: Float, edge: Edge, ego_T_world: Float) -> Float:
    x, y = scene.path.point(s_m, edge.d_m.at(s_m))
    return transform(ego_T_world, np.stack((x, y, scene.terrain.height(x)), axis=-1))


def surface_truth(snapshot: Snapshot, rig: CameraPair) -> dict[str, Any]:
    """Return the plane through the road ahead of the front camera, and the road's heights in the ego frame."""
    camera_x = float(rig.ego_T_left[0, 3])
    near, far = PLANE_AHEAD_M
    x, y = np.meshgrid(
        np.arange(camera_x + near, camera_x + far + 1e-9, PLANE_STEP_M),
        np.arange(-PLANE_ASIDE_M, PLANE_ASIDE_M + 1e-9, PLANE_STEP_M),
    )
    terrain = snapshot.scene.terrain
    points = np.stack((x, y, height_in_ego(terrain, snapshot.world_T_ego, x, y)), axis=-1).reshape(-1, 3)
    ego_plane = facing(fit_plane(points), rig.ego_T_left[:3, 3])
    plane = transform_plane(inverse(rig.ego_T_left), ego_plane)
    pitch, roll = camera_pitch_roll(plane)
    nx, ny, nz = ego_plane.normal
    return {
        "normal": [round(c, 9) for c in plane.normal],
        "camera_height_m": round(plane.offset_m, 6),
        "pitch": round(pitch, 8),
        "roll": round(roll, 8),
        "a": round(nx / nz, 8),
        "b": round(ny / nz, 8),
        "d": round(-ego_plane.offset_m / nz, 7),
        "height_grid": _height_grid(terrain, snapshot.world_T_ego),
    }


def _height_grid(terrain: Terrain, world_T_ego: Float) -> dict[str, Any]:
    """Return heights on a grid of 1 m: rows along y, columns along x; ``z_m`` holds row after row."""
    x, y = np.arange(GRID_X_M[0], GRID_X_M[1] + 1.0), np.arange(GRID_Y_M[0], GRID_Y_M[1] + 1.0)
    z = height_in_ego(terrain, world_T_ego, *np.meshgrid(x, y))
    return {
        "x_min_m": GRID_X_M[0],
        "y_min_m": GRID_Y_M[0],
        "step_m": 1.0,
        "columns": len(x),
        "rows": len(y),
        "z_m": z.round(5).ravel().tolist(),
    }


def height_in_ego(terrain: Terrain, world_T_ego: Float, x_m: Float, y_m: Float) -> Float:
    """Return the height of the road in the ego frame at ego x and y of any shape.

    Fixed-point iteration: each step multiplies the error by the slope.
    """
    z = np.zeros_like(x_m)
    for _ in range(12):
        points = transform(world_T_ego, np.stack((x_m, y_m, z), axis=-1))
        z = z + (terrain.height(points[..., 0]) - points[..., 2]) / world_T_ego[2, 2]
    return z
