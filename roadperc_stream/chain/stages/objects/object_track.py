"""One object over time: its box in the image, its distance and its closing speed.

Three filters of a value and its rate estimate column and row of the box's centre, and the distance. The distance may
jump to something that passes in front of the object, so jumps are rejected. A distance beyond the gate starts a rival
filter, which replaces the filter of the distance when its own distances have been consistent for a while.
"""

from dataclasses import dataclass
from math import hypot, sqrt

from roadperc_stream.chain.stages.objects import rate_filter
from roadperc_stream.chain.stages.objects.growth import GROWTH_WALK, Growth
from roadperc_stream.chain.stages.objects.place import GroundPlace, Sighting, usual_speed_std_mps
from roadperc_stream.chain.stages.objects.rate_filter import EgoRate, Jitter, RateFilter, Ray, Rows
from roadperc_stream.chain.stages.objects.regions import UNKNOWN, Measured
from roadperc_stream.chain.stages.objects.template import Template
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera
from roadperc_stream.model import Box, Detection, Object
from roadperc_stream.model.changed import changed
from roadperc_stream.system.time import NS_PER_S

_FIRST_SPEED_STD_MPS = 20.0
_FIRST_DRIFT_STD_MPS = 3.0
"""Standard deviation of an unknown speed across the path."""
_UNKNOWN_PLACE_STD_M = 100.0
"""Standard deviation of an unknown place beside the path: so large that the next measurement replaces the place."""
_CURVATURE_STD_PER_M = 0.003
"""Standard deviation of the difference between two paths' curvatures, 1/m: far ahead their directions differ."""
_LATERAL_NOISE = 1.0
"""Standard deviation of the change of an edge's speed across the path within a second, m/s."""
_SIDE_STD = 0.03
"""Standard deviation of the centre of a detected box, in box sides."""
_LEAST_STD_PX = 0.5
_FIRST_DRIFT_STD = 2.0
"""Standard deviation of an unknown motion in the image, in box sides per second."""
_DRIFT_WALK = 2.0
"""Standard deviation of the change of that motion within a second."""
_UNKNOWN_STD_SHARE = 0.05
"""Standard deviation, as a share, of a distance without one: an object partly beyond the depth's range."""
_WALK_WITHOUT_DEPTH = 2.0
"""Factor of ``objects.process_noise`` without depth: then the braking of the car itself is not a known input."""
_MOST_ONE_SIDED = 6.0
"""``Jitter.one_sided`` beyond which the rate is wrong: 98.6 % of chi squared, 1 degree of freedom."""
_ZOOM = (0.5, 2.0)
"""Limits of the factor of a box's size in one prediction."""


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
    """A tracked object.

    ``box_px`` is its box at ``stamp_ns``, observed or predicted; ``x_px`` and ``y_px`` are the filters of its centre.
    It was last detected at ``detected_ns`` and last observed (detected or found by its template) at ``observed_ns``.
    It was observed in every frame from ``run_ns`` to ``observed_ns``; ``missed`` says whether a later frame did not
    show it. At ``agreed_ns``, the last distance updated ``distance_m``. ``rival_m`` is the filter of the distances
    beyond the gate since ``rival_ns``. ``right_m`` and ``left_m`` are the filters of its edges, metres to the left of
    the path's middle. ``ego_rate`` is the part of the distance's rate that the car's own motion causes, None if
    unknown. ``nearest_ray`` is the direction of its nearest pixels, ``jitter`` the jitter of its distances. ``growth``
    is the growth of its box in frames without depth, and ``ground_share`` the standard deviation that its ground
    distances share, as a share; None with depth. ``place`` is its place on the ground, None without depth or odometry.
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
    agreed_ns: int = 0
    rival_m: RateFilter | None = None
    rival_ns: int = 0
    template: Template | None = None
    right_m: RateFilter | None = None
    left_m: RateFilter | None = None
    ego_rate: EgoRate | None = None
    nearest_ray: Ray | None = None
    jitter: Jitter | None = None
    growth: Growth | None = None
    ground_share: float | None = None
    place: GroundPlace | None = None


def start(cfg: ObjectsConfig, number: int, item: Object, box_px: Box, stamp_ns: int) -> ObjectTrack:
    """A new track of a detected object; ``box_px`` is its box within the image."""
    (x, y), (width, height) = _centre(box_px), _sides(box_px)
    x_px = rate_filter.start(x, _centre_std(width), _FIRST_DRIFT_STD * width)
    y_px = rate_filter.start(y, _centre_std(height), _FIRST_DRIFT_STD * height)
    track = ObjectTrack(number, item.detection, box_px, x_px, y_px, None, stamp_ns, stamp_ns, stamp_ns, stamp_ns)
    return _with_distance(cfg, track, item, cut=False)


def predict(cfg: ObjectsConfig, track: ObjectTrack, stamp_ns: int, now_T_last: Rows | None = None) -> ObjectTrack:
    """The track at a later stamp: the box moves at the rate of its centre and grows as the distance shrinks.

    Args:
        cfg: process noise of the distance.
        track: the track at an earlier stamp.
        stamp_ns: the later stamp.
        now_T_last: (4, 4) motion of the camera between both stamps, row by row, None if unknown.
    """
    dt_s = (stamp_ns - track.stamp_ns) / NS_PER_S
    width, height = _sides(track.box_px)
    x_px = track.x_px.predict(_DRIFT_WALK * width, dt_s)
    y_px = track.y_px.predict(_DRIFT_WALK * height, dt_s)
    walk_mps = cfg.process_noise if track.ground_share is None else _WALK_WITHOUT_DEPTH * cfg.process_noise
    ego_rate = _ego_rate(track, now_T_last, dt_s)
    track = track if ego_rate is None else _with_usual_speed(track, ego_rate.mean_mps)
    distance_m, rival_m = (m.predict(walk_mps, dt_s) if m else None for m in (track.distance_m, track.rival_m))
    right_m, left_m = (m.predict(_LATERAL_NOISE, dt_s) if m else None for m in (track.right_m, track.left_m))
    if ego_rate is not None and track.ego_rate is not None:
        change_m = (ego_rate.mean_mps - track.ego_rate.end_mps) * dt_s
        change_mps = ego_rate.end_mps - track.ego_rate.end_mps
        distance_m, rival_m = (m.shifted(change_m, change_mps) if m else None for m in (distance_m, rival_m))
    place = None if track.place is None or now_T_last is None else track.place.predict(now_T_last, dt_s)
    if place is not None and track.place is not None:
        # The direction to an object that crosses turns, and with it the part of its speed that changes the distance.
        turn_mps = place.receding_mps - track.place.receding_mps
        distance_m, rival_m = (m.shifted(turn_mps * dt_s / 2, turn_mps) if m else None for m in (distance_m, rival_m))
    scale = zoom(track.distance_m.value if track.distance_m else None, distance_m)
    box_px = _box((x_px.value, y_px.value), (width * scale, height * scale))
    return changed(
        track,
        box_px=box_px,
        x_px=x_px,
        y_px=y_px,
        distance_m=distance_m,
        rival_m=rival_m,
        right_m=right_m,
        left_m=left_m,
        ego_rate=ego_rate,
        growth=_grown(track, walk_mps, dt_s),
        place=place,
        stamp_ns=stamp_ns,
        missed=track.observed_ns != track.stamp_ns,
    )


def _grown(track: ObjectTrack, walk_mps: float, dt_s: float) -> Growth | None:
    """The predicted growth; the same change of speed changes the growth of a near object more."""
    if track.growth is None:
        return None
    distance = track.distance_m
    if distance is None or distance.value <= 0:
        return track.growth.predict(GROWTH_WALK, dt_s)
    return track.growth.predict(walk_mps / distance.value, dt_s)


def _ego_rate(track: ObjectTrack, now_T_last: Rows | None, dt_s: float) -> EgoRate | None:
    """Rate of the distance that a stationary object would have; None if unknown."""
    if now_T_last is None or track.distance_m is None or track.nearest_ray is None or dt_s <= 0:
        return None
    change_m = rate_filter.change_of_distance_m(now_T_last, track.nearest_ray, max(track.distance_m.value, 0.0))
    return EgoRate.after(change_m, dt_s, track.ego_rate)


def _with_usual_speed(track: ObjectTrack, ego_mps: float) -> ObjectTrack:
    """The track with the rate of a standing object, as uncertain as its kind's speed, if it has only one distance."""
    distance = track.distance_m
    if distance is None or track.jitter is None or track.jitter.earlier_ns is not None or track.ego_rate is not None:
        return track
    if track.jitter.last_ns != track.stamp_ns:
        return track
    std_mps = usual_speed_std_mps(track.detection.label)
    return changed(
        track, distance_m=rate_filter.start(distance.value, sqrt(distance.value_var), std_mps).shifted(0.0, ego_mps)
    )


