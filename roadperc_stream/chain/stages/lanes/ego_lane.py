"""One frame of the ego lane: observe both boundaries, then track them over time."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from roadperc_stream.chain.stages.lanes import lines, tracking
from roadperc_stream.chain.stages.lanes.class_history import ClassHistory
from roadperc_stream.chain.stages.lanes.curves import Curve, lateral
from roadperc_stream.chain.stages.lanes.observe import Observation, ObservedBoundary, RoadProjection, observe
from roadperc_stream.chain.stages.lanes.tracking import BoundaryTrack
from roadperc_stream.core.config import LanesConfig
from roadperc_stream.core.datatypes import SIDES, Absent, Boundary, Lanes, Line, Mask, Reason, Side, Surface
from roadperc_stream.core.geometry import Float
from roadperc_stream.core.scene import Scene

_CHORD_AHEAD_M = 15.0
_SHORTEST_DRAWN_M = 10.0
_LEVEL_PX = 1e-6


@dataclass(frozen=True)
class TrackedBoundary:
    """A boundary that is tracked, and the classes on either side of it in the last frames."""

    track: BoundaryTrack
    reach_m: float
    inside: ClassHistory = field(default_factory=ClassHistory)
    outside: ClassHistory = field(default_factory=ClassHistory)


@dataclass(frozen=True)
class LanesState:
    """What the lanes remember from one frame to the next."""

    left: TrackedBoundary | None = None
    right: TrackedBoundary | None = None

    def side(self, side: Side) -> TrackedBoundary | None:
        """The boundary of that side; None where none is tracked."""
        return self.left if side == "left" else self.right


def step(
    cfg: LanesConfig,
    state: LanesState,
    scene: Scene,
    surface: Surface | Absent,
    drivable: Mask | Absent,
    last_T_this: Float | None,
) -> tuple[LanesState, Lanes | Absent]:
    """Measure the ego lane in one frame and filter it over time.

    Args:
        cfg: thresholds.
        state: what the last frame left.
        scene: the frame; without tags what is known is held.
        surface: the road in the front camera's frame.
        drivable: (H, W) drivable surface.
        last_T_this: (4, 4) motion of the ego frame since the last frame; None where it is not known.

    Returns:
        The new state, and the lanes: absent where nothing could be observed and nothing is held.
    """
    found = _observed(cfg, scene, surface, drivable)
    observation = None if isinstance(found, Absent) else found
    left, right = (_tracked(cfg, side, state.side(side), observation, last_T_this, scene.stamp_ns) for side in SIDES)
    after = LanesState(left, right)
    if isinstance(found, Absent) and left is None and right is None:
        return after, found
    projection = None if isinstance(surface, Absent) else RoadProjection(scene.camera, scene.ego_T_camera, surface)
    boundaries = tuple(_boundary(side, after.side(side), observation, projection) for side in SIDES)
    if observation is None:
        return after, Lanes(boundaries)
    merged = [lines.drawn(group, float(scene.camera.height), observation.far) for group in observation.groups]
    merged_px = np.array(merged).reshape(-1, 4)
    return after, Lanes(boundaries, observation.proposals, merged_px, observation.edge_pixels)


def _observed(
    cfg: LanesConfig, scene: Scene, surface: Surface | Absent, drivable: Mask | Absent
) -> Observation | Absent:
    if scene.tags is None or scene.table is None:
        return Absent(Reason("lanes", "no_segmentation"))
    if isinstance(surface, Absent):
        return Absent(Reason("lanes", "no_surface", cause=surface.reason))
    if isinstance(drivable, Absent):
        return Absent(Reason("lanes", "no_drivable_surface", cause=drivable.reason))
    projection = RoadProjection(scene.camera, scene.ego_T_camera, surface)
    return observe(cfg, projection, scene.tags, scene.table, drivable)


def _tracked(
    cfg: LanesConfig,
    side: Side,
    before: TrackedBoundary | None,
    observation: Observation | None,
    last_T_this: Float | None,
    stamp_ns: int,
) -> TrackedBoundary | None:
    """The boundary at this frame's time; None where there is none yet or it has not been measured for too long."""
    observed = observation.boundaries.get(side) if observation else None
    curve = observed.curve if observed else None
    if before is not None:
        track = tracking.predict(cfg, before.track, stamp_ns, last_T_this if cfg.use_odometry else None)
        for candidate in _candidates(cfg, side, track, observation, curve):
            updated = tracking.update(cfg, track, candidate.state, candidate.covariance)
            if updated is not None and observation is not None:
                return _measured(cfg, replace(before, track=updated), side, candidate, observation)
        if not tracking.expired(cfg, track):
            return replace(before, track=track)
    if observation is None or curve is None:
        return None
    track = tracking.start(curve.state, curve.covariance, stamp_ns)
    return _measured(cfg, TrackedBoundary(track, curve.reach_m), side, curve, observation)


