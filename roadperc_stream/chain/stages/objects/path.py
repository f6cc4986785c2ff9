"""The path of the car, the places of objects beside it, and the time to impact.

The path is the middle of the lane, else the circle that the car drives. Only objects in the path can be hit, as in
forward collision warning (ISO 15623; terms of GB/T 33577-2017). The time to collision is the distance over the relative
speed. A vehicle cuts in if it is beside the path and moves towards it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, ceil, cos, exp, fsum, hypot, radians, sin, sqrt

import numpy as np

from roadperc_stream.chain.stages.objects import growth
from roadperc_stream.chain.stages.objects.object_track import Extent, ObjectTrack
from roadperc_stream.chain.stages.objects.rate_filter import RateFilter
from roadperc_stream.chain.stages.objects.regions import ranked
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.model import SIDES, Boundary, Lanes, Mask, Object, PathSource
from roadperc_stream.model.changed import changed
from roadperc_stream.model.frame import Frame, mark
from roadperc_stream.model.tag_tables import classes_of_label, label_lookup

_TURNING_FROM_M = 1e-3
"""Shortest step that shows the direction in which the car drives."""
_STRAIGHT_M = 0.1
"""Shortest driven distance that shows a curvature."""
PATH_MEMORY_M = 5.0
"""Distance over which the path's curvature by odometry is averaged; the latest metres have the largest weight."""
_LANE_WIDTH_MIN_M = 2.0
"""Width of the narrowest lane in which the car can drive."""
_LANE_WIDTH_MAX_M = 5.0
"""In a wider lane, the path is parallel to the boundaries through the car, not in the middle."""
_DIRECTED_AT_M = 15.0
"""Distance ahead at which the deviation of a boundary's direction is taken."""
_PARALLEL = radians(3.0)
"""Largest angle in radians between the boundaries of a lane; where a lane merges or splits, it is larger."""
OBJECT_LENGTH_M = 5.0
"""Pixels up to this far behind an object's nearest point determine its place: a car's length."""
LATERAL_STD_M = 0.1
"""Least standard deviation of the place of an object's edges."""
_MOST_PIXELS = 1000
"""Larger boxes are sampled with about this number of pixels."""
_FEWEST_PIXELS = 5
_NEARER_SHARE = 0.05
"""Pixels nearer than the object by more than this share of its distance belong to something in front of it."""
_NEARER_M = 0.3
_OUTERMOST = 0.02
"""Share of the pixels left out beyond either edge: stray pixels at the border of the class."""
_NEAREST = 0.05
"""Share of the pixels that count as nearest."""
_STD_SHARE = 0.005
"""Standard deviation of an edge as a share of its distance, from errors of the border and of the path."""
_VAGUE_M = 1.0
"""An edge with a larger standard deviation cannot be judged to be in the path."""
_VAGUE_MPS = 0.8
"""An edge whose speed has a larger standard deviation cannot be judged to stay in the path."""
_ACROSS = 3.0
"""Least ratio of the speeds across and towards the camera of an object that crosses the road."""
_CROSSING_MPS = 2.0
"""Speed across the path above which a vehicle crosses it instead of changing lanes."""
_SURE_SIGMAS = 2.0
_STEERING_MPS3 = 0.11
"""Standard deviation of the lateral jerk by steering, m/s³: the path is a circle, so it does not contain the steering
until the car arrives."""


@dataclass(frozen=True)
class EgoPath:
    """The middle of the path, a circle in the ego frame: its offset and heading at x = 0, and its curvature.

    ``lane_half_m`` is half the lane's width, None without a lane; ``lane_changes`` identifies the lane.
    """

    source: PathSource
    offset_m: float = 0.0
    heading: float = 0.0
    curvature_per_m: float = 0.0
    lane_half_m: float | None = None
    lane_changes: int | None = None

    def goes_on(self, before: "EgoPath") -> bool:
        """Whether it continues the path of the previous frame, so that places beside both can be compared."""
        return (self.source, self.lane_changes) == (before.source, before.lane_changes)


