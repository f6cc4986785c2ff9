"""One frame of the objects: filter the detections, associate them with tracks, and search for tracks without one.

Detections and tracks are paired for the largest total similarity (the assignment problem): of the places on the ground
and of the boxes. So an object keeps its id if its distance jumps to another object in front, and two objects that pass
each other keep their ids.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import sqrt

import numpy as np

from roadperc_stream.chain.stages.objects import contact, object_track
from roadperc_stream.chain.stages.objects.association import overlap_similarities, similarities
from roadperc_stream.chain.stages.objects.contact import Contact, GroundPlane
from roadperc_stream.chain.stages.objects.filtering import divides, filter_detections
from roadperc_stream.chain.stages.objects.mosaic import corners, kinds, overlaps
from roadperc_stream.chain.stages.objects.object_track import Extent, ObjectTrack, distance_std_m
from roadperc_stream.chain.stages.objects.path import DrivenArc, EgoPath, extents, judged, path_of
from roadperc_stream.chain.stages.objects.place import Sighting, sighting
from roadperc_stream.chain.stages.objects.regions import Measured
from roadperc_stream.chain.stages.objects.template import Template, cut, find_obstacle
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera, Float, inverse
from roadperc_stream.geometry.assignment import largest_total
from roadperc_stream.model import Absent, Box, Correlation, Detection, Lanes, Object, Objects
from roadperc_stream.model.changed import changed
from roadperc_stream.model.frame import Frame

MOST_TRACKS = 256
"""Largest number of tracks; beyond it, the tracks longest without a detection are dropped."""
EXPECTED_OVERLAP = 0.4
"""Least intersection over union of a detection and the predicted box of its object."""
_EDGE_SIGMAS = 3.0
"""A box whose edge is this near to the image's border, in deviations of the edge, counts as cut by it."""
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
    """Kept detections, independent of the detector's order: objects, boxes in the image, positions.

    ``seen`` is where each is seen, None without depth.
    """

    items: tuple[Object, ...]
    boxes: tuple[Box, ...]
    positions: tuple[int, ...]
    seen: tuple[Sighting | None, ...]


@dataclass(frozen=True)
class _Searched:
    """A track without a detection, the object where its template was found, and the correlation of that search."""

    track: ObjectTrack
    item: Object | None = None
    correlation: Correlation | None = None


def step(
    cfg: ObjectsConfig,
    state: ObjectsState,
    frame: Frame,
    ego_lane: Lanes | None = None,
    last_T_this: Float | None = None,
    ground: GroundPlane | None = None,
) -> tuple[ObjectsState, Objects | Absent]:
    """Filter a frame's detections and track the kept ones over time.

    Args:
        cfg: thresholds.
        state: the state after the last frame.
        frame: a later frame. Without tags every detection is kept; without a grey image, tracks without a detection
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
    known = _known(cfg, state, frame, path, last_T_this, with_depth=ground is None)
    filtered = filter_detections(cfg, frame, frame.detections, _expected(cfg, frame, known))
    own = () if isinstance(filtered, Absent) else filtered.objects
    contacts = {} if ground is None else contact.contacts(frame, ground, own)
    own = contact.with_distances(frame.camera, own, contacts)
    kept = _kept(cfg, frame, own)
    pairs = largest_total(similarities(cfg, known, kept.items, kept.boxes, kept.seen))
    tracks_of = _detected(cfg, state.next_number, frame, known, kept, pairs)
    edges = (
        [contact.extent(frame, path, own[k], contacts[k]) if k in contacts else None for k in tracks_of]
        if contacts
        else extents(frame, path, [own[k] for k in tracks_of])
    )
    detected = {
        k: _placed(cfg, frame, track, edge, contacts.get(k), seen)
        for (k, track), edge, seen in zip(tracks_of.items(), edges, kept.seen, strict=True)
    }
    missed = [object_track.aimed(track, frame.camera) for k, track in enumerate(known) if k not in pairs]
    searched = _searched(cfg, frame, path, missed, kept)
    found = tuple(judged(cfg, frame, path, s.item, s.track) for s in searched if s.item is not None)
    tracks = _remembered([*detected.values(), *(s.track for s in searched)])
    after = ObjectsState(tracks, state.next_number + len(kept.items) - len(pairs), path, arc)
    obstacle, correlation = find_obstacle(cfg, frame)
    found += () if obstacle is None else (obstacle,)
    if isinstance(filtered, Absent) and not found:
        return after, filtered
    tracked = tuple(
        judged(cfg, frame, path, item, detected[k]) if k in detected else item for k, item in enumerate(own)
    )
    correlations = tuple(c for c in (*(s.correlation for s in searched), correlation) if c is not None)
    return after, Objects(tracked + found, correlations, path.source)


def _known(
    cfg: ObjectsConfig,
    state: ObjectsState,
    frame: Frame,
    path: EgoPath,
    last_T_this: Float | None,
    *,
    with_depth: bool,
) -> list[ObjectTrack]:
    """The tracks predicted to this frame. Without depth the motion's scale is too uncertain for the filters."""
    now_T_last = None
    if last_T_this is not None and with_depth:
        now_T_last = (inverse(last_T_this @ frame.ego_T_camera) @ frame.ego_T_camera).tolist()
    last = [object_track.with_depth(track) for track in state.tracks] if with_depth else state.tracks
    known = [object_track.predict(cfg, track, frame.stamp_ns, now_T_last) for track in last]
    known = [track for track in known if not object_track.expired(cfg, track)]
    return known if path.goes_on(state.path) else [object_track.beside_another_path(track) for track in known]


