"""The path that the car is going to take, by its lane or else its circle, where objects are beside it, and the impact.

A collision is foreseen with what is in the path alone: forward collision warning knows an obstacle vehicle on the
subject vehicle's trajectory, not one beside it (ISO 15623; GB/T 33577-2017, which has its terms). The time to collision
is the distance over the relative speed; a vehicle cuts in that is beside the path and moves towards it.
"""

from dataclasses import dataclass, replace
from math import atan2, ceil, cos, exp, fsum, hypot, sin, sqrt

import numpy as np

from roadperc_stream.chain.kernels import object_points
from roadperc_stream.chain.stages.objects.rate_filter import RateFilter
from roadperc_stream.chain.stages.objects.regions import ranked
from roadperc_stream.chain.stages.objects.tracking import Extent, ObjectTrack
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Float, Float32
from roadperc_stream.model import SIDES, Boundary, Detection, Lanes, Object, PathSource
from roadperc_stream.model.scene import Scene
from roadperc_stream.model.tag_tables import classes_of_label, label_lookup

_TURNING_FROM_M = 1e-3
"""A shorter step says nothing of the direction in which the car drives."""
_STRAIGHT_M = 0.1
"""Less way than this says nothing of a curvature."""
PATH_MEMORY_M = 5.0
"""Way over which the path's curvature by odometry is averaged, the latest metres counting most."""
_LANE_WIDTH_MIN_M = 2.0
"""A narrower lane is none that the car drives in."""
_LANE_WIDTH_MAX_M = 5.0
"""In a wider lane the path runs along its boundaries, but where the car is, not in the middle."""
_OBJECT_LENGTH_M = 5.0
"""Pixels so far behind an object's nearest point count for its place beside the path: a car's length."""
_LATERAL_STD_M = 0.1
"""Least standard deviation of where an object's edges are beside the path."""
_MOST_PIXELS = 1000
"""A place needs no more."""
_FEWEST_PIXELS = 5
_NEARER_SHARE = 0.05
"""Pixels nearer than the object by more than this share of its distance are of something before it."""
_NEARER_M = 0.3
_OUTERMOST = 0.02
"""Share of the pixels beyond either edge: strays at the border of the class."""
_NEAREST = 0.05
"""Share of the pixels that are the nearest ones."""
_STD_SHARE = 0.005
"""Of the distance, beside the least standard deviation of an edge: what a wobbling border and the path are off."""
_VAGUE_M = 1.0
"""Largest standard deviation of an edge for a decision whether it is in the path."""
_VAGUE_MPS = 0.8
"""Largest standard deviation of an edge's speed for a decision whether it stays there."""
_CROSSING_MPS = 2.0
"""Speed across the path at which no lane is changed."""
_SURE_SIGMAS = 2.0


@dataclass(frozen=True)
class EgoPath:
    """The middle of the path, a circle in the ego frame: where it is at x = 0, its heading there and its curvature.

    ``lane_half_m`` is half the lane's width, None where no lane is known; ``lane_changes`` tells one lane from the
    next.
    """

    source: PathSource
    offset_m: float = 0.0
    heading: float = 0.0
    curvature_per_m: float = 0.0
    lane_half_m: float | None = None
    lane_changes: int | None = None

    def goes_on(self, before: "EgoPath") -> bool:
        """Whether it is the path of the frame before, so that places beside it can be compared."""
        return (self.source, self.lane_changes) == (before.source, before.lane_changes)


@dataclass(frozen=True)
class DrivenArc:
    """How far the car has turned (radians, to the left) over which way, the latest metres counting most."""

    turned: float = 0.0
    driven_m: float = 0.0

    def after(self, last_T_this: Float | None) -> "DrivenArc":
        """After a step, by metres, not by time: a car that stands still keeps what its wheels point at."""
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
        """Yaw rate over speed; None where the car has hardly moved."""
        return self.turned / self.driven_m if self.driven_m >= _STRAIGHT_M else None


