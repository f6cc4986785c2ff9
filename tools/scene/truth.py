"""What is true of a frame: the ego lane's boundaries, the road's surface, the objects in view."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy import ndimage

from roadperc_stream.core.geometry import (
    Float,
    camera_pitch_roll,
    facing,
    fit_plane,
    inverse,
    rays,
    transform,
    transform_plane,
)

from .drive import CameraPair, Drive, SceneMoment
from .path import Path
from .terrain import Terrain
from .view import RenderedView
from .world import World

LINE_LENGTH_M: Final = 60
GRID_X_M: Final = (0, 60)
GRID_Y_M: Final = (-8, 8)
PLANE_AHEAD_M: Final = (3.0, 15.0)
PLANE_ASIDE_M: Final = 4.0
PLANE_STEP_M: Final = 0.5
DERIVATIVE_STEP_M: Final = 0.5
DERIVATIVE_STEP_S: Final = 1e-3
MIN_PIXELS: Final = 30
"""Objects with fewer visible pixels are not among the truth."""


@dataclass(frozen=True)
class ObjectTruth:
    """A visible object: the tight half-open box of its visible pixels, and its nearest visible point."""

    name: str
    label: str
    box_px: tuple[int, int, int, int]
    distance_m: float
    closing_speed_mps: float

    def to_json(self) -> dict[str, Any]:
        """As ``truth.json`` holds it."""
        return {
            "id": self.name,
            "label": self.label,
            "box_px": list(self.box_px),
            "distance_m": round(self.distance_m, 5),
            "closing_speed_mps": round(self.closing_speed_mps, 5),
        }


def lanes_truth(moment: SceneMoment) -> dict[str, Any]:
    """Both boundaries of the ego lane in the ego frame: the edges that face the lane."""
    world = moment.scenery.world
    section = world.section
    sides = {
        "left": (section.left_edge_m, section.outside_left),
        "right": (section.right_edge_m, section.outside_right),
    }
    return {
        side: {**_boundary(world, moment, edge), "inside": "road", "outside": outside}
        for side, (edge, outside) in sides.items()
    }


def _boundary(world: World, moment: SceneMoment, d_m: float) -> dict[str, Any]:
    step = DERIVATIVE_STEP_M
    around = line_at(world, moment, d_m, np.array([-step, 0.0, step]))[:, 1]
    line = line_at(world, moment, d_m, np.arange(LINE_LENGTH_M + 1.0))
    slope, bend = (around[2] - around[0]) / (2 * step), (around[0] - 2 * around[1] + around[2]) / step**2
    return {
        "offset_m": round(float(around[1]), 6),
        "heading": round(float(slope), 7),
        "curvature_per_m": round(float(bend), 7),
        "line_ego_m": line.round(5).tolist(),
    }


def line_at(world: World, moment: SceneMoment, d_m: float, x_ego_m: Float) -> Float:
    """(N, 3) points in the ego frame of the line at lateral d where ego x has the (N,) values given.

    Found by Newton's method along s; the line runs at most 45 degrees askew within the first 60 m.
    """
    ego_T_world = inverse(moment.world_T_ego)
    s = moment.scenery.s_m + x_ego_m
    points = _on_road(world.path, world.terrain, s, d_m, ego_T_world)
    for _ in range(20):
        ahead = _on_road(world.path, world.terrain, s + 0.01, d_m, ego_T_world)
        s = s + (x_ego_m - points[:, 0]) / ((ahead[:, 0] - points[:, 0]) / 0.01)
        points = _on_road(world.path, world.terrain, s, d_m, ego_T_world)
    return points


def _on_road(path: Path, terrain: Terrain, s_m: Float, d_m: float, ego_T_world: Float) -> Float:
    x, y = path.point(s_m, d_m)
    return transform(ego_T_world, np.stack((x, y, terrain.height(x)), axis=-1))


def surface_truth(moment: SceneMoment, rig: CameraPair) -> dict[str, Any]:
    """The plane through the road ahead of the front camera, and the road's heights in the ego frame."""
    camera_x = float(rig.ego_T_left[0, 3])
    near, far = PLANE_AHEAD_M
    x, y = np.meshgrid(
        np.arange(camera_x + near, camera_x + far + 1e-9, PLANE_STEP_M),
        np.arange(-PLANE_ASIDE_M, PLANE_ASIDE_M + 1e-9, PLANE_STEP_M),
    )
    terrain = moment.scenery.world.terrain
    points = np.stack((x, y, height_in_ego(terrain, moment.world_T_ego, x, y)), axis=-1).reshape(-1, 3)
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
        "height_grid": _height_grid(terrain, moment.world_T_ego),
    }


def _height_grid(terrain: Terrain, world_T_ego: Float) -> dict[str, Any]:
    """Rows run along y, columns along x, a metre apart; ``z_m`` holds row after row."""
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
    """Height of the road's surface in the ego frame, at ego x and y of any shape.

    Found step by step: each takes away all but the slope's share of the error.
    """
    z = np.zeros_like(x_m)
    for _ in range(12):
        world = transform(world_T_ego, np.stack((x_m, y_m, z), axis=-1))
        z = z + (terrain.height(world[..., 0]) - world[..., 2]) / world_T_ego[2, 2]
    return z


def objects_truth(drive: Drive, moment: SceneMoment, rig: CameraPair, view: RenderedView) -> list[ObjectTruth]:
    """Every object with enough visible pixels, from the clean front view."""
    boxes = ndimage.find_objects(view.owner, len(moment.things))
    found = (_object(drive, moment, rig, view, i + 1, box) for i, box in enumerate(boxes) if box is not None)
    return [truth for truth in found if truth is not None]


def _object(
    drive: Drive, moment: SceneMoment, rig: CameraPair, view: RenderedView, number: int, box: tuple[slice, slice]
) -> ObjectTruth | None:
    rows, columns = np.nonzero(view.owner[box] == number)
    if len(rows) < MIN_PIXELS:
        return None
    y0, x0 = box[0].start, box[1].start
    directions = rays(rig.camera, np.column_stack((columns + x0, rows + y0)).astype(np.float64))
    points = directions * view.depth_m[box][rows, columns, None].astype(np.float64)
    distances = np.linalg.norm(points, axis=1)
    nearest = int(distances.argmin())
    thing = moment.things[number - 1]
    world_point = transform(moment.world_T_ego @ rig.ego_T_left, points[nearest])
    body_point = transform(inverse(thing.pose(moment.time_s)), world_point)

    def distance(time_s: float) -> float:
        camera = drive.ego.pose(time_s) @ rig.ego_T_left
        return float(np.linalg.norm(transform(thing.pose(time_s), body_point) - camera[:3, 3]))

    step = DERIVATIVE_STEP_S
    speed = (distance(moment.time_s - step) - distance(moment.time_s + step)) / (2 * step)
    return ObjectTruth(thing.name, thing.label, (x0, y0, box[1].stop, box[0].stop), float(distances[nearest]), speed)
