"""What is true of the objects in view: where they are, how fast they come nearer, and what is in the path.

The ego car's path is a strip along the driving line of the lane that holds the car's reference point. It is as wide
as the car and a margin on either side; where there is no lane it runs on as that of the first lane did.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy import ndimage

from roadperc_stream.geometry import Camera, Float, inverse, project, rays, transform

from .drive import Drive, SceneMoment
from .faces import Thing
from .raster import NEAR_M
from .rig import CameraPair
from .sheet import CAR_WIDTH_M
from .view import View

PATH_MARGIN_M: Final = 0.3


def path_place(moment: SceneMoment, thing: Thing) -> tuple[float, bool]:
    """How far a thing's middle is to the left of the path's, metres, and whether any of it is in the path."""
    world = moment.scenery.world
    corners = body_corners(thing, moment.time_s)
    road = world.path.around(moment.scenery.s_m)
    x, y = (np.append(corners[:, i], corners[:, i].mean()) - road.origin_m[i] for i in (0, 1))
    s, d = road.coordinates(x, y)
    lane = world.road.lanes.at(moment.scenery.s_m, moment.d_m) or world.road.lanes.start
    aside = d - [lane.way_m(float(at) + road.s_origin_m) for at in s]
    half = CAR_WIDTH_M / 2 + PATH_MARGIN_M
    return float(aside[-1]), bool(aside[:-1].min() < half and aside[:-1].max() > -half)


def body_corners(thing: Thing, time_s: float) -> Float:
    """(8, 3) the corners of the upright box around a thing in its own frame, in the world."""
    pose = thing.pose(time_s)
    body = transform(inverse(pose), thing.faces.corners.reshape(-1, 3))
    low, high = body.min(axis=0), body.max(axis=0)
    corners = np.array([[(low, high)[(i >> axis) & 1][axis] for axis in range(3)] for i in range(8)])
    return transform(pose, corners)


DERIVATIVE_STEP_S: Final = 1e-3
MIN_PIXELS: Final = 30
"""Objects with fewer visible pixels are not among the truth."""
_SIDES: Final = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
"""Numbers of the corners around each side of a box, as ``body_corners`` counts them."""
MIN_CLOSING_MPS: Final = 0.05
"""What comes nearer more slowly has no time to impact."""


@dataclass(frozen=True)
class ObjectTruth:
    """A visible object: the tight half-open box of its visible pixels, and its nearest visible point."""

    name: str
    label: str
    box_px: tuple[int, int, int, int]
    distance_m: float
    closing_speed_mps: float
    lateral_m: float
    in_path: bool

    @property
    def time_to_impact_s(self) -> float | None:
        """Range over range rate of what is in the path and comes nearer, else None."""
        nears = self.in_path and self.closing_speed_mps > MIN_CLOSING_MPS
        return self.distance_m / self.closing_speed_mps if nears else None

    def to_json(self, *, with_path: bool) -> dict[str, Any]:
        """As ``truth.json`` holds it; ``with_path`` adds where it is beside the path, and the time to impact."""
        seen: dict[str, Any] = {
            "id": self.name,
            "label": self.label,
            "box_px": list(self.box_px),
            "distance_m": round(self.distance_m, 5),
            "closing_speed_mps": round(self.closing_speed_mps, 5),
        }
        if with_path:
            impact = self.time_to_impact_s
            seen |= {
                "lateral_m": round(self.lateral_m, 5),
                "in_path": self.in_path,
                "time_to_impact_s": None if impact is None else round(impact, 5),
            }
        return seen


def objects_truth(drive: Drive, moment: SceneMoment, rig: CameraPair, view: View, *, whole: bool) -> list[ObjectTruth]:
    """Every object with enough visible pixels, from the clean front view.

    Its box is that of what is visible or, with ``whole``, that of all of it as far as it is in the image.
    """
    boxes = ndimage.find_objects(view.owner, len(moment.things))
    found = (_object(drive, moment, rig, view, i + 1, box) for i, box in enumerate(boxes) if box is not None)
    seen = [truth for truth in found if truth is not None]
    if not whole:
        return seen
    camera_T_world = inverse(moment.world_T_ego @ rig.ego_T_left)
    things = {thing.name: thing for thing in moment.things}
    corners = (transform(camera_T_world, body_corners(things[truth.name], moment.time_s)) for truth in seen)
    return [replace(truth, box_px=_whole_box(rig.camera, c)) for truth, c in zip(seen, corners, strict=True)]


def _whole_box(camera: Camera, corners: Float) -> tuple[int, int, int, int]:
    """The half-open box, within the image, of the (8, 3) corners of an upright box: CARLA's own 2D boxes are made so.

    Source: CARLA's documentation, "Bounding boxes": the extremes of the projected vertices; what lies outside the view
    is cut off before, so that a car beside the camera has no box to the image's top.
    """
    limits = _view_limits(camera)
    seen = np.concatenate([_clipped(corners[list(side)], limits) for side in _SIDES])
    pixels = project(camera, seen)
    low, high = np.floor(pixels.min(axis=0) + 0.5), np.ceil(pixels.max(axis=0) + 0.5)
    size = np.array((camera.width, camera.height))
    (x0, y0), (x1, y1) = np.clip(low, 0, size - 1), np.clip(high, 1, size)
    return int(x0), int(y0), int(x1), int(y1)


def _view_limits(camera: Camera) -> Float:
    """(5, 4) planes a x + b y + c z + d >= 0 that bound what a camera sees: left, right, top, bottom, near."""
    x0, x1 = (-0.5 - camera.cx) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx
    y0, y1 = (-0.5 - camera.cy) / camera.fy, (camera.height - 0.5 - camera.cy) / camera.fy
    return np.array([(1, 0, -x0, 0), (-1, 0, x1, 0), (0, 1, -y0, 0), (0, -1, y1, 0), (0, 0, 1, -NEAR_M)])


def _clipped(corners: Float, limits: Float) -> Float:
    """(M, 3) corners of what is left of a polygon within all limits; none where it lies outside.

    Source: I. Sutherland and G. Hodgman, Reentrant polygon clipping, CACM 17 (1974).
    """
    for limit in limits:
        inside = corners @ limit[:3] + limit[3]
        following, next_inside = np.roll(corners, -1, axis=0), np.roll(inside, -1)
        with np.errstate(invalid="ignore", divide="ignore"):
            crossings = corners + (following - corners) * (inside / (inside - next_inside))[:, None]
        kept = np.stack((inside >= 0, (inside >= 0) != (next_inside >= 0)), axis=1)
        corners = np.stack((corners, crossings), axis=1)[kept]
    return corners


def _object(
    drive: Drive, moment: SceneMoment, rig: CameraPair, view: View, number: int, box: tuple[slice, slice]
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
    seen_box = (x0, y0, box[1].stop, box[0].stop)
    return ObjectTruth(thing.name, thing.label, seen_box, float(distances[nearest]), speed, *path_place(moment, thing))