def zoom(before_m: float | None, after_m: RateFilter | None) -> float:
    """Factor of an object's size in the image between two distances; 1 if a distance is unknown."""
    if before_m is None or after_m is None:
        return 1.0
    least, most = _ZOOM
    return min(max(before_m / after_m.value, least), most) if after_m.value > 0 else most


def detected(cfg: ObjectsConfig, track: ObjectTrack, item: Object, box_px: Box, *, cut: bool = False) -> ObjectTrack:
    """The predicted track after its detection; ``cut`` if the image's border cuts the object."""
    track = changed(track, detection=item.detection, detected_ns=track.stamp_ns)
    return observed(cfg, track, item, box_px, cut=cut)


def observed(cfg: ObjectsConfig, track: ObjectTrack, item: Object, box_px: Box, *, cut: bool = False) -> ObjectTrack:
    """The predicted track after its object was observed, by a detection or by its template."""
    (x, y), (width, height) = _centre(box_px), _sides(box_px)
    track = _with_distance(cfg, track, item, cut=cut)
    return changed(
        track,
        box_px=box_px,
        x_px=track.x_px.update(x, _centre_std(width)),
        y_px=track.y_px.update(y, _centre_std(height)),
        observed_ns=track.stamp_ns,
        run_ns=track.stamp_ns if track.missed else track.run_ns,
    )


