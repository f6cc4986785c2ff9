"""One object over time: where its box is in the image, how far it is and how fast it comes nearer.

Three filters of a value and its rate: column and row of the box's centre, and the distance. The distance may jump to
something that passes in front of the object: a jump is rejected. What lies beyond the gate starts a rival of the
distance's filter, which replaces it when its distances have been consistent for a while.
"""

from dataclasses import dataclass, replace
from math import hypot

from roadperc_stream.chain.stages.objects import rate_filter
from roadperc_stream.chain.stages.objects.rate_filter import EgoRate, Jitter, RateFilter, Ray, change_of_distance_m
from roadperc_stream.chain.stages.objects.template import Template
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Float
from roadperc_stream.model import Box, Detection, Object
from roadperc_stream.system.time import NS_PER_S

_FIRST_SPEED_STD_MPS = 20.0
_FIRST_DRIFT_STD_MPS = 3.0
"""Of an unknown motion across the path."""
_LATERAL_NOISE = 1.0
"""m/s by which the speed of an object's edges across the path changes within a second."""
_SIDE_STD = 0.03
"""Of a detected box's centre, in box sides."""
_LEAST_STD_PX = 0.5
_FIRST_DRIFT_STD = 2.0
"""Of an unknown motion in the image, in box sides per second."""
_DRIFT_WALK = 2.0
"""By which that motion changes within a second."""
_UNKNOWN_STD_SHARE = 0.05
"""Of a distance whose deviation is not known: an object that partly lies beyond the depth's range."""
_ZOOM = (0.5, 2.0)
"""Most that a box shrinks or grows in one prediction."""


@dataclass(frozen=True)
class Extent:
    """The edges of an object, metres to the left of the path's middle, and their standard deviation.

    ``nearest_ray`` is the direction of its nearest pixels, z = 1 in the camera's frame.
    """

    right_m: float
    left_m: float
    std_m: float
    nearest_ray: tuple[float, float, float]


@dataclass(frozen=True)
class ObjectTrack:
    """An object that is tracked.

    ``box_px`` is its box at ``stamp_ns``, observed or predicted; ``x_px`` and ``y_px`` are the filters of its centre.
    It was last detected at ``detected_ns``, last observed (detected or found by its template) at ``observed_ns``, and
    that in every frame since ``run_ns``; ``missed`` says whether a frame has gone by without it since. ``rival_m`` is
    the filter of the distances beyond the gate since ``rival_ns``. ``right_m`` and ``left_m`` are the filters of its
    edges, metres to the left of the path's middle. ``ego_rate`` is the part of the distance's rate that is the car's
    own motion, None where that is not known, ``nearest_ray`` the direction of its nearest pixels, and ``jitter`` how
    much its distances jitter.
    """

    number: int
    detection: Detection
    box_px: Box
    x_px: RateFilter
    y_px: RateFilter
    distance_m: RateFilter | None
    stamp_ns: int
    detected_ns: int
    observed_ns: int
    run_ns: int
    missed: bool = False
    rival_m: RateFilter | None = None
    rival_ns: int = 0
    template: Template | None = None
    right_m: RateFilter | None = None
    left_m: RateFilter | None = None
    ego_rate: EgoRate | None = None
    nearest_ray: Ray | None = None
    jitter: Jitter | None = None


def start(cfg: ObjectsConfig, number: int, item: Object, box_px: Box, stamp_ns: int) -> ObjectTrack:
    """A new track of a detected object; ``box_px`` is its box within the image."""
    (x, y), (width, height) = _centre(box_px), _sides(box_px)
    track = ObjectTrack(
        number,
        item.detection,
        box_px,
        rate_filter.start(x, _centre_std(width), _FIRST_DRIFT_STD * width),
        rate_filter.start(y, _centre_std(height), _FIRST_DRIFT_STD * height),
        None,
        stamp_ns,
        stamp_ns,
        stamp_ns,
        stamp_ns,
    )
    return _with_distance(cfg, track, item, cut=False)