def _expected(cfg: ObjectsConfig, frame: Frame, known: Sequence[ObjectTrack]) -> dict[int, Measured]:
    """The positions of detections at a predicted object of their kind, with the predicted distance.

    Only confirmed tracks count. Among several objects, the one with the largest overlap counts.
    """
    tracks = [track for track in known if object_track.confirmed(cfg, track)]
    detections = frame.detections
    if not tracks or not detections:
        return {}
    ours, theirs = kinds([track.detection.label for track in tracks], [d.label for d in detections])
    with np.errstate(all="ignore"):
        boxes = corners(_within(frame.camera, d.box_px) for d in detections)
        overlap = overlaps(corners(track.box_px for track in tracks), boxes)
    overlap = np.where((overlap >= EXPECTED_OVERLAP) & (ours[:, None] == theirs), overlap, 0.0)
    best = overlap.argmax(axis=0)
    distances = [object_track.expected(cfg, track) for track in tracks]
    return {k: distances[best[k]] for k in np.flatnonzero(overlap.max(axis=0)).tolist()}


def _kept(cfg: ObjectsConfig, frame: Frame, objects: Sequence[Object]) -> _Kept:
    """The kept objects by decreasing score, so that the order of the detections has no effect."""
    positions = sorted(
        (k for k, item in enumerate(objects) if item.kept), key=lambda k: (*_order(objects[k].detection), k)
    )
    items = tuple(objects[k] for k in positions)
    boxes = tuple(_within(frame.camera, item.detection.box_px) for item in items)
    seen = tuple(_sighting(cfg, frame, item, box) for item, box in zip(items, boxes, strict=True))
    return _Kept(items, boxes, tuple(positions), seen)


def _sighting(cfg: ObjectsConfig, frame: Frame, item: Object, box: Box) -> Sighting | None:
    """Where an object is seen; None without depth."""
    if item.distance_m is None or frame.raw_depth_m is None:
        return None
    return sighting(frame.camera, box, item.distance_m, distance_std_m(cfg, item))


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
    frame: Frame,
    known: Sequence[ObjectTrack],
    kept: _Kept,
    pairs: dict[int, int],
) -> dict[int, ObjectTrack]:
    """The tracks after this frame's detections, old and new, by the detection's position."""
    track_of = {item: track for track, item in pairs.items()}
    tracks: dict[int, ObjectTrack] = {}
    for k, (item, box, position) in enumerate(zip(kept.items, kept.boxes, kept.positions, strict=True)):
        if k in track_of:
            track = object_track.detected(cfg, known[track_of[k]], item, box, cut=_is_cut(frame.camera, box))
        else:
            track = object_track.start(cfg, next_number, item, box, frame.stamp_ns)
            next_number += 1
        tracks[position] = track
    return tracks


def _is_cut(camera: Camera, box: Box) -> bool:
    """Whether an object continues beyond one side of the image; the deviation of its edge hides that."""
    edge_px = _EDGE_SIGMAS * contact.edge_std_px(box.x_max - box.x_min)
    return (box.x_min < edge_px) != (box.x_max > camera.width - edge_px)


