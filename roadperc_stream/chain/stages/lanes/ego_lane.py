"""One frame of the ego lane: observe both boundaries, then follow them over time."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from roadperc_stream.chain.stages.lanes import lines, tracking
from roadperc_stream.chain.stages.lanes.curves import Curve, lateral
from roadperc_stream.chain.stages.lanes.observe import Observation, Sighting, View, observe
from roadperc_stream.chain.stages.lanes.tracking import Track
from roadperc_stream.chain.stages.lanes.votes import Votes
from roadperc_stream.core.config import LanesConfig
from roadperc_stream.core.datatypes import SIDES, Absent, Boundary, Image, Lanes, Line, Mask, Side, Surface
from roadperc_stream.core.geometry import Camera, Float
from roadperc_stream.core.semantics import TagTable

_CHORD_AHEAD_M = 15.0
_SHORTEST_DRAWN_M = 10.0
_LEVEL_PX = 1e-6


@dataclass(frozen=True)
class Followed:
    """A boundary that is followed, and the classes seen beside it of late."""

    track: Track
    reach_m: float
    inside: Votes = field(default_factory=Votes)
    outside: Votes = field(default_factory=Votes)


@dataclass(frozen=True)
class LanesState:
    """What the lanes remember from one frame to the next."""

    left: Followed | None = None
    right: Followed | None = None

    def side(self, side: Side) -> Followed | None:
        """The boundary of that side; None where none is followed."""
        return self.left if side == "left" else self.right


def step(
    cfg: LanesConfig,
    state: LanesState,
    camera: Camera,
    ego_T_camera: Float,
    surface: Surface | Absent,
    tags: Image | None,
    table: TagTable | None,
    road: Mask | Absent,
    last_T_this: Float | None,
    stamp_ns: int,
) -> tuple[LanesState, Lanes | Absent]:
    """Measure the ego lane in one frame and filter it over time.

    Args:
        cfg: thresholds.
        state: what the last frame left.
        camera: the camera of the tags.
        ego_T_camera: its mounting.
        surface: the road in that camera's frame.
        tags: (H, W) tags of ``table``; None: what is known is held.
        table: the tags' table.
        road: (H, W) drivable surface.
        last_T_this: (4, 4) motion of the ego frame since the last frame; None where it is not known.
        stamp_ns: the frame's time, later than the last frame's.

    Returns:
        The new state, and the lanes: absent where nothing could be looked at and nothing is held.
    """
    seen = _look(cfg, surface, camera, ego_T_camera, tags, table, road)
    observation = None if isinstance(seen, Absent) else seen
    left, right = (_follow(cfg, side, state.side(side), observation, last_T_this, stamp_ns) for side in SIDES)
    after = LanesState(left, right)
    if isinstance(seen, Absent) and left is None and right is None:
        return after, seen
    view = None if isinstance(surface, Absent) else View(camera, ego_T_camera, surface)
    boundaries = tuple(_boundary(side, after.side(side), observation, view) for side in SIDES)
    if observation is None:
        return after, Lanes(boundaries)
    merged = [lines.drawn(group, float(camera.height), observation.far) for group in observation.groups]
    merged_px = np.array(merged).reshape(-1, 4)
    return after, Lanes(boundaries, observation.proposals, merged_px, observation.edge_pixels)


def _look(
    cfg: LanesConfig,
    surface: Surface | Absent,
    camera: Camera,
    ego_T_camera: Float,
    tags: Image | None,
    table: TagTable | None,
    road: Mask | Absent,
) -> Observation | Absent:
    if tags is None or table is None:
        return Absent("no segmentation")
    if isinstance(surface, Absent):
        return Absent(f"no surface: {surface.reason}")
    if isinstance(road, Absent):
        return Absent(f"no drivable surface: {road.reason}")
    return observe(cfg, View(camera, ego_T_camera, surface), tags, table, road)


def _follow(
    cfg: LanesConfig,
    side: Side,
    before: Followed | None,
    observation: Observation | None,
    last_T_this: Float | None,
    stamp_ns: int,
) -> Followed | None:
    """The boundary at this frame's time; None where there is none yet or it has been unseen for too long."""
    sighting = observation.sightings.get(side) if observation else None
    curve = sighting.curve if sighting else None
    if before is not None:
        track = tracking.predict(cfg, before.track, stamp_ns, last_T_this if cfg.use_odometry else None)
        for candidate in _candidates(cfg, side, track, observation, curve):
            updated = tracking.update(cfg, track, candidate.state, candidate.covariance)
            if updated is not None and observation is not None:
                return _seen(cfg, replace(before, track=updated), side, candidate, observation)
        if not tracking.expired(cfg, track):
            return replace(before, track=track)
    if observation is None or curve is None:
        return None
    track = tracking.start(curve.state, curve.covariance, stamp_ns)
    return _seen(cfg, Followed(track, curve.reach_m), side, curve, observation)