def predict(cfg: ObjectsConfig, track: ObjectTrack, stamp_ns: int, now_T_last: Float | None = None) -> ObjectTrack:
    """The track at a later stamp: the box moves on as its centre did and grows as the object comes nearer.

    Args:
        cfg: how much the motions wander.
        track: at an earlier stamp.
        stamp_ns: where to.
        now_T_last: (4, 4) the camera's motion between the two, None where it is not known.
    """
    dt_s = (stamp_ns - track.stamp_ns) / NS_PER_S
    width, height = _sides(track.box_px)
    x_px = track.x_px.predict(_DRIFT_WALK * width, dt_s)
    y_px = track.y_px.predict(_DRIFT_WALK * height, dt_s)
    distance_m, rival_m = (m.predict(cfg.process_noise, dt_s) if m else None for m in (track.distance_m, track.rival_m))
    right_m, left_m = (m.predict(_LATERAL_NOISE, dt_s) if m else None for m in (track.right_m, track.left_m))
    ego_rate = _ego_rate(track, now_T_last, dt_s)
    if ego_rate is not None and track.ego_rate is not None:
        change_m = (ego_rate.mean_mps - track.ego_rate.end_mps) * dt_s
        change_mps = ego_rate.end_mps - track.ego_rate.end_mps
        distance_m, rival_m = (m.shifted(change_m, change_mps) if m else None for m in (distance_m, rival_m))
    scale = zoom(track.distance_m.value if track.distance_m else None, distance_m)
    box_px = _box((x_px.value, y_px.value), (width * scale, height * scale))
    return replace(
        track,
        box_px=box_px,
        x_px=x_px,
        y_px=y_px,
        distance_m=distance_m,
        rival_m=rival_m,
        right_m=right_m,
        left_m=left_m,
        ego_rate=ego_rate,
        stamp_ns=stamp_ns,
        missed=track.observed_ns != track.stamp_ns,
    )


def _ego_rate(track: ObjectTrack, now_T_last: Float | None, dt_s: float) -> EgoRate | None:
    """Rate of the distance if the object stood still; None if unknown."""
    if now_T_last is None or track.distance_m is None or track.nearest_ray is None or dt_s <= 0:
        return None
    change_m = change_of_distance_m(now_T_last, track.nearest_ray, max(track.distance_m.value, 0.0))
    return EgoRate.after(change_m, dt_s, track.ego_rate)


def zoom(before_m: float | None, after_m: RateFilter | None) -> float:
    """How many times larger an object appears than at another distance; 1 where a distance is not known."""
    if before_m is None or after_m is None:
        return 1.0
    least, most = _ZOOM
    return min(max(before_m / after_m.value, least), most) if after_m.value > 0 else most


def detected(cfg: ObjectsConfig, track: ObjectTrack, item: Object, box_px: Box, *, cut: bool = False) -> ObjectTrack:
    """The predicted track after the detection that belongs to it; ``cut`` where the image's side cuts the object."""
    track = replace(track, detection=item.detection, detected_ns=track.stamp_ns)
    return observed(cfg, track, item, box_px, cut=cut)


def observed(cfg: ObjectsConfig, track: ObjectTrack, item: Object, box_px: Box, *, cut: bool = False) -> ObjectTrack:
    """The predicted track after its object was seen; found by its template alone it does not count as a detection."""
    (x, y), (width, height) = _centre(box_px), _sides(box_px)
    track = _with_distance(cfg, track, item, cut=cut)
    return replace(
        track,
        box_px=box_px,
        x_px=track.x_px.update(x, _centre_std(width)),
        y_px=track.y_px.update(y, _centre_std(height)),
        observed_ns=track.stamp_ns,
        run_ns=track.stamp_ns if track.missed else track.run_ns,
    )


def placed(track: ObjectTrack, extent: Extent | None, template: Template | None) -> ObjectTrack:
    """The track with its template, after its edges were seen beside the path."""
    if extent is None:
        return track if template is track.template else replace(track, template=template)
    if track.right_m is None or track.left_m is None:
        edges = (rate_filter.start(m, extent.std_m, _FIRST_DRIFT_STD_MPS) for m in (extent.right_m, extent.left_m))
        right_m, left_m = edges
    else:
        right_m = track.right_m.update(extent.right_m, extent.std_m)
        left_m = track.left_m.update(extent.left_m, extent.std_m)
    return replace(track, right_m=right_m, left_m=left_m, nearest_ray=extent.nearest_ray, template=template)


