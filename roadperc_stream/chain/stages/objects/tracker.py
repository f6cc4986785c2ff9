"""One frame of the objects: filter the detections, associate them with tracks, and search for tracks without one.

Detections and tracks are paired for the largest total similarity (the assignment problem). The similarity is the
overlap of the boxes, reduced if the distances contradict each other. So an object keeps its id if its distance jumps to
another object in front, and two objects that pass each other keep their ids.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects import contact, tracking
from roadperc_stream.chain.stages.objects.contact import BORDER_PX, Contact, GroundPlane
from roadperc_stream.chain.stages.objects.filtering import filter_detections
from roadperc_stream.chain.stages.objects.mosaic import corners, kinds, overlaps
from roadperc_stream.chain.stages.objects.path import DrivenArc, EgoPath, extent, judged, path_of
from roadperc_stream.chain.stages.objects.template import Template, cut, find_obstacle
from roadperc_stream.chain.stages.objects.tracking import ObjectTrack, distance_std_m
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera, Float, inverse
from roadperc_stream.geometry.assignment import largest_total
from roadperc_stream.model import Absent, Box, Correlation, Detection, Lanes, Object, Objects
from roadperc_stream.model.scene import Scene

MOST_TRACKS = 256
"""Largest number of tracks; beyond it, the tracks longest without a detection are dropped."""
EXPECTED_OVERLAP = 0.4
"""Least intersection over union of a detection and the predicted box of its object."""
DISTANCE_PENALTY = 0.3
"""Share of the overlap that is subtracted if the distances contradict each other."""
_SEARCH_SIGMAS = 3.0
_SEARCH_SIDES = 1.0
"""Largest search distance to each side of the predicted centre, in box sides."""


@dataclass(frozen=True)
class ObjectsState:
    """The tracks of the last frame, and the number of the next new one.

    ``path`` is the last frame's path, from which the tracks' edges are measured. ``arc`` is the driven curve.
    """

    tracks: tuple[ObjectTrack, ...] = ()
    next_number: int = 1
    path: EgoPath = field(default_factory=lambda: EgoPath("straight"))
    arc: DrivenArc = field(default_factory=DrivenArc)


@dataclass(frozen=True)
class _Kept:
    """Kept detections, independent of the detector's order: objects, boxes in the image, positions."""

    items: tuple[Object, ...]
    boxes: tuple[Box, ...]
    positions: tuple[int, ...]


@dataclass(frozen=True)
class _Searched:
    """A track without a detection, the object where its template was found, and the correlation of that search."""

    track: ObjectTrack
    item: Object | None = None
    correlation: Correlation | None = None


def step(
    cfg: ObjectsConfig,
    state: ObjectsState,
    scene: Scene,
    ego_lane: Lanes | None = None,
    last_T_this: Float | None = None,
    ground: GroundPlane | None = None,
) -> tuple[ObjectsState, Objects | Absent]:
    """Filter a frame's detections and track the kept ones over time.

    Args:
        cfg: thresholds.
        state: the state after the last frame.
        scene: a later frame. Without tags every detection is kept; without a grey image, tracks without a detection
            are not searched for.
        ego_lane: the lane of the car, None if unknown.
        last_T_this: (4, 4) metric motion since the last frame, ego frame; None if unknown.
        ground: the road, which gives the distances without depth; None with depth.

    Returns:
        The new state, and the objects. First come all detections in the detector's order; kept ones have a track id,
        a place beside the path, closing speed and time to impact. Then come objects found only by their template, with
        status ``tracked``, the oldest first. The obstacle of ``objects.template_png`` is last. Distances are measured
        in this frame; place, speed and time to impact come from the filters. The objects are absent without a
        detections message, unless a template was found.
    """
    arc = state.arc.after(last_T_this)
    path = path_of(ego_lane, arc)
    known = _known(cfg, state, scene, path, last_T_this, with_depth=ground is None)
    filtered = filter_detections(cfg, scene, scene.detections, _expected(cfg, scene, known))
    own = () if isinstance(filtered, Absent) else filtered.objects
    contacts = {} if ground is None else contact.contacts(scene.camera, ground, own)
    own = contact.with_distances(scene.camera, own, contacts)
    kept = _kept(scene.camera, own)
    pairs = largest_total(similarities(cfg, known, kept.items, kept.boxes))
    detected = {
        k: _placed(cfg, scene, path, own[k], track, contacts.get(k))
        for k, track in _detected(cfg, state.next_number, scene, known, kept, pairs).items()
    }
    missed = [track for k, track in enumerate(known) if k not in pairs]
    searched = [_searched(cfg, scene, path, track, kept) for track in missed]
    found = tuple(judged(cfg, path, s.item, s.track) for s in searched if s.item is not None)
    tracks = _remembered([*detected.values(), *(s.track for s in searched)])
    after = ObjectsState(tracks, state.next_number + len(kept.items) - len(pairs), path, arc)
    obstacle, correlation = find_obstacle(cfg, scene)
    found += () if obstacle is None else (obstacle,)
    if isinstance(filtered, Absent) and not found:
        return after, filtered
    tracked = tuple(judged(cfg, path, item, detected[k]) if k in detected else item for k, item in enumerate(own))
    correlations = tuple(c for c in (*(s.correlation for s in searched), correlation) if c is not None)
    return after, Objects(tracked + found, correlations, path.source)


