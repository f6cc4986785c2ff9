"""Ground truth of the visible objects: position, closing speed, and whether they are in the ego car's path.

The path runs along the driving line of the lane with the car's reference point. Its width is the car's width
plus a margin on each side. Where there is no lane, the driving line of the first lane continues.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy import ndimage

from roadperc_stream.geometry import Float, inverse, rays, transform

from ..box_view import corners_between, image_box, seen_sides
from .atlas import CAR_WIDTH_M
from .cameras import CameraPair
from .faces import Body
from .raster import NEAR_M
from .scenario import Scenario
from .view import Snapshot, View

PATH_MARGIN_M: Final = 0.3


def path_place(snapshot: Snapshot, body: Body) -> tuple[float, bool]:
    """Return a body's lateral offset from the path's centre (left positive, metres), and if it is in the path."""
    scene = snapshot.scene
    corners = body_corners(body, snapshot.time_s)
    road = scene.path.around(snapshot.s_m)
    x, y = (np.append(corners[:, i], corners[:, i].mean()) - road.origin_m[i] for i in (0, 1))
    s, d = road.coordinates(x, y)
    lane = scene.road.lanes.at(snapshot.s_m, snapshot.d_m) or scene.road.lanes.start
    aside = d - [lane.way_m(float(at) + road.s_origin_m) for at in s]
    half = CAR_WIDTH_M / 2 + PATH_MARGIN_M
    return float(aside[-1]), bool(aside[:-1].min() < half and aside[:-1].max() > -half)


def body_corners(body: Body, time_s: float) -> Float:
    """Return (8, 3) world corners of the upright box around a body in its own frame."""
    pose = body.pose(time_s)
    own = transform(inverse(pose), body.faces.corners.reshape(-1, 3))
    low, high = own.min(axis=0), own.max(axis=0)
    return transform(pose, corners_between(low, high))


DERIVATIVE_STEP_S: Final = 1e-3
MIN_PIXELS: Final = 30
"""Objects with fewer visible pixels are left out."""
MIN_CLOSING_MPS: Final = 0.05
"""Below this closing speed there is no time to impact."""


@dataclass(frozen=True)
class ObjectTruth:
    """A visible object: the tight half-open box of its visible pixels, and the range of its nearest visible point."""

    name: str
    label: str
    box_px: tuple[int, int, int, int]
    distance_m: float
    closing_speed_mps: float
    lateral_m: float
    in_path: bool

    @property
    def time_to_impact_s(self) -> float | None:
        """Return range over range rate of an approaching object in the path, else None."""
        nears = self.in_path and self.closing_speed_mps > MIN_CLOSING_MPS
        return self.distance_m / self.closing_speed_mps if nears else None

    def to_json(self, *, with_path: bool) -> dict[str, Any]:
        """Return the entry of ``truth.json``; ``with_path`` adds path position and time to impact."""
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


def objects_truth(
    scenario: Scenario, snapshot: Snapshot, rig: CameraPair, view: View, *, whole: bool
) -> list[ObjectTruth]:
    """Return all objects with enough visible pixels, from the clean front view.

    The box is that of the visible pixels or, with ``whole``, that of the whole object, clipped to the image.
    """
    boxes = ndimage.find_objects(view.owner, len(snapshot.bodies))
    truths = (_object(scenario, snapshot, rig, view, i + 1, box) for i, box in enumerate(boxes) if box is not None)
    seen = [truth for truth in truths if truth is not None]
    if not whole:
        return seen
    camera_T_world = inverse(snapshot.world_T_ego @ rig.ego_T_left)
    bodies = {body.name: body for body in snapshot.bodies}
    corners = (transform(camera_T_world, body_corners(bodies[truth.name], snapshot.time_s)) for truth in seen)
    sides = (seen_sides(rig.camera, eight, NEAR_M) for eight in corners)
    return [replace(truth, box_px=image_box(rig.camera, parts)) for truth, parts in zip(seen, sides, strict=True)]


def _object(
    scenario: Scenario, snapshot: Snapshot, rig: CameraPair, view: View, number: int, box: tuple[slice, slice]
) -> ObjectTruth | None:
    rows, columns = np.nonzero(view.owner[box] == number)
    if len(rows) < MIN_PIXELS:
        return None
    y0, x0 = box[0].start, box[1].start
    directions = rays(rig.camera, np.column_stack((columns + x0, rows + y0)).astype(np.float64))
    points = directions * view.depth_m[box][rows, columns, None].astype(np.float64)
    distances = np.linalg.norm(points, axis=1)
    nearest = int(distances.argmin())
    body = snapshot.bodies[number - 1]
    world_point = transform(snapshot.world_T_ego @ rig.ego_T_left, points[nearest])
    body_point = transform(inverse(body.pose(snapshot.time_s)), world_point)

    def distance(time_s: float) -> float:
        camera = scenario.ego.pose(time_s) @ rig.ego_T_left
        return float(np.linalg.norm(transform(body.pose(time_s), body_point) - camera[:3, 3]))

    step = DERIVATIVE_STEP_S
    speed = (distance(snapshot.time_s - step) - distance(snapshot.time_s + step)) / (2 * step)
    seen_box = (x0, y0, box[1].stop, box[0].stop)
    return ObjectTruth(body.name, body.label, seen_box, float(distances[nearest]), speed, *path_place(snapshot, body))