def expired(cfg: ObjectsConfig, track: ObjectTrack) -> bool:
    """Whether the object was last detected longer ago than it is tracked."""
    return (track.stamp_ns - track.detected_ns) / NS_PER_S > cfg.hold_s


def confirmed(cfg: ObjectsConfig, track: ObjectTrack) -> bool:
    """Whether the object was observed without a gap for long enough to be no stray detection."""
    return (track.observed_ns - track.run_ns) / NS_PER_S >= cfg.carry_after_s


def distance_std_m(cfg: ObjectsConfig, item: Object) -> float:
    """Standard deviation in metres of a measured distance."""
    if item.distance_std_m is not None:
        return item.distance_std_m
    return max(_UNKNOWN_STD_SHARE * (item.distance_m or 0.0), cfg.min_distance_std_m)


def _with_distance(cfg: ObjectsConfig, track: ObjectTrack, item: Object, *, cut: bool) -> ObjectTrack:
    """The track after its object's distance, if that is known."""
    if item.distance_m is None:
        return track
    std_m = distance_std_m(cfg, item)
    if not cut or track.distance_m is None:
        return _measured(cfg, track, item.distance_m, std_m)
    # What is nearest of it in the image is another point of it in each frame: that says nothing of its speed.
    dt_s = (track.stamp_ns - track.observed_ns) / NS_PER_S
    change_mps = _turning_mps2(track.distance_m, track.nearest_ray) * dt_s
    return replace(track, distance_m=track.distance_m.at(item.distance_m, std_m, change_mps), rival_m=None)


def _measured(cfg: ObjectsConfig, track: ObjectTrack, distance_m: float, std_m: float) -> ObjectTrack:
    """After a distance: it belongs to the filter or to its rival, whichever it fits, or to a new rival."""
    filtered, rival = track.distance_m, track.rival_m
    new = Jitter.of_first(track.stamp_ns, distance_m, std_m)
    if filtered is None:
        return replace(track, distance_m=_first_distance(distance_m, std_m), jitter=new)
    ours = filtered.surprise(distance_m, std_m)
    theirs = rival.surprise(distance_m, std_m) if rival else cfg.gate
    if ours <= min(theirs, cfg.gate):
        jitter = track.jitter.after(track.stamp_ns, filtered, distance_m, std_m) if track.jitter else new
        distance = filtered.update(distance_m, jitter.std_m(filtered, distance_m, std_m))
        return replace(track, distance_m=distance, rival_m=None, jitter=jitter)
    if rival is None or theirs > cfg.gate:
        return replace(track, rival_m=_first_distance(distance_m, std_m), rival_ns=track.stamp_ns)
    rival = rival.update(distance_m, std_m)
    if (track.stamp_ns - track.rival_ns) / NS_PER_S < cfg.restart_s:
        return replace(track, rival_m=rival)
    return replace(track, distance_m=rival, rival_m=None, jitter=new)


def _turning_mps2(distance_m: RateFilter, nearest_ray: Ray | None) -> float:
    """How fast the rate of a distance changes as what passes on a straight line is seen in another direction.

    It is the centrifugal term of polar coordinates: the square of the speed across the ray, over the distance.
    """
    if nearest_ray is None or distance_m.value <= 0:
        return 0.0
    x, y, z = nearest_ray
    return (distance_m.rate * hypot(x, y) / z) ** 2 / distance_m.value


def _first_distance(distance_m: float, std_m: float) -> RateFilter:
    return rate_filter.start(distance_m, std_m, _FIRST_SPEED_STD_MPS)


def _centre_std(side: float) -> float:
    """Standard deviation in pixels of the centre of a detected box."""
    return max(_SIDE_STD * side, _LEAST_STD_PX)


def _centre(box: Box) -> tuple[float, float]:
    return (box.x_min + box.x_max) / 2, (box.y_min + box.y_max) / 2


def _sides(box: Box) -> tuple[float, float]:
    return box.x_max - box.x_min, box.y_max - box.y_min


def _box(centre: tuple[float, float], sides: tuple[float, float]) -> Box:
    (x, y), (width, height) = centre, sides
    return Box(x - width / 2, y - height / 2, x + width / 2, y + height / 2)
