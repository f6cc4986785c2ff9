"""Distances without depth: the lower edge of a box is where its object meets the road.

The ray of the lower edge meets the road's plane at the object's nearest depth (G. Stein, O. Mano and A. Shashua,
Vision-based ACC with a single camera: bounds on range and range rate accuracy, IEEE Intelligent Vehicles 2003). An
error of a row, of the pitch or of the road's slope grows with the square of the depth.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, inf, radians, sqrt
from typing import Final

import numpy as np

from roadperc_stream.chain.stages.objects.mosaic import corners
from roadperc_stream.chain.stages.objects.object_track import Extent
from roadperc_stream.chain.stages.objects.path import LATERAL_STD_M, OBJECT_LENGTH_M, EgoPath, left_of
from roadperc_stream.chain.stages.objects.regions import MOST_STD_SHARE
from roadperc_stream.geometry import Camera, Float, rays, transform
from roadperc_stream.geometry.planes import Plane
from roadperc_stream.model import Box, Detection, Object, Surface
from roadperc_stream.model.changed import changed
from roadperc_stream.model.frame import Frame
from roadperc_stream.model.tag_tables import classes_of_label, label_lookup

EDGE_STD_PX: Final = 1.0
EDGE_STD_SHARE: Final = 0.03
"""Standard deviation of a box's edge: this share of the box's side, at least one pixel."""
_BORDER_PX: Final = 1.5
"""A box this near to the image's left or right border counts as cut by it."""
_BORDER_SIGMAS: Final = 2.0
"""The same for the lower border, in deviations of the box's edge."""
_SEEN: Final = 0.3
"""Least share of the object's class in the lower half of a box for which tags show where the object ends."""
_LOWEST: Final = 0.1
"""Share of a box's columns in which an object is on the ground; between its tyres, the road is visible."""
_HIDDEN: Final = 0.5
"""Share of the lower edge behind nearer boxes from which it counts as hidden."""
_BODY_STD: Final = radians(0.3)
"""Standard deviation of the pitch of a plane that is not estimated in this frame: the body moves on its springs."""
_SLOPE_STD_PER_ROOT_M: Final = radians(0.1)
"""Standard deviation of the change of the road's slope over one metre; it grows with the root of the distance."""
_OVERHANG_M: Final = 0.4
_OVERHANG_STD_M: Final = 0.3
"""A vehicle's nearest point is this much nearer than the tyres on which it stands. Boxes of some detectors end at the
bumper's ground projection."""
_KERB_STD_M: Final = 0.1
"""Standard deviation of the height of other objects' ground: people stand on the road or on a raised sidewalk."""
_HEIGHT_STD: Final = 0.02
_ASSUMED_HEIGHT_STD: Final = 0.1
"""Standard deviation of the camera height as a share: of a mounting, and of the assumed height."""


@dataclass(frozen=True)
class GroundPlane:
    """The road in a frame without depth: its plane in the front camera's frame.

    ``pitch_std`` is the standard deviation of the plane's pitch in radians, ``height_std`` that of the camera height
    as a share of it.
    """

    plane: Plane
    pitch_std: float
    height_std: float


@dataclass(frozen=True)
class Contact:
    """Where the lower edge of a whole box meets the road.

    ``depth_m`` is its depth in metres with the standard deviation ``std_m``, None beyond the horizon or if it is too
    uncertain. ``common_share`` is the part of the deviation that other frames share, as a share of the depth.
    ``clear`` says whether no nearer box touches the box.
    """

    depth_m: float | None
    std_m: float
    common_share: float
    clear: bool


def ground_of(road: Surface, pitch_std: float, *, mounted: bool) -> GroundPlane:
    """The road as the ground of objects.

    Args:
        road: in the front camera's frame.
        pitch_std: standard deviation of its pitch, radians; of the mounting's pitch if it is not estimated.
        mounted: whether the log has the camera's mounting.
    """
    estimated = road.source == "estimated"
    pitch_std = pitch_std if estimated else _BODY_STD if road.source == "held" else hypot(pitch_std, _BODY_STD)
    return GroundPlane(road.plane, pitch_std, _HEIGHT_STD if mounted else _ASSUMED_HEIGHT_STD)