def path_of(lanes: Lanes | None, arc: DrivenArc) -> EgoPath:
    """The lane's middle; along a boundary where the lane is not known; the circle the car drives on; straight ahead.

    Args:
        lanes: the frame's, None where they were not looked for or could not be found.
        arc: what odometry says of the last metres.
    """
    known = [] if lanes is None else [line for side in SIDES if (line := _known(lanes.side(side))) is not None]
    width_m = known[0][0] - known[1][0] if len(known) == len(SIDES) else None
    if known and (width_m is None or width_m >= _LANE_WIDTH_MIN_M):
        offset, heading, curvature = (fsum(values) / len(values) for values in zip(*known, strict=True))
        changes = None if lanes is None else lanes.lane_changes
        if width_m is None or width_m > _LANE_WIDTH_MAX_M:
            return EgoPath("boundary", 0.0, heading, curvature, None, changes)
        return EgoPath("lane", offset, heading, curvature, width_m / 2, changes)
    curvature_per_m = arc.curvature_per_m
    if curvature_per_m is None:
        return EgoPath("straight")
    return EgoPath("odometry", curvature_per_m=curvature_per_m)


def _known(boundary: Boundary) -> tuple[float, float, float] | None:
    """Offset, heading and curvature of a boundary that is measured or held."""
    if boundary.status == "lost" or boundary.offset_m is None or boundary.heading is None:
        return None
    return boundary.offset_m, boundary.heading, boundary.curvature_per_m or 0.0


def extent(scene: Scene, path: EgoPath, item: Object) -> Extent | None:
    """Where the object's nearest pixels lie, as far as a car is long behind its nearest point.

    Args:
        scene: the frame.
        path: the car's, in the ego frame.
        item: with its distance, this frame's own.

    Returns:
        None where too few pixels have a depth.
    """
    if item.distance_m is None or scene.depth_m is None:
        return None
    points, ranges_m = _points(scene, scene.depth_m, item.detection, item.distance_m)
    if len(points) < _FEWEST_PIXELS:
        return None
    right, left = ranked(left_of(path, points, scene.ego_T_camera), _OUTERMOST, 1.0 - _OUTERMOST)
    nearest = points[ranges_m <= ranked(ranges_m, _NEAREST)[0]]
    x, y = (np.cumsum(nearest[:, :2] / nearest[:, 2:], axis=0)[-1] / len(nearest)).tolist()
    return Extent(right, left, _LATERAL_STD_M + _STD_SHARE * item.distance_m, (x, y, 1.0))


def left_of(path: EgoPath, points: Float, ego_T_camera: Float) -> Float:
    """(N,) how far (N, 3) points in the camera's frame are to the left of the path, square to it.

    That is exact on the circle, and without a singularity where it is a straight line.
    """
    bend, cosine, sine = path.curvature_per_m, cos(path.heading), sin(path.heading)
    along, across = (
        row[0] * points[:, 0] + row[1] * points[:, 1] + row[2] * points[:, 2] + row[3] for row in ego_T_camera[:2]
    )
    across = across - path.offset_m
    ahead, aside = cosine * along + sine * across, cosine * across - sine * along
    to_centre = np.hypot(bend * ahead, 1.0 - bend * aside)
    lateral: Float = (2.0 * aside - bend * (ahead**2 + aside**2)) / (1.0 + to_centre)
    return lateral


def _points(scene: Scene, depth_m: Float32, detection: Detection, distance_m: float) -> tuple[Float, Float]:
    """(N, 3) points of the object in the camera's frame, and their distances.

    They are of pixels spread over its box: of every one of a small box.
    """
    camera = scene.camera
    x0, y0, x1, y1 = detection.box_px.rounded(camera.width, camera.height)
    step = max(ceil(sqrt(max(x1 - x0, 0) * max(y1 - y0, 0) / _MOST_PIXELS)), 1)
    lookup = None if scene.table is None else label_lookup(scene.table, detection.label)
    of_class = None if scene.tags is None or lookup is None else (scene.tags, lookup)
    behind_m = -_NEARER_M - _NEARER_SHARE * distance_m, _OBJECT_LENGTH_M
    pinhole = camera.fx, camera.fy, camera.cx, camera.cy
    return object_points(depth_m, pinhole, (x0, y0, x1, y1, step), of_class, distance_m, behind_m)