def placed(track: ObjectTrack, extent: Extent | None, template: Template | None) -> ObjectTrack:
    """The track with a template, and with its edges updated by ``extent``, if that is known."""
    if extent is None:
        return track if template is track.template else changed(track, template=template)
    if track.right_m is None or track.left_m is None:
        edges = (rate_filter.start(m, extent.std_m, _FIRST_DRIFT_STD_MPS) for m in (extent.right_m, extent.left_m))
        right_m, left_m = edges
    else:
        right_m = track.right_m.update(extent.right_m, extent.std_m)
        left_m = track.left_m.update(extent.left_m, extent.std_m)
    return changed(track, right_m=right_m, left_m=left_m, nearest_ray=extent.nearest_ray, template=template)


def beside_another_path(track: ObjectTrack) -> ObjectTrack:
    """The predicted track after a change of path: its lateral places are unknown.

    Its lateral speeds keep their values, with a deviation that grows with distance and closing speed.
    """
    distance = track.distance_m
    std_mps = _FIRST_DRIFT_STD_MPS if distance is None else _CURVATURE_STD_PER_M * abs(distance.value * distance.rate)
    right_m, left_m = (m and _beside_another_path(m, std_mps) for m in (track.right_m, track.left_m))
    return changed(track, right_m=right_m, left_m=left_m)


def _beside_another_path(edge: RateFilter, std_mps: float) -> RateFilter:
    return edge.at(edge.value, _UNKNOWN_PLACE_STD_M, sqrt(max(std_mps**2 - edge.rate_var, 0.0)))


def seen_at(track: ObjectTrack, seen: Sighting | None) -> ObjectTrack:
    """The track after its object was seen at a place on the ground, if that is known."""
    if seen is None:
        return track
    place = track.place.update(seen) if track.place else GroundPlace.of_first(seen, track.detection.label)
    return changed(track, place=place)


def aimed(track: ObjectTrack, camera: Camera) -> ObjectTrack:
    """The predicted track with its box where its place on the ground appears in the image, if that is known.

    In the image, a near object moves at other speeds from frame to frame; on the ground it moves steadily.
    """
    if track.place is None or track.place.ahead_m.value <= 0:
        return track
    ahead_m, sides = track.place.ahead_m.value, _sides(track.box_px)
    x = camera.cx + 0.5 + camera.fx * track.place.right_m.value / ahead_m
    y = camera.cy + 0.5 + camera.fy * track.place.down_m / ahead_m
    x_std = camera.fx * sqrt(track.place.right_m.value_var) / ahead_m
    x_px, y_px = (rate_filter.start(*values, 0.0) for values in ((x, x_std), (y, _centre_std(sides[1]))))
    return changed(track, box_px=_box((x, y), sides), x_px=x_px, y_px=y_px)


def grown(cfg: ObjectsConfig, track: ObjectTrack, edge_std_px: tuple[float, float]) -> ObjectTrack:
    """The track after its whole box was seen; with the deviations of the box's vertical and horizontal edges."""
    box, stamp_ns = track.box_px, track.stamp_ns
    after = track.growth.after(stamp_ns, box, edge_std_px, cfg.gate) if track.growth else None
    return changed(track, growth=after or Growth.of_first(stamp_ns, box, edge_std_px))


