"""True objects of labelled 3D boxes, in the terms of ``/truth/objects``."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from roadperc_stream.geometry import Camera, Float, inverse, transform
from roadperc_stream.model import Box, Detection, Object, Objects

from ..box_view import corners_between, image_box, nearest_edge_m, seen_sides, view_limits

_NEAR_M: Final = 0.1


@dataclass(frozen=True)
class LabelledBox:
    """A labelled 3D box; its frame is in the middle of the box: x along the length, y to the left, z up."""

    label: str
    ego_T_box: Float
    """(4, 4)."""
    size_m: tuple[float, float, float]
    """Length, width, height."""
    track_id: str = ""
    box_px: Box | None = None
    """Box of the label in the image, if the dataset has it."""


def true_objects(camera: Camera, ego_T_camera: Float, boxes: Iterable[LabelledBox]) -> Objects:
    """Return the objects of all boxes of which at least a part is in the view; hidden ones are not recognised."""
    found = (_true_object(camera, inverse(ego_T_camera), box) for box in boxes)
    return Objects(tuple(item for item in found if item is not None))


def _true_object(camera: Camera, camera_T_ego: Float, box: LabelledBox) -> Object | None:
    """Return an object with the image box of its box, and the distance from the camera to the box's nearest seen point.

    The distance is a straight line, as in ``Object.distance_m``.
    """
    camera_T_box, half = camera_T_ego @ box.ego_T_box, np.array(box.size_m) / 2
    sides = seen_sides(camera, transform(camera_T_box, corners_between(-half, half)), _NEAR_M)
    if not sides:
        return None
    nearest = transform(camera_T_box, np.clip(inverse(camera_T_box)[:3, 3], -half, half))
    is_seen = bool((view_limits(camera, _NEAR_M) @ np.append(nearest, 1.0) >= 0).all())
    distance_m = float(np.linalg.norm(nearest)) if is_seen else nearest_edge_m(sides)
    box_px = box.box_px or Box(*map(float, image_box(camera, sides)))
    return Object(
        Detection(box.label, box_px, 1.0, box.track_id), kept=True, track_id=box.track_id, distance_m=distance_m
    )