def _known(
    cfg: ObjectsConfig,
    state: ObjectsState,
    scene: Scene,
    path: EgoPath,
    last_T_this: Float | None,
    *,
    with_depth: bool,
) -> list[ObjectTrack]:
    """The tracks predicted to this frame. Without depth the motion's scale is too uncertain for the filters."""
    now_T_last = None
    if last_T_this is not None and with_depth:
        now_T_last = inverse(last_T_this @ scene.ego_T_camera) @ scene.ego_T_camera
    last = [tracking.with_depth(track) for track in state.tracks] if with_depth else state.tracks
    known = [tracking.predict(cfg, track, scene.stamp_ns, now_T_last) for track in last]
    known = [track for track in known if not tracking.expired(cfg, track)]
    return known if path.goes_on(state.path) else [replace(track, right_m=None, left_m=None) for track in known]


def _expected(cfg: ObjectsConfig, scene: Scene, known: Sequence[ObjectTrack]) -> dict[int, float | None]:
    """The positions of detections at a predicted object of their kind, with the predicted distance, None if unknown.

    Only confirmed tracks count. Among several objects, the one with the largest overlap counts.
    """
    tracks = [track for track in known if tracking.confirmed(cfg, track)]
    detections = scene.detections
    if not tracks or not detections:
        return {}
    ours, theirs = kinds([track.detection.label for track in tracks], [d.label for d in detections])
    with np.errstate(all="ignore"):
        boxes = corners(_within(scene.camera, d.box_px) for d in detections)
        overlap = overlaps(corners(track.box_px for track in tracks), boxes)
    overlap = np.where((overlap >= EXPECTED_OVERLAP) & (ours[:, None] == theirs), overlap, 0.0)
    best = overlap.argmax(axis=0)
    distances = [None if track.distance_m is None else track.distance_m.value for track in tracks]
    return {k: distances[best[k]] for k in np.flatnonzero(overlap.max(axis=0)).tolist()}


def similarities(
    cfg: ObjectsConfig, tracks: Sequence[ObjectTrack], items: Sequence[Object], boxes: Sequence[Box]
) -> Float:
    """(tracks, items) 0 to 1: how well each detection fits each predicted track; 0 where it cannot be the same object.

    The similarity is the overlap, reduced by up to ``DISTANCE_PENALTY`` as the distances contradict each other. All
    pairs are computed at once, because a detector may report thousands of boxes.
    """
    ours, theirs = kinds([track.detection.label for track in tracks], [item.detection.label for item in items])
    with np.errstate(all="ignore"):  # coordinates may overflow; NaN becomes 0
        overlap = overlaps(corners(track.box_px for track in tracks), corners(boxes))
        scores = overlap * (1.0 - DISTANCE_PENALTY * _contradictions(cfg, tracks, items))
        fits = (ours[:, None] == theirs) & (scores >= cfg.min_overlap)
    return np.where(fits, scores, 0.0)


def _contradictions(cfg: ObjectsConfig, tracks: Sequence[ObjectTrack], items: Sequence[Object]) -> Float:
    """(tracks, items) 0 if the distances agree or one is unknown, 1 at the gate and beyond."""
    motions = [track.distance_m for track in tracks]
    expected = np.array([np.nan if m is None else m.value for m in motions])[:, None]
    variances = np.array([np.nan if m is None else m.value_var for m in motions])[:, None]
    measured = np.array([np.nan if item.distance_m is None else item.distance_m for item in items])
    # As in RateFilter.surprise; float_power rounds like Python's **, a product does not always.
    noise = np.float_power(np.array([distance_std_m(cfg, item) for item in items]), 2.0)
    surprise = np.float_power(measured - expected, 2.0) / (variances + noise)
    unknown: NDArray[np.bool_] = np.isnan(expected) | np.isnan(measured)
    return np.where(unknown, 0.0, np.minimum(surprise / cfg.gate, 1.0))


def _kept(camera: Camera, objects: Sequence[Object]) -> _Kept:
    """The kept objects by decreasing score, so that the order of the detections has no effect."""
    found = [(item, _within(camera, item.detection.box_px), k) for k, item in enumerate(objects) if item.kept]
    found.sort(key=lambda entry: _order(entry[0].detection))
    return _Kept(tuple(item for item, _, _ in found), tuple(b for _, b, _ in found), tuple(k for _, _, k in found))