@dataclass(frozen=True)
class DrivenArc:
    """Turn (radians, to the left) over a driven distance (metres); the latest metres have the largest weight."""

    turned: float = 0.0
    driven_m: float = 0.0

    def after(self, last_T_this: Float | None) -> "DrivenArc":
        """The arc after a step; weights fade by metres, not by time, so that a standing car keeps its curvature."""
        if last_T_this is None:
            return self
        way_m = hypot(last_T_this[0, 3], last_T_this[1, 3])
        if way_m < _TURNING_FROM_M:
            return self
        fading = exp(-way_m / PATH_MEMORY_M)
        turn = atan2(last_T_this[1, 0], last_T_this[0, 0])
        return DrivenArc(fading * self.turned + turn, fading * self.driven_m + way_m)

    @property
    def curvature_per_m(self) -> float | None:
        """Yaw rate over speed, 1/m; None if the car has hardly moved."""
        return self.turned / self.driven_m if self.driven_m >= _STRAIGHT_M else None


def path_of(lanes: Lanes | None, arc: DrivenArc) -> EgoPath:
    """The path by the first source that is known: lane, one boundary, driven circle, straight ahead.

    Args:
        lanes: the lanes of the frame; None if absent.
        arc: the arc of the last metres by odometry.
    """
    known = [] if lanes is None else [line for side in SIDES if (line := _known(lanes.side(side))) is not None]
    if len(known) == len(SIDES) and abs(known[0][1] - known[1][1]) > _PARALLEL:
        known = [min(known, key=lambda line: abs(line[1]))]  # the car drives along this one
    width_m = known[0][0] - known[1][0] if len(known) == len(SIDES) else None
    if known and (width_m is None or width_m >= _LANE_WIDTH_MIN_M):
        offset = fsum(line[0] for line in known) / len(known)
        total = fsum(line[3] for line in known)
        heading, curvature = (fsum(line[3] * line[k] for line in known) / total for k in (1, 2))
        changes = None if lanes is None else lanes.lane_changes
        if width_m is None or width_m > _LANE_WIDTH_MAX_M:
            return EgoPath("boundary", 0.0, heading, curvature, None, changes)
        return EgoPath("lane", offset, heading, curvature, width_m / 2, changes)
    curvature_per_m = arc.curvature_per_m
    if curvature_per_m is None:
        return EgoPath("straight")
    return EgoPath("odometry", curvature_per_m=curvature_per_m)


def _known(boundary: Boundary) -> tuple[float, float, float, float] | None:
    """Offset, heading, curvature of a boundary that is measured or held, and the weight of its direction.

    A boundary whose direction is unsure, such as one that leaves the lane where it splits, hardly bends the path.
    """
    if boundary.status == "lost" or boundary.offset_m is None or boundary.heading is None:
        return None
    aside = np.array([0.0, _DIRECTED_AT_M, _DIRECTED_AT_M**2 / 2])
    variance = float(aside @ np.reshape(boundary.covariance or (0.0,) * 9, (3, 3)) @ aside)
    weight = 1.0 / (variance + LATERAL_STD_M**2)
    return boundary.offset_m, boundary.heading, boundary.curvature_per_m or 0.0, weight


