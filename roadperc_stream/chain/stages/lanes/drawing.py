"""A tracked boundary as the frame's result has it: its state, and its line on the road and in the image."""

import numpy as np

from roadperc_stream.chain.stages.lanes import lines
from roadperc_stream.chain.stages.lanes.curves import lateral
from roadperc_stream.chain.stages.lanes.memory import TrackedBoundary
from roadperc_stream.chain.stages.lanes.observe import Observation, ObservedBoundary, RoadProjection
from roadperc_stream.core.datatypes import Boundary, Line, Reason, Side
from roadperc_stream.core.geometry import Float

_CHORD_AHEAD_M = 15.0
_SHORTEST_DRAWN_M = 10.0
_LEVEL_PX = 1e-6


def boundary_of(
    side: Side,
    found: TrackedBoundary | Reason,
    observation: Observation | None,
    projection: RoadProjection | None,
) -> Boundary:
    """One side's boundary, or that it is lost and why."""
    observed = observation.boundaries.get(side) if observation else None
    raw_px = _raw_line(observed, observation)
    raw_offset_m = float(observed.curve.state[0]) if observed and observed.curve else None
    if isinstance(found, Reason):
        return Boundary(side, "lost", raw_px=raw_px, raw_offset_m=raw_offset_m, reason=found)
    track = found.track
    offset, heading, curvature = (float(value) for value in track.state)
    ahead, pixels = _drawn_curve(track.state, found.reach_m, projection)
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
        found.inside.majority,
        found.outside.majority,
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