def contacts(frame: Frame, ground: GroundPlane, objects: Sequence[Object]) -> dict[int, Contact]:
    """The contacts, by position, of the objects whose boxes are within the image and whose lower edges are visible.

    A lower edge is hidden if nearer boxes of kept objects, those that end lower, cover half of it. A box is clear if
    none of them touches it, up to the deviation of its edges: the box of a partly hidden object grows as more of it
    becomes visible.
    """
    kept = corners(item.detection.box_px for item in objects if item.kept)
    boxes = [item.detection.box_px for item in objects]
    return {
        k: _contact(frame, ground, objects[k], clear=not len(_nearer(box, kept, 2.0)[0]))
        for k, box in enumerate(boxes)
        if _inside(frame.camera, box) and not _hidden(box, kept)
    }


def _inside(camera: Camera, box: Box) -> bool:
    """Whether neither the left, the right nor the lower border of the image cuts a box.

    The box of the car's own bonnet may end a little above the lower border.
    """
    above_px = _BORDER_SIGMAS * edge_std_px(box.y_max - box.y_min)
    right, bottom = camera.width - _BORDER_PX, camera.height - above_px
    return box.x_min >= _BORDER_PX and box.x_max <= right and box.y_max <= bottom and box.area > 0


def _hidden(box: Box, kept: Float) -> bool:
    """Whether nearer ones of (4, K) boxes cover half of a box's lower edge."""
    left, right = (np.clip(x, box.x_min, box.x_max) for x in _nearer(box, kept, 0.0))
    order = np.argsort(left)
    left, reached = left[order], np.maximum.accumulate(right[order])
    before = np.append(box.x_min, reached)[: len(reached)]
    return float(np.maximum(reached - np.maximum(left, before), 0.0).sum()) > _HIDDEN * (box.x_max - box.x_min)


def _nearer(box: Box, kept: Float, sigmas: float) -> tuple[Float, Float]:
    """Left and right edges of those of (4, K) boxes that end lower and come near a box by deviations of its edges."""
    x0, y0, x1, y1 = kept
    x, y = (sigmas * edge_std_px(side) for side in (box.x_max - box.x_min, box.y_max - box.y_min))
    meets = (y1 > box.y_max) & (y0 < box.y_max + y) & (x0 < box.x_max + x) & (x1 > box.x_min - x)
    return x0[meets], x1[meets]


def with_distances(camera: Camera, objects: Sequence[Object], found: Mapping[int, Contact]) -> tuple[Object, ...]:
    """The objects with distances from their ground contacts, which are given by position.

    The distance is that of the nearest point of an upright face above the contact, as with depth. Objects above the
    horizon, or whose distance is uncertain by more than ``MOST_STD_SHARE``, have none.
    """
    return tuple(_with_distance(camera, item, found.get(k)) for k, item in enumerate(objects))


def _with_distance(camera: Camera, item: Object, contact: Contact | None) -> Object:
    if contact is None or contact.depth_m is None:
        return item
    length = hypot(*_nearest_ray(camera, item.detection.box_px))
    distance_m, std_m = contact.depth_m * length, contact.std_m * length
    return changed(item, distance_m=distance_m, distance_std_m=std_m, distance_source="ground")


