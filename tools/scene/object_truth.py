"""What is true of the objects in view: where they are, how fast they come nearer, and what is in the path."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy import ndimage

from roadperc_stream.core.geometry import inverse, rays, transform

from .drive import Drive, SceneMoment
from .ego_path import PathPlace, path_place
from .rig import CameraPair
from .view import RenderedView

DERIVATIVE_STEP_S: Final = 1e-3
MIN_PIXELS: Final = 30
"""Objects with fewer visible pixels are not among the truth."""
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
    place: PathPlace

    @property
    def time_to_impact_s(self) -> float | None:
        """Range over range rate of what is in the path and comes nearer, else None."""
        nears = self.place.in_path and self.closing_speed_mps > MIN_CLOSING_MPS
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
                "lateral_m": round(self.place.lateral_m, 5),
                "in_path": self.place.in_path,
                "time_to_impact_s": None if impact is None else round(impact, 5),
            }
        return seen


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
    seen_box = (x0, y0, box[1].stop, box[0].stop)
    return ObjectTruth(thing.name, thing.label, seen_box, float(distances[nearest]), speed, path_place(moment, thing))
