"""One frame of the objects: judge the detections, say which is which object, and search for those without one."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

from roadperc_stream.chain.stages.objects import tracking
from roadperc_stream.chain.stages.objects.association import assign, similarities
from roadperc_stream.chain.stages.objects.impact import with_motion
from roadperc_stream.chain.stages.objects.judge import judge
from roadperc_stream.chain.stages.objects.patch import cut
from roadperc_stream.chain.stages.objects.tracking import Track
from roadperc_stream.core.config import ObjectsConfig
from roadperc_stream.core.datatypes import Absent, Box, Correlation, Detection, Image, Object, Objects
from roadperc_stream.core.geometry import Camera, Float32
from roadperc_stream.core.semantics import TagTable

_MOST_TRACKS = 256
"""Objects that are remembered; beyond, those longest without a detection are forgotten."""
_SEARCH_SIGMAS = 3.0
_SEARCH_SIDES = 1.0
"""Most that is searched to each side of the predicted place, in box sides."""


@dataclass(frozen=True)
class ObjectsState:
    """What the objects remember from one frame to the next; ``next_number`` names the next new object."""

    tracks: tuple[Track, ...] = ()
    next_number: int = 1


@dataclass(frozen=True)
class _Scene:
    """The frame's pixels and cameras, as judging takes them."""

    camera: Camera
    tags: Image | None
    table: TagTable | None
    depth_m: Float32 | None
    limit_m: float
    grey: Image | None

    def judge(self, cfg: ObjectsConfig, detections: tuple[Detection, ...] | None) -> Objects | Absent:
        return judge(cfg, detections, self.camera, self.tags, self.table, self.depth_m, self.limit_m)

    def within(self, box: Box) -> Box:
        """The part of a box that is in the image."""
        x, y = float(self.camera.width), float(self.camera.height)
        return Box(
            min(max(box.x_min, 0.0), x),
            min(max(box.y_min, 0.0), y),
            min(max(box.x_max, 0.0), x),
            min(max(box.y_max, 0.0), y),
        )


@dataclass(frozen=True)
class _Seen:
    """Kept detections in an order that does not depend on the detector's: items, boxes in the image, positions."""

    items: tuple[Object, ...]
    boxes: tuple[Box, ...]
    positions: tuple[int, ...]


@dataclass(frozen=True)
class _Searched:
    """An object that no detection shows: its track, the object where its image was found, and where that was sought."""

    track: Track
    item: Object | None = None
    correlation: Correlation | None = None


def step(
    cfg: ObjectsConfig,
    state: ObjectsState,
    detections: tuple[Detection, ...] | None,
    camera: Camera,
    tags: Image | None,
    table: TagTable | None,
    depth_m: Float32 | None,
    limit_m: float,
    grey: Image | None,
    stamp_ns: int,
) -> tuple[ObjectsState, Objects | Absent]:
    """Judge a frame's detections and follow the kept ones over time.

    Args:
        cfg: thresholds.
        state: what the last frame left.
        detections: what the detector said; None where the frame has no detections message.
        camera: the camera of detections, tags, depth and image.
        tags: (H, W) tags of ``table``, or None: then nothing is judged and everything kept.
        table: the tags' table.
        depth_m: (H, W) metres along z, NaN unknown, or None.
        limit_m: depth at which the encoding saturates.
        grey: (H, W) image, or None: then objects without a detection are not searched for.
        stamp_ns: the frame's time, later than the last frame's.

    Returns:
        The new state, and the objects: the detector's own in its order, the kept ones with track id, closing speed
        and time to impact; then, with status ``tracked``, those that were found by their image alone, the oldest
        first. Distances are this frame's own; speed and time to impact come from the filter. Absent where there are
        neither detections nor objects found without them.
    """
    scene = _Scene(camera, tags, table, depth_m, limit_m, grey if cfg.template_search else None)
    judged = scene.judge(cfg, detections)
    own = () if isinstance(judged, Absent) else judged.objects
    seen = _kept(scene, own)
    known = [tracking.predict(cfg, track, stamp_ns) for track in state.tracks]
    known = [track for track in known if not tracking.expired(cfg, track)]
    pairs = assign(cfg, known, seen.items, seen.boxes)
    detected = _detected(cfg, state.next_number, scene, known, seen, pairs, stamp_ns)
    unseen = [track for k, track in enumerate(known) if k not in pairs]
    searched = [_searched(cfg, scene, track, seen) for track in unseen]
    found = tuple(with_motion(cfg, s.item, s.track) for s in searched if s.item is not None)
    tracks = _remembered([*detected.values(), *(s.track for s in searched)])
    fresh = len(seen.items) - len(pairs)
    after = ObjectsState(tracks, state.next_number + fresh)
    if isinstance(judged, Absent) and not found:
        return after, judged
    followed = tuple(with_motion(cfg, item, detected[k]) if k in detected else item for k, item in enumerate(own))
    return after, Objects(followed + found, tuple(s.correlation for s in searched if s.correlation is not None))