def _contact(frame: Frame, ground: GroundPlane, item: Object, *, clear: bool) -> Contact:
    """Where the middle of a box's lower edge meets the road."""
    camera, box, nowhere = frame.camera, item.detection.box_px, Contact(None, inf, MOST_STD_SHARE, clear)
    middle = np.array([(box.x_min + box.x_max) / 2 - 0.5, box.y_max - 0.5])
    slope = -float(rays(camera, middle) @ ground.plane.n)
    if slope <= 0:
        return nowhere
    height_m = ground.plane.offset_m
    to_tyres_m = height_m / slope
    is_vehicle = classes_of_label(item.detection.label) == ("vehicle",)
    depth_m = to_tyres_m - _OVERHANG_M if is_vehicle else to_tyres_m
    m_per_rad = to_tyres_m**2 / height_m
    # The slope's random walk from the car to the object, seen from the car.
    pitch_std = hypot(ground.pitch_std, _SLOPE_STD_PER_ROOT_M * sqrt(to_tyres_m / 3.0))
    place_std_m = _OVERHANG_STD_M if is_vehicle else to_tyres_m * _KERB_STD_M / height_m
    common_m = hypot(m_per_rad * pitch_std, to_tyres_m * ground.height_std, place_std_m)
    row_px = max(edge_std_px(box.y_max - box.y_min), _gap_px(frame, item.detection))
    row_std = row_px * abs(ground.plane.normal[1]) / camera.fy
    std_m = hypot(m_per_rad * row_std, common_m)
    return Contact(depth_m, std_m, common_m / depth_m, clear) if std_m <= MOST_STD_SHARE * depth_m else nowhere


def _gap_px(frame: Frame, detection: Detection) -> float:
    """Rows between the lower edge of a box and the lower end of the object in the tags; 0 if they do not show it.

    Some detectors end a car's box at its bumper.
    """
    lookup = None if frame.table is None else label_lookup(frame.table, detection.label)
    x0, y0, x1, y1 = detection.box_px.rounded(frame.camera.width, frame.camera.height)
    middle = (y0 + y1) // 2
    if frame.tags is None or lookup is None or middle >= y1 or x0 >= x1:
        return 0.0
    inside, below = lookup[frame.tags[middle:y1, x0:x1]] > 0, lookup[frame.tags[y1 : 2 * y1 - middle, x0:x1]] > 0
    if np.count_nonzero(inside) < _SEEN * inside.size:
        return 0.0
    too_high, too_low = (np.logical_and.accumulate(rows).sum(axis=0) for rows in (below, ~inside[::-1]))
    return float(max(np.median(too_high), np.quantile(too_low, _LOWEST)))


def edge_std_px(side_px: float) -> float:
    """Standard deviation in pixels of a detected box's edge; ``side_px`` is the side at right angles to it."""
    return max(EDGE_STD_SHARE * side_px, EDGE_STD_PX)


def _nearest_ray(camera: Camera, box: Box) -> tuple[float, float, float]:
    """Direction, z = 1, of the nearest point of a face at right angles to the camera's axis that fills a box."""
    x0, x1 = ((x - 0.5 - camera.cx) / camera.fx for x in (box.x_min, box.x_max))
    y0, y1 = ((y - 0.5 - camera.cy) / camera.fy for y in (box.y_min, box.y_max))
    return min(max(0.0, x0), x1), min(max(0.0, y0), y1), 1.0


def extent(frame: Frame, path: EgoPath, item: Object, contact: Contact) -> Extent | None:
    """The edges of an object beside the path, from its box at its ground contact; None without a depth.

    The box of a vehicle beside the camera's axis shows its flank. The flank's far end bounds the box, so that side of
    the box is deeper by a vehicle's length.
    """
    box, camera = item.detection.box_px, frame.camera
    if contact.depth_m is None:
        return None
    directions = rays(camera, np.array([[x - 0.5, box.y_max - 0.5] for x in (box.x_min, box.x_max)]))
    long_m = OBJECT_LENGTH_M if classes_of_label(item.detection.label) == ("vehicle",) else 0.0
    inner = 0 if directions[0, 0] > 0 else 1 if directions[1, 0] < 0 else None
    depths_m = np.array([contact.depth_m + (long_m if k == inner else 0.0) for k in range(2)])
    points = directions * contact.depth_m
    points[:, 0] = directions[:, 0] * depths_m
    left, right = left_of(path, *transform(frame.ego_T_camera, points).T[:2]).tolist()
    across = edge_std_px(box.x_max - box.x_min) * contact.depth_m / camera.fx
    aside = float(np.abs(directions[:, 0]).max()) * contact.std_m
    std_m = sqrt(LATERAL_STD_M**2 + across**2 + aside**2)
    return Extent(right, left, std_m, _nearest_ray(camera, box))
