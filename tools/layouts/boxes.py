"""True objects of labelled 3D boxes, with the distance to the nearest point that the camera can see."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from roadperc_stream.geometry import Camera, Float, inverse, transform
from roadperc_stream.model import Box, Detection, Object, Objects

from ..box_view import corners_between, image_box, seen_sides, view_limits
from ..readers.truth_file import TruthTables
from ..rig import FRONT, Rig

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
    return TruthTables(objects={n: Objects(tuple(_seen(camera, camera_T_ego, b))) for n, b in boxes.items()})


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


def box_distance_m(camera: Camera, camera_T_box: Float, size_m: Float) -> float | None:
    """Return the straight-line distance from the camera to the nearest point of a box inside the image's limits.

    A box outside the view counts as a whole. None if the numbers are too large for an answer. Source: C. Lawson and
    R. Hanson, Solving Least Squares Problems (1974), chapter 23: the point of least norm under linear inequalities is
    a nonnegative least squares problem.

    Args:
        camera: the camera; only its size and matrix are used.
        camera_T_box: (4, 4) pose of the box's centre in the camera's optical frame.
        size_m: (3,) lengths along the box's axes.
    """
    axes = camera_T_box[:3, :3].T
    middle = axes @ camera_T_box[:3, 3]
    sides = np.vstack((axes, -axes))
    bounds = np.concatenate((middle - size_m / 2, -middle - size_m / 2))
    limits = view_limits(camera)
    inside = _nearest_m(np.vstack((sides, limits)), np.concatenate((bounds, np.zeros(len(limits)))))
    return _nearest_m(sides, bounds) if inside is None else inside


def _nearest_m(normals: Float, bounds: Float) -> float | None:
    """Return the least norm of points with ``normals @ point >= bounds``; None without one."""
    from scipy.optimize import nnls  # its import takes half a second

    system = np.vstack((normals.T, bounds))
    weights, residual = nnls(system, np.array([0.0, 0.0, 0.0, 1.0]))
    *beside, last = system @ weights - (0.0, 0.0, 0.0, 1.0)
    return None if residual < 1e-9 or last >= 0 else float(np.linalg.norm(beside) / -last)