def extents(frame: Frame, path: EgoPath, items: Sequence[Object]) -> list[Extent | None]:
    """The edges of objects beside the path, from their pixels up to a car's length behind their nearest points.

    All objects are computed at once, because calls cost more than pixels.

    Args:
        frame: the frame.
        path: the car's path, in the ego frame.
        items: the objects with their distances in this frame.

    Returns:
        None for objects without a distance, or if too few pixels have a depth.
    """
    if frame.depth_m is None or not items:
        return [None] * len(items)
    boxes = [_sampled(frame.camera, item) for item in items]
    counts = [len(range(r.start, r.stop, r.step)) * len(range(c.start, c.stop, c.step)) for r, c in boxes]
    x, y, depths_m, chosen = _pixels(frame, frame.depth_m, items, boxes, counts)
    distances_m = np.repeat([item.distance_m or np.nan for item in items], counts)
    ranges_m = depths_m * np.sqrt(x**2 + (y**2 + 1.0))
    chosen &= ranges_m > (1.0 - _NEARER_SHARE) * distances_m - _NEARER_M
    chosen &= ranges_m < distances_m + OBJECT_LENGTH_M
    at = np.flatnonzero(chosen)
    x, y, z, ranges_m = x[at], y[at], depths_m[at], ranges_m[at]
    ego = (z * (row[0] * x + row[1] * y + row[2]) + row[3] for row in frame.ego_T_camera[:2].tolist())
    lateral_m = left_of(path, *ego)
    ends = [0, *np.searchsorted(at, np.cumsum(counts)).tolist()]
    found: list[Extent | None] = []
    for item, first, end in zip(items, ends, ends[1:], strict=False):
        if item.distance_m is None or end - first < _FEWEST_PIXELS:
            found.append(None)
            continue
        right, left = ranked(lateral_m[first:end], _OUTERMOST, 1.0 - _OUTERMOST)
        nearest = first + np.flatnonzero(ranges_m[first:end] <= ranked(ranges_m[first:end], _NEAREST)[0])
        to_x, to_y = (float(np.add.reduce(way[nearest])) / len(nearest) for way in (x, y))
        found.append(Extent(right, left, LATERAL_STD_M + _STD_SHARE * item.distance_m, (to_x, to_y, 1.0)))
    return found


def _sampled(camera: Camera, item: Object) -> tuple[slice, slice]:
    """Rows and columns of an object's pixels, evenly spaced; empty without a distance."""
    x0, y0, x1, y1 = item.detection.box_px.rounded(camera.width, camera.height)
    if item.distance_m is None or x0 >= x1 or y0 >= y1:
        return slice(0, 0, 1), slice(0, 0, 1)
    step = ceil(sqrt((x1 - x0) * (y1 - y0) / _MOST_PIXELS))
    return slice(y0, y1, step), slice(x0, x1, step)


def _pixels(
    frame: Frame, depth_m: Float32, items: Sequence[Object], boxes: Sequence[tuple[slice, slice]], counts: Sequence[int]
) -> tuple[Float, Float, Float, Mask]:
    """The pixels of all boxes: x and y of their rays with z = 1, their depths, and whether they are of the class."""
    camera, (x, y, depths_m), end = frame.camera, np.empty((3, sum(counts))), 0
    chosen = np.ones(len(x), bool)
    across, down = (np.arange(camera.width) - camera.cx) / camera.fx, (np.arange(camera.height) - camera.cy) / camera.fy
    for item, (rows, columns), count in zip(items, boxes, counts, strict=True):
        first, end = end, end + count
        of_box = depth_m[rows, columns]
        for values, all_values in ((across[columns], x), (down[rows, None], y), (of_box, depths_m)):
            all_values[first:end].reshape(of_box.shape)[...] = values
        lookup = None if frame.table is None else label_lookup(frame.table, item.detection.label)
        if frame.tags is not None and lookup is not None and count:
            chosen[first:end] = mark(frame.tags[rows, columns], lookup).ravel()
    return x, y, depths_m, chosen


def left_of(path: EgoPath, ahead_m: Float, left_m: Float) -> Float:
    """(N,) distance of points in the ego frame to the left of the path, at right angles to it, metres.

    The formula is exact on the circle and has no singularity for a straight line.

    Args:
        path: in the ego frame.
        ahead_m: (N,) x of the points.
        left_m: (N,) y of the points.
    """
    bend, cosine, sine = path.curvature_per_m, cos(path.heading), sin(path.heading)
    across_m = left_m - path.offset_m
    ahead, aside = cosine * ahead_m + sine * across_m, cosine * across_m - sine * ahead_m
    bent_ahead, bent_aside = bend * ahead, bend * aside
    to_centre = np.sqrt(bent_ahead**2 + (1.0 - bent_aside) ** 2)
    lateral: Float = ((2.0 - bent_aside) * aside - bent_ahead * ahead) / (1.0 + to_centre)
    return lateral


