"""Changes of lane: the line that is crossed becomes the other boundary of the next lane, with all that is known of it.

The car is in another lane as soon as its reference point, the origin of the ego frame, is past the middle of the line
between the two.
"""

from dataclasses import dataclass, replace

import numpy as np

from roadperc_stream.chain.stages.lanes import following, tracking
from roadperc_stream.chain.stages.lanes.curves import Curve
from roadperc_stream.chain.stages.lanes.memory import LanesState, TrackedBoundary
from roadperc_stream.chain.stages.lanes.observe import Observation
from roadperc_stream.chain.stages.lanes.sides import other_side, outward
from roadperc_stream.core.config import LanesConfig
from roadperc_stream.core.datatypes import SIDES, LaneChange, Side

_MARKING_M = 0.15
"""Width of a marking whose other edge is not seen."""
_MARKING_STD_M = 0.1
_CROSSED_STD = 2.0
"""Standard deviations by which the car must be past the line: one that is hardly known is crossed by chance."""
_DOUBLE_M = 0.6
"""No marking is wider, a double one neither."""
_LINE_STEP = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class _FarEdge:
    """The other edge of a boundary's marking: by how much it lies farther out, and its curve where it is seen."""

    width_m: float
    curve: Curve | None


def handed_over(cfg: LanesConfig, state: LanesState, observation: Observation | None, stamp_ns: int) -> LanesState:
    """The state with the next lane's boundaries, where the car has crossed one of this lane's."""
    for side in SIDES:
        crossed = state.side(side)
        if crossed is None or outward(side) * crossed.offset_m > 0:
            continue
        far = _far_edge(cfg, side, crossed, observation)
        if outward(side) * crossed.offset_m + far.width_m / 2 < -_CROSSED_STD * tracking.std_at(crossed.track, 0.0):
            return _in_next_lane(cfg, state, side, crossed, far, observation, stamp_ns)
    return state


def change_of(cfg: LanesConfig, before: LaneChange, state: LanesState) -> LaneChange:
    """The side on which the car is over a line on its way into another lane, or has been and is not clear of it yet.

    Args:
        cfg: how wide the car is.
        before: that of the last frame.
        state: the boundaries of this one.
    """
    over = [side for side in SIDES if _is_over(cfg, side, state.side(side))]
    if before != "none":
        return before if over else "none"
    return next((side for side in over if _comes_nearer(side, state.side(side))), "none")


def _is_over(cfg: LanesConfig, side: Side, boundary: TrackedBoundary | None) -> bool:
    return boundary is not None and outward(side) * boundary.offset_m < cfg.car_width_m / 2


def _comes_nearer(side: Side, boundary: TrackedBoundary | None) -> bool:
    return boundary is not None and outward(side) * boundary.track.rate_mps < 0


def _in_next_lane(
    cfg: LanesConfig,
    state: LanesState,
    side: Side,
    crossed: TrackedBoundary,
    far: _FarEdge,
    observation: Observation | None,
    stamp_ns: int,
) -> LanesState:
    """The state in the lane beyond a boundary: that one, from its other side, and the next one out if it is seen."""
    track = tracking.shifted(crossed.track, outward(side) * far.width_m, _MARKING_STD_M)
    inner = TrackedBoundary(track, crossed.reach_m, crossed.outside, crossed.inside)
    if far.curve is not None and observation is not None:
        updated = tracking.update(cfg, track, far.curve.state, far.curve.covariance)
        inner = replace(inner, track=updated or tracking.start(far.curve.state, far.curve.covariance, stamp_ns))
    inner = following.judged(cfg, inner)
    outer = following.followed(cfg, side, None, inner, observation, stamp_ns)
    changed = replace(state, lane_change=side, lane_changes=state.lane_changes + 1)
    return changed.with_side(side, outer).with_side(other_side(side), inner)


def _far_edge(cfg: LanesConfig, side: Side, crossed: TrackedBoundary, observation: Observation | None) -> _FarEdge:
    if observation is None:
        return _FarEdge(_MARKING_M, None)
    line = crossed.track.state + outward(side) * _MARKING_M * _LINE_STEP
    curve = observation.curve_along(cfg, other_side(side), line)
    if curve is None:
        return _FarEdge(_MARKING_M, None)
    width_m = outward(side) * (float(curve.state[0]) - crossed.offset_m)
    return _FarEdge(width_m, curve) if 0.0 < width_m < _DOUBLE_M else _FarEdge(_MARKING_M, None)