def with_depth(track: ObjectTrack) -> ObjectTrack:
    """The track for a frame with depth: without what only frames without depth need."""
    return track if track.ground_share is None else changed(track, growth=None, ground_share=None)


def expired(cfg: ObjectsConfig, track: ObjectTrack) -> bool:
    """Whether the last detection is older than ``objects.hold_s``."""
    return (track.stamp_ns - track.detected_ns) / NS_PER_S > cfg.hold_s


def confirmed(cfg: ObjectsConfig, track: ObjectTrack) -> bool:
    """Whether the object was observed without a gap for ``objects.carry_after_s``."""
    return (track.observed_ns - track.run_ns) / NS_PER_S >= cfg.carry_after_s


def expected(cfg: ObjectsConfig, track: ObjectTrack) -> Measured:
    """The predicted distance of a track; unknown if observations have not agreed with it for ``objects.restart_s``."""
    distance = track.distance_m
    unconfirmed_s = (track.stamp_ns - track.agreed_ns) / NS_PER_S if track.agreed_ns < track.observed_ns else 0.0
    if distance is None or unconfirmed_s > cfg.restart_s:
        return UNKNOWN
    return Measured(distance.value, sqrt(distance.value_var))


def agrees(cfg: ObjectsConfig, track: ObjectTrack, item: Object) -> bool:
    """Whether an object has the predicted distance of a track."""
    if track.distance_m is None or item.distance_m is None:
        return False
    return track.distance_m.surprise(item.distance_m, distance_std_m(cfg, item)) < cfg.gate


def distance_std_m(cfg: ObjectsConfig, item: Object) -> float:
    """Standard deviation in metres of a measured distance."""
    if item.distance_std_m is not None:
        return item.distance_std_m
    return max(_UNKNOWN_STD_SHARE * (item.distance_m or 0.0), cfg.min_distance_std_m)


def _with_distance(cfg: ObjectsConfig, track: ObjectTrack, item: Object, *, cut: bool) -> ObjectTrack:
    """The track after the distance of its object, if that is known."""
    if item.distance_m is None:
        return track
    std_m = distance_std_m(cfg, item)
    if not cut or track.distance_m is None:
        return _measured(cfg, track, item.distance_m, std_m)
    # In each frame, another point of a cut object is the nearest one, so distances do not show its speed.
    dt_s = (track.stamp_ns - track.observed_ns) / NS_PER_S
    change_mps = _turning_mps2(track.distance_m, track.nearest_ray) * dt_s
    distance = track.distance_m.at(item.distance_m, std_m, change_mps)
    return changed(track, distance_m=distance, rival_m=None, agreed_ns=track.stamp_ns)


def _measured(cfg: ObjectsConfig, track: ObjectTrack, distance_m: float, std_m: float) -> ObjectTrack:
    """The track after a distance, which updates the filter, the rival or a new rival, whichever fits."""
    filtered, rival, stamp_ns = track.distance_m, track.rival_m, track.stamp_ns
    new = Jitter.of_first(stamp_ns, distance_m, std_m)
    if filtered is None:
        return changed(track, distance_m=_first_distance(distance_m, std_m), jitter=new, agreed_ns=stamp_ns)
    ours = filtered.surprise(distance_m, std_m)
    theirs = rival.surprise(distance_m, std_m) if rival else cfg.gate
    if ours <= min(theirs, cfg.gate):
        jitter = track.jitter.after(track.stamp_ns, filtered, distance_m, std_m) if track.jitter else new
        used_std_m = jitter.std(filtered, distance_m, std_m)
        if jitter.one_sided > _MOST_ONE_SIDED:
            filtered, jitter = filtered.doubted(jitter.one_sided), jitter.renewed()
        distance = filtered.update(distance_m, used_std_m)
        return changed(track, distance_m=distance, rival_m=None, jitter=jitter, agreed_ns=stamp_ns)
    if rival is None or theirs > cfg.gate:
        return changed(track, rival_m=_first_distance(distance_m, std_m), rival_ns=track.stamp_ns)
    rival = rival.update(distance_m, std_m)
    if (track.stamp_ns - track.rival_ns) / NS_PER_S < cfg.restart_s:
        return changed(track, rival_m=rival)
    return changed(track, distance_m=rival, rival_m=None, jitter=new, agreed_ns=stamp_ns)


def _turning_mps2(distance_m: RateFilter, nearest_ray: Ray | None) -> float:
    """Change of a distance's rate per second for a straight motion past the camera, m/s2.

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