def judged(cfg: ObjectsConfig, frame: Frame, path: EgoPath, item: Object, track: ObjectTrack) -> Object:
    """The object with its track's id, place beside the path, closing speed and time to impact."""
    placed = _placed(cfg, path, changed(item, track_id=str(track.number)), track)
    return _timed(cfg, placed, track, frame.inverse_depth_std)


def _placed(cfg: ObjectsConfig, path: EgoPath, item: Object, track: ObjectTrack) -> Object:
    """The object with ``lateral_m``, ``in_path`` and ``cut_in``, if its edges are known well enough."""
    right, left = track.right_m, track.left_m
    if right is None or left is None or sqrt(max(right.value_var, left.value_var)) > _VAGUE_M:
        return item
    half_m = cfg.car_width_m / 2 + cfg.path_margin_m
    in_path = right.value < half_m and left.value > -half_m
    nearer = right if right.value + left.value > 0 else left.mirrored()
    cut_in = None
    if path.lane_half_m is not None:  # over the lane's line, and certainly moving in
        surely_mps = max(cfg.cut_in_mps, _SURE_SIGMAS * sqrt(nearer.rate_var))
        cut_in = not in_path and nearer.value < path.lane_half_m and -nearer.rate > surely_mps
    return changed(item, lateral_m=(right.value + left.value) / 2, in_path=in_path, cut_in=cut_in)


def _timed(cfg: ObjectsConfig, item: Object, track: ObjectTrack, inverse_std: float) -> Object:
    """The object with closing speed and time to impact from the track's distances.

    The closing speed is positive if the distance to the camera decreases; it is None if its standard deviation is too
    large. Only an object in the path that certainly comes nearer has a time to impact. It has none while the measured
    distances contradict the filter, because they may belong to another object.

    An error of 1 / distance that the distances of stereo share, ``inverse_std``, is an error of the distance that
    changes with it: e d^2, which appears as the speed 2 e d times the closing speed.
    """
    distance = track.distance_m
    if track.ground_share is not None and distance is not None and distance.value > 0:
        return _timed_without_depth(cfg, item, track, distance)
    if distance is None or sqrt(distance.rate_var) > cfg.max_speed_std_mps:
        return item
    closing, std = -distance.rate, sqrt(distance.rate_var)
    shared_mps = 2.0 * inverse_std * distance.value * closing
    own = sqrt(track.jitter.rate_var_scale) if track.jitter else 1.0
    item = changed(item, closing_speed_mps=closing, closing_speed_std_mps=hypot(own * std, shared_mps))
    contradicted = track.rival_m is not None or distance.value <= 0
    nears = closing >= cfg.min_closing_mps and closing >= cfg.min_closing_sigmas * std
    if not item.in_path or contradicted or not nears:
        return item
    impact_s = distance.value / closing
    if not _may_be_hit(cfg, item.detection.label, track, impact_s):
        return item
    return changed(item, time_to_impact_s=impact_s, time_to_impact_std_s=own * _time_to_impact_std_s(distance))