def _placed(
    cfg: ObjectsConfig,
    frame: Frame,
    track: ObjectTrack,
    edges: Extent | None,
    at: Contact | None,
    seen: Sighting | None,
) -> ObjectTrack:
    """The track after its object's edges, its template and, at a ground contact, the growth of its box."""
    track = object_track.placed(track, edges, _template(cfg, frame, track))
    if at is None:
        return object_track.seen_at(track, seen)
    track, box = changed(track, ground_share=at.common_share), track.box_px
    edge_std_px = contact.edge_std_px(box.x_max - box.x_min), contact.edge_std_px(box.y_max - box.y_min)
    return object_track.grown(cfg, track, edge_std_px) if at.clear else track


def _template(cfg: ObjectsConfig, frame: Frame, track: ObjectTrack) -> Template | None:
    """The track's template from this frame; without an image, the last one is kept."""
    if frame.grey is None or not cfg.template_search:
        return track.template
    distance_m = track.distance_m.value if track.distance_m else None
    return cut(frame.grey, track.box_px, distance_m)


def _searched(
    cfg: ObjectsConfig, frame: Frame, path: EgoPath, tracks: Sequence[ObjectTrack], kept: _Kept
) -> list[_Searched]:
    """The tracks, with objects where their templates match, or where their own pixels are at their predicted places.

    The objects are filtered as detections are. Tags or depth may contradict one; without a match of the template, its
    distance must be the predicted one. An object that overlaps a kept detection is dropped.
    """
    matches = [_matched(cfg, frame, track) for track in tracks]
    boxes = [_sought(cfg, frame, track, matched) for track, (matched, _) in zip(tracks, matches, strict=True)]
    sought = {k: box for k, box in enumerate(boxes) if box is not None}
    detections = tuple(changed(tracks[k].detection, box_px=box) for k, box in sought.items())
    expected = {k: object_track.expected(cfg, tracks[of_track]) for k, of_track in enumerate(sought)}
    filtered = filter_detections(cfg, frame, detections, expected) if detections else None
    found: dict[int, tuple[Object, ObjectTrack]] = {}
    items = filtered.objects if isinstance(filtered, Objects) else ()
    for (k, box), item in zip(sought.items(), items, strict=True):
        if item.kept and (matches[k][0] is not None or object_track.agrees(cfg, tracks[k], item)):
            after = object_track.observed(cfg, tracks[k], item, box, cut=_is_cut(frame.camera, box))
            found[k] = changed(item, status="tracked"), after
    overlaps = overlap_similarities(cfg, [track for _, track in found.values()], kept.items, kept.boxes)
    found = {k: of_track for (k, of_track), overlap in zip(found.items(), overlaps, strict=True) if not overlap.any()}
    edges = dict(zip(found, extents(frame, path, [item for item, _ in found.values()]), strict=True))
    return [
        _Searched(object_track.placed(found[k][1], edges[k], track.template), found[k][0], correlation)
        if k in found
        else _Searched(track, None, correlation)
        for k, (track, (_, correlation)) in enumerate(zip(tracks, matches, strict=True))
    ]


def _sought(cfg: ObjectsConfig, frame: Frame, track: ObjectTrack, matched: Box | None) -> Box | None:
    """The box in the image where a track's object may be: where its template matched, else at its predicted place."""
    at_place = cfg.template_search and object_track.confirmed(cfg, track) and track.place is not None and divides(frame)
    if matched is None and not at_place:
        return None
    box = _within(frame.camera, matched or track.box_px)
    return box if matched or (box.x_min < box.x_max and box.y_min < box.y_max) else None


def _matched(cfg: ObjectsConfig, frame: Frame, track: ObjectTrack) -> tuple[Box | None, Correlation | None]:
    """The whole object's box where its template matches, None if nowhere, and the correlation."""
    if (
        not cfg.template_search
        or not object_track.confirmed(cfg, track)
        or track.template is None
        or frame.grey is None
    ):
        return None, None
    scale = object_track.zoom(track.template.distance_m, track.distance_m)
    correlation = track.template.search(frame.grey, _around(track), scale)
    found = None if correlation is None else correlation.match(cfg.template_min_score)
    return None if found is None else track.template.whole(found[0], scale), correlation


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
