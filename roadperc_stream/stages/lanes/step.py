"""One frame of the ego lane: observe both boundaries, then follow them over time."""

from dataclasses import dataclass, field, replace

import numpy as np

from roadperc_stream.config import LanesConfig
from roadperc_stream.datatypes import SIDES, Absent, Boundary, Image, Lanes, Line, Mask, Side, Surface
from roadperc_stream.geometry import Camera, Float
from roadperc_stream.semantics import TagTable
from roadperc_stream.stages.lanes import lines, tracking
from roadperc_stream.stages.lanes.curves import lateral
from roadperc_stream.stages.lanes.observe import Observation, Sighting, View, observe
from roadperc_stream.stages.lanes.tracking import Track

_CHORD_AHEAD_M = 15.0
_SHORTEST_DRAWN_M = 10.0


@dataclass(frozen=True)
class Followed:
    """A boundary that is followed, and the classes last seen beside it."""

    track: Track
    reach_m: float
    inside: str
    outside: str


@dataclass(frozen=True)
class LanesState:
    """What the lanes remember from one frame to the next."""

    followed: dict[Side, Followed] = field(default_factory=dict)


def step(
    cfg: LanesConfig,
    state: LanesState,
    camera: Camera,
    ego_T_camera: Float,
    surface: Surface | Absent,
    tags: Image | None,
    table: TagTable | None,
    road: Mask | Absent,
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
        stamp_ns: the frame's time, later than the last frame's.

    Returns:
        The new state, and the lanes: absent where nothing could be looked at and nothing is held.
    """
    view = None if isinstance(surface, Absent) else View(camera, ego_T_camera, surface)
    seen = _look(cfg, view, tags, table, road)
    observation = Observation(float(camera.cy)) if isinstance(seen, Absent) else seen
    followed = {
        side: after
        for side in SIDES
        if (after := _follow(cfg, state.followed.get(side), observation.sightings.get(side), stamp_ns))
    }
    if isinstance(seen, Absent) and not followed:
        return LanesState(), seen
    boundaries = tuple(_boundary(side, followed.get(side), observation, view) for side in SIDES)
    merged = [lines.drawn(group, float(camera.height), observation.far) for group in observation.groups]
    return LanesState(followed), Lanes(boundaries, observation.proposals, np.array(merged).reshape(-1, 4))


def _look(
    cfg: LanesConfig, view: View | None, tags: Image | None, table: TagTable | None, road: Mask | Absent
) -> Observation | Absent:
    if tags is None or table is None:
        return Absent("no segmentation")
    if view is None:
        return Absent("no surface")
    if isinstance(road, Absent):
        return Absent(road.reason)
    return observe(cfg, view, tags, table, road)


def _follow(cfg: LanesConfig, before: Followed | None, sighting: Sighting | None, stamp_ns: int) -> Followed | None:
    """The boundary at this frame's time; None where there is none yet or it has been unseen for too long."""
    curve = sighting.curve if sighting else None
    if before is not None:
        track = tracking.predict(cfg, before.track, stamp_ns)
        updated = tracking.update(cfg, track, curve.state, curve.covariance) if curve else None
        if updated is not None and sighting is not None and curve is not None:
            return Followed(updated, curve.reach_m, sighting.inside, sighting.outside)
        if not tracking.expired(cfg, track):
            return replace(before, track=track)
    if sighting is None or curve is None:
        return None
    track = tracking.start(curve.state, curve.covariance, stamp_ns)
    return Followed(track, curve.reach_m, sighting.inside, sighting.outside)


def _boundary(side: Side, followed: Followed | None, observation: Observation, view: View | None) -> Boundary:
    sighting = observation.sightings.get(side)
    bottom = float(view.camera.height) if view else 0.0
    raw_px = lines.drawn(sighting.group, bottom, observation.far) if sighting else None
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
        _chord(track.state, view, observation.far) if view else None,
        offset,
        heading,
        curvature,
        raw_offset_m,
        tuple(track.state_covariance.ravel().tolist()),
        followed.inside,
        followed.outside,
        ahead,
        pixels,
    )


def _drawn_curve(state: Float, reach_m: float, view: View | None) -> tuple[Float, Float]:
    """(N, 3) ego points a metre apart on the road, and (M, 2) pixels of those that are in front of the camera."""
    if view is None:
        return np.empty((0, 3)), np.empty((0, 2))
    x = np.arange(max(reach_m, _SHORTEST_DRAWN_M) + 1)
    points = view.on_road(x, lateral(state, x))
    pixels = view.pixels(points)
    return points, pixels[np.isfinite(pixels).all(axis=1) & (pixels[:, 1] <= 2 * view.camera.height)]


def _chord(state: Float, view: View, far: float) -> Line | None:
    """The smoothed line drawn straight from the image's bottom edge to the road's far end."""
    bottom = float(view.camera.height)
    nearest = view.ground(np.array([[view.camera.cx, bottom]]))[0, 0]
    if not np.isfinite(nearest):
        return None
    x = np.array([nearest, max(nearest + 1.0, _CHORD_AHEAD_M)])
    (u1, v1), (u2, v2) = view.pixels(view.on_road(x, lateral(state, x)))
    if not abs(v2 - v1) > 1e-6:
        return None
    slope = (u2 - u1) / (v2 - v1)
    return float(u1 + slope * (bottom - v1)), bottom, float(u1 + slope * (far - v1)), far