def _kept(scene: _Scene, objects: Sequence[Object]) -> _Seen:
    """The kept objects, the surest first, so that the order of the detections does not decide anything."""
    found = [(item, scene.within(item.detection.box_px), k) for k, item in enumerate(objects) if item.kept]
    found.sort(key=lambda entry: (-entry[0].detection.score, *_corners(entry[0].detection.box_px), *_words(entry[0])))
    return _Seen(tuple(item for item, _, _ in found), tuple(b for _, b, _ in found), tuple(k for _, _, k in found))


def _corners(box: Box) -> tuple[float, float, float, float]:
    return box.x_min, box.y_min, box.x_max, box.y_max


def _words(item: Object) -> tuple[str, str]:
    return item.detection.label, item.detection.id


def _detected(
    cfg: ObjectsConfig,
    next_number: int,
    scene: _Scene,
    known: Sequence[Track],
    seen: _Seen,
    pairs: dict[int, int],
    stamp_ns: int,
) -> dict[int, Track]:
    """The tracks after this frame's detections, old and new, by the detection's position."""
    track_of = {item: track for track, item in pairs.items()}
    tracks: dict[int, Track] = {}
    for k, (item, box, position) in enumerate(zip(seen.items, seen.boxes, seen.positions, strict=True)):
        if k in track_of:
            track = tracking.detected(cfg, known[track_of[k]], item, box)
        else:
            track = tracking.start(cfg, next_number, item, box, stamp_ns)
            next_number += 1
        tracks[position] = _with_patch(scene, track)
    return tracks


def _with_patch(scene: _Scene, track: Track) -> Track:
    """The track with its image in this frame; without an image the last one is still good for a while."""
    if scene.grey is None:
        return track
    distance_m = track.distance_m.value if track.distance_m else None
    return replace(track, patch=cut(scene.grey, track.box_px, distance_m))


def _searched(cfg: ObjectsConfig, scene: _Scene, track: Track, seen: _Seen) -> _Searched:
    """The track and its object as the image shows it, judged as detections are; no object if it does not.

    What a detection shows already is not said twice, and where the tags say otherwise the match is chance.
    """
    if track.patch is None or scene.grey is None or not tracking.proven(cfg, track):
        return _Searched(track)
    scale = tracking.zoom(track.patch.distance_m, track.distance_m)
    correlation = track.patch.search(scene.grey, _around(track), scale)
    found = None if correlation is None else correlation.match(cfg.template_min_score)
    lost = _Searched(track, None, correlation)
    if found is None:
        return lost
    box_px = scene.within(track.patch.whole(found[0], scale))
    judged = scene.judge(cfg, (replace(track.detection, box_px=box_px),))
    if isinstance(judged, Absent) or not judged.objects[0].kept:
        return lost
    item = replace(judged.objects[0], status="tracked")
    after = tracking.carried(cfg, track, item)
    shown = similarities(cfg, [after], seen.items, seen.boxes).any()
    return lost if shown else _Searched(after, item, correlation)


def _around(track: Track) -> Box:
    """Where the object's middle may be: near its predicted place."""
    width, height = track.box_px.x_max - track.box_px.x_min, track.box_px.y_max - track.box_px.y_min
    x, y = track.x_px.value, track.y_px.value
    aside = min(_SEARCH_SIGMAS * sqrt(track.x_px.value_var), _SEARCH_SIDES * width) + 1.0
    above = min(_SEARCH_SIGMAS * sqrt(track.y_px.value_var), _SEARCH_SIDES * height) + 1.0
    return Box(x - aside, y - above, x + aside, y + above)


def _remembered(tracks: Sequence[Track]) -> tuple[Track, ...]:
    """The tracks, the oldest first, as many as may be kept."""
    latest = sorted(tracks, key=lambda track: (-track.detected_ns, track.number))[:_MOST_TRACKS]
    return tuple(sorted(latest, key=lambda track: track.number))
