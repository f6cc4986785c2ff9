"""True objects of labelled 3D boxes, in the terms of ``/truth/objects``."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from roadperc_stream.geometry import Camera, Float, inverse, transform
from roadperc_stream.model import Box, Detection, Object, Objects

from ..box_view import corners_between, image_box, seen_sides
from ..carla_dump.camera_rig import FRONT, Rig
from ..carla_dump.truth_file import TruthTables
from .box_truth import box_distance_m

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


def objects_of_boxes(rig: Rig, boxes: Mapping[int, Iterable[LabelledBox]]) -> TruthTables:
    """Return the objects by frame number: all boxes of which the front camera sees a part, hidden ones too."""
    camera_T_ego = inverse(next(edge.parent_T_child for edge in rig.transforms if edge.child == FRONT))
    camera = rig.cameras["calibration"]
    return TruthTables({}, {}, {n: Objects(tuple(_seen(camera, camera_T_ego, found))) for n, found in boxes.items()})


def _seen(camera: Camera, camera_T_ego: Float, boxes: Iterable[LabelledBox]) -> Iterator[Object]:
    for box in boxes:
        camera_T_box, size_m = camera_T_ego @ box.ego_T_box, np.array(box.size_m)
        sides = seen_sides(camera, transform(camera_T_box, corners_between(-size_m / 2, size_m / 2)), _NEAR_M)
        if sides:
            box_px = Box(*map(float, image_box(camera, sides)))
            yield Object(
                Detection(box.label, box_px, 1.0, box.track_id),
                kept=True,
                track_id=box.track_id,
                distance_m=box_distance_m(camera, camera_T_box, size_m),
            )