def _measured(
    cfg: LanesConfig, tracked: TrackedBoundary, side: Side, curve: Curve, observation: Observation
) -> TrackedBoundary:
    """The boundary with this frame's curve and the classes on either side of it."""
    inside, outside = observation.classes_beside(side, curve)
    stamp_ns = tracked.track.stamp_ns
    return replace(
        tracked,
        reach_m=curve.reach_m,
        inside=tracked.inside.add(cfg, stamp_ns, inside),
        outside=tracked.outside.add(cfg, stamp_ns, outside),
    )


def _candidates(
    cfg: LanesConfig, side: Side, track: BoundaryTrack, observation: Observation | None, curve: Curve | None
) -> Iterator[Curve]:
    """What may be the boundary: the closest line's curve, then the edges along the prediction.

    The dashes in sight are often too short for a Hough line, and the closest line is then one farther out. A line
    closer than the prediction, though, contradicts it: then edges along the prediction are no evidence.
    """
    if curve is not None:
        yield curve
    inward = -1.0 if side == "left" else 1.0
    closer = curve is not None and inward * float(curve.state[0] - track.state[0]) > 0
    if observation is not None and not closer:
        along = observation.curve_along(cfg, side, track.state)
        if along is not None:
            yield along


def _boundary(
    side: Side, tracked: TrackedBoundary | None, observation: Observation | None, projection: RoadProjection | None
) -> Boundary:
    observed = observation.boundaries.get(side) if observation else None
    raw_px = _raw_line(observed, observation)
    raw_offset_m = float(observed.curve.state[0]) if observed and observed.curve else None
    if tracked is None:
        return Boundary(side, "lost", raw_px=raw_px, raw_offset_m=raw_offset_m)
    track = tracked.track
    offset, heading, curvature = (float(value) for value in track.state)
    ahead, pixels = _drawn_curve(track.state, tracked.reach_m, projection)
    return Boundary(
        side,
        "measured" if track.measured_ns == track.stamp_ns else "held",
        raw_px,
        _chord(track.state, projection, observation.far if observation else None),
        offset,
        heading,
        curvature,
        raw_offset_m,
        tuple(track.state_covariance.ravel().tolist()),
        tracked.inside.majority,
        tracked.outside.majority,
        ahead,
        pixels,
    )


def _raw_line(observed: ObservedBoundary | None, observation: Observation | None) -> Line | None:
    if observed is None or observation is None:
        return None
    return lines.drawn(observed.group, float(observation.projection.camera.height), observation.far)


def _drawn_curve(state: Float, reach_m: float, projection: RoadProjection | None) -> tuple[Float, Float]:
    """(N, 3) ego points a metre apart on the road, and (M, 2) pixels of those that are in front of the camera."""
    if projection is None:
        return np.empty((0, 3)), np.empty((0, 2))
    x = np.arange(max(reach_m, _SHORTEST_DRAWN_M) + 1)
    points = projection.on_road(x, lateral(state, x))
    pixels = projection.pixels(points)
    return points, pixels[np.isfinite(pixels).all(axis=1) & (pixels[:, 1] <= 2 * projection.camera.height)]


def _chord(state: Float, projection: RoadProjection | None, far: float | None) -> Line | None:
    """The smoothed line drawn straight from the image's bottom edge to the road's far end."""
    if projection is None or far is None:
        return None
    bottom = float(projection.camera.height)
    nearest = projection.ground(np.array([[projection.camera.cx, bottom]]))[0, 0]
    if not np.isfinite(nearest):
        return None
    x = np.array([nearest, max(nearest + 1.0, _CHORD_AHEAD_M)])
    (u1, v1), (u2, v2) = projection.pixels(projection.on_road(x, lateral(state, x)))
    if not abs(v2 - v1) > _LEVEL_PX:
        return None
    slope = (u2 - u1) / (v2 - v1)
    return float(u1 + slope * (bottom - v1)), bottom, float(u1 + slope * (far - v1)), far