def _within(camera: Camera, box: Box) -> Box:
    """The part of a box that is in the image."""
    x, y = float(camera.width), float(camera.height)
    return Box(
        min(max(box.x_min, 0.0), x),
        min(max(box.y_min, 0.0), y),
        min(max(box.x_max, 0.0), x),
        min(max(box.y_max, 0.0), y),
    )


def _order(detection: Detection) -> tuple[float | str, ...]:
    box = detection.box_px
    return -detection.score, box.x_min, box.y_min, box.x_max, box.y_max, detection.label, detection.id


def _detected(
    cfg: ObjectsConfig,
    next_number: int,
    scene: Scene,
    known: Sequence[ObjectTrack],
    kept: _Kept,
    pairs: dict[int, int],
) -> dict[int, ObjectTrack]:
    """The tracks after this frame's detections, old and new, by the detection's position."""
    track_of = {item: track for track, item in pairs.items()}
    tracks: dict[int, ObjectTrack] = {}
    for k, (item, box, position) in enumerate(zip(kept.items, kept.boxes, kept.positions, strict=True)):
        if k in track_of:
            # The object continues beyond one side of the image.
            cut = (box.x_min < BORDER_PX) != (box.x_max > scene.camera.width - BORDER_PX)
            track = tracking.detected(cfg, known[track_of[k]], item, box, cut=cut)
        else:
            track = tracking.start(cfg, next_number, item, box, scene.stamp_ns)
            next_number += 1
        tracks[position] = track
    return tracks


def _placed(
    cfg: ObjectsConfig, scene: Scene, path: EgoPath, item: Object, track: ObjectTrack, at: Contact | None
) -> ObjectTrack:
    """The track after its object's edges, its template and, at a ground contact, the growth of its box."""
    template = _template(cfg, scene, track)
    if at is None:
        return tracking.placed(track, extent(scene, path, item), template)
    track = tracking.placed(track, contact.extent(scene, path, item, at), template)
    track, box = replace(track, ground_share=at.common_share), track.box_px
    edge_std_px = contact.edge_std_px(box.x_max - box.x_min), contact.edge_std_px(box.y_max - box.y_min)
    return tracking.grown(cfg, track, edge_std_px) if at.clear else track


def _template(cfg: ObjectsConfig, scene: Scene, track: ObjectTrack) -> Template | None:
    """The track's template from this frame; without an image, the last one is kept."""
    if scene.grey is None or not cfg.template_search:
        return track.template
    distance_m = track.distance_m.value if track.distance_m else None
    return cut(scene.grey, track.box_px, distance_m)


def _searched(cfg: ObjectsConfig, scene: Scene, path: EgoPath, track: ObjectTrack, kept: _Kept) -> _Searched:
    """The track and its object where its template matches, filtered as detections are; no object if it does not match.

    A match is dropped if it overlaps a kept detection, or if the tags contradict it.
    """
    searchable = cfg.template_search and tracking.confirmed(cfg, track)
    if track.template is None or scene.grey is None or not searchable:
        return _Searched(track)
    scale = tracking.zoom(track.template.distance_m, track.distance_m)
    correlation = track.template.search(scene.grey, _around(track), scale)
    found = None if correlation is None else correlation.match(cfg.template_min_score)
    lost = _Searched(track, None, correlation)
    if found is None:
        return lost
    box_px = _within(scene.camera, track.template.whole(found[0], scale))
    expected_m = None if track.distance_m is None else track.distance_m.value
    filtered = filter_detections(cfg, scene, (replace(track.detection, box_px=box_px),), {0: expected_m})
    if isinstance(filtered, Absent) or not filtered.objects[0].kept:
        return lost
    item = replace(filtered.objects[0], status="tracked")
    after = tracking.observed(cfg, track, item, item.detection.box_px)
    if similarities(cfg, [after], kept.items, kept.boxes).any():
        return lost
    return _Searched(tracking.placed(after, extent(scene, path, item), after.template), item, correlation)


def _around(track: ObjectTrack) -> Box:
    """The search area for the object's centre, around the predicted centre."""
    width, height = track.box_px.x_max - track.box_px.x_min, track.box_px.y_max - track.box_px.y_min
    x, y = track.x_px.value, track.y_px.value
    aside = min(_SEARCH_SIGMAS * sqrt(track.x_px.value_var), _SEARCH_SIDES * width) + 1.0
    above = min(_SEARCH_SIGMAS * sqrt(track.y_px.value_var), _SEARCH_SIDES * height) + 1.0
    return Box(x - aside, y - above, x + aside, y + above)


def _remembered(tracks: Sequence[ObjectTrack]) -> tuple[ObjectTrack, ...]:
    """At most ``MOST_TRACKS`` tracks, the oldest first."""
    latest = sorted(tracks, key=lambda track: (-track.detected_ns, track.number))[:MOST_TRACKS]
    return tuple(sorted(latest, key=lambda track: track.number))
