"""What an object's track says of it: its place beside the path, closing speed and time to impact, as far as known.

Terms of forward collision warning (GB/T 33577-2017, after ISO 15623): the time to collision is the distance over the
relative speed, of a vehicle on the subject vehicle's trajectory; a vehicle cuts in that is beside it and moves
towards it.
"""

from dataclasses import dataclass, replace
from math import sqrt

from roadperc_stream.chain.stages.objects.path import EgoPath
from roadperc_stream.chain.stages.objects.rate_filter import RateFilter
from roadperc_stream.chain.stages.objects.tracking import ObjectTrack
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.model import Object
from roadperc_stream.model.tag_tables import classes_of_label

_VAGUE_M = 1.0
"""Standard deviation of an edge beyond which nobody can say whether it is in the path."""
_VAGUE_MPS = 0.8
"""Standard deviation of an edge's speed beyond which nobody can say whether it stays there."""
_CROSSING_MPS = 2.0
"""Speed across the path at which no lane is changed."""
_SURE_SIGMAS = 2.0


def judged(cfg: ObjectsConfig, path: EgoPath, item: Object, track: ObjectTrack) -> Object:
    """An object with its track's id, its place beside the path, its closing speed and its time to impact."""
    place = _place(cfg, path, track)
    motion = _motion(cfg, item.detection.label, track, in_path=bool(place.in_path))
    return replace(
        item,
        track_id=track.id,
        lateral_m=place.lateral_m,
        in_path=place.in_path,
        cut_in=place.cut_in,
        closing_speed_mps=motion.closing_mps,
        closing_speed_std_mps=motion.closing_std_mps,
        time_to_impact_s=motion.impact_s,
        time_to_impact_std_s=motion.impact_std_s,
    )


@dataclass(frozen=True)
class _Place:
    """How far the object's middle is beside the path, whether any of it is in the path, and whether it cuts in."""

    lateral_m: float | None = None
    in_path: bool | None = None
    cut_in: bool | None = None


@dataclass(frozen=True)
class _Motion:
    """Closing speed and time to impact with their standard deviations."""

    closing_mps: float | None = None
    closing_std_mps: float | None = None
    impact_s: float | None = None
    impact_std_s: float | None = None


def _place(cfg: ObjectsConfig, path: EgoPath, track: ObjectTrack) -> _Place:
    right, left = track.right_m, track.left_m
    if right is None or left is None or sqrt(max(right.value_var, left.value_var)) > _VAGUE_M:
        return _Place()
    half_m = cfg.car_width_m / 2 + cfg.path_margin_m
    in_path = right.value < half_m and left.value > -half_m
    nearer = right if right.value + left.value > 0 else left.mirrored()
    cut_in = None if path.lane_half_m is None else not in_path and _cuts_in(cfg, nearer, path.lane_half_m)
    return _Place((right.value + left.value) / 2, in_path, cut_in)


def _cuts_in(cfg: ObjectsConfig, edge: RateFilter, lane_half_m: float) -> bool:
    """Whether the edge that faces the path, metres beside its middle, is over the lane's line and surely moves in."""
    inward = -edge.rate
    return edge.value < lane_half_m and inward > max(cfg.cut_in_mps, _SURE_SIGMAS * sqrt(edge.rate_var))


def _motion(cfg: ObjectsConfig, label: str, track: ObjectTrack, *, in_path: bool) -> _Motion:
    """By the track's distances.

    The speed is that of the distance to the camera, positive when coming nearer. A speed that is not known well is
    not given. A time to impact is given only for what is in the path and surely comes nearer, and not while the
    distances contradict the filtered one: either may be another object's.
    """
    distance = track.distance_m
    if distance is None or sqrt(distance.rate_var) > cfg.max_speed_std_mps:
        return _Motion()
    closing, std = -distance.rate, sqrt(distance.rate_var)
    own = sqrt(track.jitter.rate_var_scale) if track.jitter else 1.0
    contradicted = track.rival_m is not None or distance.value <= 0
    nears = closing >= cfg.min_closing_mps and closing >= cfg.min_closing_sigmas * std
    if not in_path or contradicted or not nears or not _may_be_hit(cfg, label, track, distance.value / closing):
        return _Motion(closing, own * std)
    return _Motion(closing, own * std, distance.value / closing, own * _time_to_impact_std_s(distance))


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