def _seen(cfg: LanesConfig, followed: Followed, side: Side, curve: Curve, observation: Observation) -> Followed:
    """The boundary as this frame shows it, which has one vote on the classes beside it."""
    inside, outside = observation.classes_beside(side, curve)
    stamp_ns = followed.track.stamp_ns
    return replace(
        followed,
        reach_m=curve.reach_m,
        inside=followed.inside.add(cfg, stamp_ns, inside),
        outside=followed.outside.add(cfg, stamp_ns, outside),
    )


def _candidates(
    cfg: LanesConfig, side: Side, track: Track, observation: Observation | None, curve: Curve | None
) -> Iterator[Curve]:
    """What may be the boundary: the closest line's curve, then the edges along the prediction.

    The dashes in sight are often too short for a Hough line, and the closest line is then one farther out. A line
    closer than the prediction, though, contradicts it: then edges along the prediction prove nothing.
    """
    if curve is not None:
        yield curve
    inward = -1.0 if side == "left" else 1.0
    closer = curve is not None and inward * float(curve.state[0] - track.state[0]) > 0
    if observation is not None and not closer:
        along = observation.curve_along(cfg, side, track.state)
        if along is not None:
            yield along


def _boundary(side: Side, followed: Followed | None, observation: Observation | None, view: View | None) -> Boundary:
    sighting = observation.sightings.get(side) if observation else None
    raw_px = _raw_line(sighting, observation)
    raw_offset_m = float(sighting.curve.state[0]) if sighting and sighting.curve else None
    if followed is None:
        return Boundary(side, "lost", raw_px=raw_px, raw_offset_m=raw_offset_m)
    track = followed.track
    offset, heading, curvature = (float(value) for value in track.state)
    ahead, pixels = _drawn_curve(track.state, followed.reach_m, view)
    return Boundary(
        side,
        "measured" if track.measured_ns == track.stamp_ns else "held",
        raw_px,
        _chord(track.state, view, observation.far if observation else None),
        offset,
        heading,
        curvature,
        raw_offset_m,
        tuple(track.state_covariance.ravel().tolist()),
        followed.inside.winner,
        followed.outside.winner,
        ahead,
        pixels,
    )


def _raw_line(sighting: Sighting | None, observation: Observation | None) -> Line | None:
    if sighting is None or observation is None:
        return None
    return lines.drawn(sighting.group, float(observation.view.camera.height), observation.far)


def _drawn_curve(state: Float, reach_m: float, view: View | None) -> tuple[Float, Float]:
    """(N, 3) ego points a metre apart on the road, and (M, 2) pixels of those that are in front of the camera."""
    if view is None:
        return np.empty((0, 3)), np.empty((0, 2))
    x = np.arange(max(reach_m, _SHORTEST_DRAWN_M) + 1)
    points = view.on_road(x, lateral(state, x))
    pixels = view.pixels(points)
    return points, pixels[np.isfinite(pixels).all(axis=1) & (pixels[:, 1] <= 2 * view.camera.height)]


def _chord(state: Float, view: View | None, far: float | None) -> Line | None:
    """The smoothed line drawn straight from the image's bottom edge to the road's far end."""
    if view is None or far is None:
        return None
    bottom = float(view.camera.height)
    nearest = view.ground(np.array([[view.camera.cx, bottom]]))[0, 0]
    if not np.isfinite(nearest):
        return None
    x = np.array([nearest, max(nearest + 1.0, _CHORD_AHEAD_M)])
    (u1, v1), (u2, v2) = view.pixels(view.on_road(x, lateral(state, x)))
    if not abs(v2 - v1) > _LEVEL_PX:
        return None
    slope = (u2 - u1) / (v2 - v1)
    return float(u1 + slope * (bottom - v1)), bottom, float(u1 + slope * (far - v1)), far