def judged(cfg: ObjectsConfig, path: EgoPath, item: Object, track: ObjectTrack) -> Object:
    """An object with its track's id, its place beside the path, its closing speed and its time to impact."""
    return _timed(cfg, _placed(cfg, path, replace(item, track_id=str(track.number)), track), track)


def _placed(cfg: ObjectsConfig, path: EgoPath, item: Object, track: ObjectTrack) -> Object:
    """With how far its middle is beside the path, whether any of it is in the path, and whether it cuts in."""
    right, left = track.right_m, track.left_m
    if right is None or left is None or sqrt(max(right.value_var, left.value_var)) > _VAGUE_M:
        return item
    half_m = cfg.car_width_m / 2 + cfg.path_margin_m
    in_path = right.value < half_m and left.value > -half_m
    nearer = right if right.value + left.value > 0 else left.mirrored()
    cut_in = None
    if path.lane_half_m is not None:  # over the lane's line, and surely on its way in
        surely_mps = max(cfg.cut_in_mps, _SURE_SIGMAS * sqrt(nearer.rate_var))
        cut_in = not in_path and nearer.value < path.lane_half_m and -nearer.rate > surely_mps
    return replace(item, lateral_m=(right.value + left.value) / 2, in_path=in_path, cut_in=cut_in)


def _timed(cfg: ObjectsConfig, item: Object, track: ObjectTrack) -> Object:
    """With closing speed and time to impact by the track's distances.

    The speed is that of the distance to the camera, positive when coming nearer. A speed that is not known well is
    not given. A time to impact is given only for what is in the path and surely comes nearer, and not while the
    distances contradict the filtered one: either may be another object's.
    """
    distance = track.distance_m
    if distance is None or sqrt(distance.rate_var) > cfg.max_speed_std_mps:
        return item
    closing, std = -distance.rate, sqrt(distance.rate_var)
    own = sqrt(track.jitter.rate_var_scale) if track.jitter else 1.0
    item = replace(item, closing_speed_mps=closing, closing_speed_std_mps=own * std)
    contradicted = track.rival_m is not None or distance.value <= 0
    nears = closing >= cfg.min_closing_mps and closing >= cfg.min_closing_sigmas * std
    if not item.in_path or contradicted or not nears:
        return item
    impact_s = distance.value / closing
    if not _may_be_hit(cfg, item.detection.label, track, impact_s):
        return item
    return replace(item, time_to_impact_s=impact_s, time_to_impact_std_s=own * _time_to_impact_std_s(distance))


def _may_be_hit(cfg: ObjectsConfig, label: str, track: ObjectTrack, after_s: float) -> bool:
    """Whether an object in the path may still be there when the car comes; of a vehicle its motion must be known.

    An oncoming car in a bend is for a moment where the lane seems to go on, but crosses that at metres a second;
    who changes lanes is slower. A pedestrian who crosses is not past before he is: he may stop.
    """
    if classes_of_label(label) == ("pedestrian",):
        return True
    right, left = track.right_m, track.left_m
    if right is None or left is None or sqrt(max(right.rate_var, left.rate_var)) > _VAGUE_MPS:
        return False
    half_m = cfg.car_width_m / 2 + cfg.path_margin_m
    inner = (right, left.mirrored())
    return not any(edge.rate > _CROSSING_MPS and _least(edge, after_s) > half_m for edge in inner)


def _least(edge: RateFilter, after_s: float) -> float:
    """Where an edge will be, less its standard deviation."""
    variance = edge.value_var + 2 * after_s * edge.cross_var + after_s**2 * edge.rate_var
    return edge.value + edge.rate * after_s - sqrt(variance)


def _time_to_impact_std_s(distance: RateFilter) -> float:
    """First-order propagation through distance / closing speed, their covariance included."""
    by_distance = -1 / distance.rate
    by_rate = distance.value / distance.rate**2
    variance = (
        by_distance**2 * distance.value_var
        + 2 * by_distance * by_rate * distance.cross_var
        + by_rate**2 * distance.rate_var
    )
    return sqrt(max(variance, 0.0))