def _timed_without_depth(cfg: ObjectsConfig, item: Object, track: ObjectTrack, distance: RateFilter) -> Object:
    """The same from ground contact and growth: each gives closing speed over distance, and the two are fused.

    Distances that contradict the filter leave the growth alone. The growth counts for objects in the path only: the
    flank of an object beside it grows differently. A box without a distance has no time to impact.
    """
    scale = max(track.jitter.rate_var_scale, 1.0) if track.jitter else 1.0
    found = None if track.rival_m else growth.of_distance(distance, scale, track.ground_share or 0.0)
    if track.growth is not None and item.in_path:
        found = track.growth.approach if found is None else found.fused(track.growth.approach, cfg.gate)
    if found is None:
        return item
    closing, std = found.rate * distance.value, sqrt(found.variance) * distance.value
    if std <= cfg.max_speed_std_mps:
        std_mps = hypot(std, (track.ground_share or 0.0) * closing)
        item = changed(item, closing_speed_mps=closing, closing_speed_std_mps=std_mps)
    nears = closing >= cfg.min_closing_mps and closing > max(cfg.min_closing_sigmas, 1.0) * std
    if (
        item.distance_m is None
        or not item.in_path
        or not nears
        or not _may_be_hit(cfg, item.detection.label, track, 1.0 / found.rate)
    ):
        return item
    return changed(item, time_to_impact_s=1.0 / found.rate, time_to_impact_std_s=found.time_to_impact_std_s)


def _may_be_hit(cfg: ObjectsConfig, label: str, track: ObjectTrack, after_s: float) -> bool:
    """Whether an object in the path may still be there when the car arrives; a vehicle needs a known motion.

    An oncoming car in a bend is briefly in the path, but crosses it at several metres per second; lane changes are
    slower. A standing car far ahead may be beside the path where the road begins to bend. A pedestrian or a car that
    crosses the road may stop at any time. While the path has just changed, the speed across it is unknown, but a car
    that drives ahead does not cross it.
    """
    if classes_of_label(label) == ("pedestrian",) or _crosses_road(track):
        return True
    right, left = track.right_m, track.left_m
    if right is None or left is None or sqrt(max(right.rate_var, left.rate_var)) > _VAGUE_MPS:
        return _drives_ahead(track)
    half_m = cfg.car_width_m / 2 + cfg.path_margin_m
    inner = (right, left.mirrored())
    if any(edge.rate > _CROSSING_MPS and _least(edge, after_s) > half_m for edge in inner):
        return False
    return _drives_ahead(track) or half_m - max(edge.value for edge in inner) > _path_std_m(track)


def _path_std_m(track: ObjectTrack) -> float:
    """Standard deviation of the path at an object, because the driver may steer until the car is there, metres.

    It is 0 if the car stands, and without depth or odometry.
    """
    distance, ego_rate = track.distance_m, track.ego_rate
    if distance is None or ego_rate is None or ego_rate.end_mps >= 0:
        return 0.0
    return _STEERING_MPS3 / 6 * (distance.value / -ego_rate.end_mps) ** 3


def _crosses_road(track: ObjectTrack) -> bool:
    """Whether an object certainly moves over the ground, and much faster across than towards the camera.

    In a turn, an oncoming car moves across as well.
    """
    place = track.place
    if place is None:
        return False
    across_mps = abs(place.right_m.rate) - sqrt(place.right_m.rate_var)
    return across_mps > max(_CROSSING_MPS, _ACROSS * -place.ahead_m.rate)


def _drives_ahead(track: ObjectTrack) -> bool:
    """Whether an object certainly moves away over the ground, and faster along the camera's axis than across."""
    place = track.place
    return place is not None and place.ahead_m.rate > max(
        _SURE_SIGMAS * sqrt(place.ahead_m.rate_var), abs(place.right_m.rate)
    )


def _least(edge: RateFilter, after_s: float) -> float:
    """Predicted place of an edge, minus its standard deviation, metres."""
    variance = edge.value_var + 2 * after_s * edge.cross_var + after_s**2 * edge.rate_var
    return edge.value + edge.rate * after_s - sqrt(variance)


def _time_to_impact_std_s(distance: RateFilter) -> float:
    """Standard deviation of distance / closing speed to first order, including their covariance, seconds."""
    by_distance = -1 / distance.rate
    by_rate = distance.value / distance.rate**2
    variance = by_distance**2 * distance.value_var + 2 * by_distance * by_rate * distance.cross_var
    return sqrt(max(variance + by_rate**2 * distance.rate_var, 0.0))
