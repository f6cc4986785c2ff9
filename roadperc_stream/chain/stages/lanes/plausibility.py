"""What cannot be the ego lane: boundaries that the car stands on, too close together, too far apart, or crossing."""

import numpy as np

from roadperc_stream.chain.stages.lanes import tracking
from roadperc_stream.chain.stages.lanes.curves import lateral
from roadperc_stream.chain.stages.lanes.following import JUDGED_AT_M, least_known_m
from roadperc_stream.chain.stages.lanes.memory import LanesState, TrackedBoundary
from roadperc_stream.chain.stages.lanes.sides import other_side, outward
from roadperc_stream.core.config import LanesConfig
from roadperc_stream.core.datatypes import SIDES, Reason, Side
from roadperc_stream.core.geometry import Float

_STEP_M = 1.0
_CERTAIN_STD_M = 0.09
"""Standard deviation ``JUDGED_AT_M`` ahead up to which a boundary needs no other one beside it to be believed."""
_PARALLEL_M = 0.3
"""By how much the lane's width may change until there: boundaries that edges of wrong tags turn are not parallel."""
_TURNED = 0.1
"""Of two boundaries whose headings differ by more, the one that runs less along the car is the wrong one."""


def without_implausible(cfg: LanesConfig, state: LanesState) -> tuple[LanesState, dict[Side, Reason]]:
    """The state without the boundary that contradicts the better one of the two, and why it is left out."""
    if state.left is None or state.right is None:
        return state, {}
    side: Side = "left" if _worse(state.left, state.right) else "right"
    reason = _contradiction(cfg, side, state.left, state.right)
    if reason is None:
        return state, {}
    return state.with_side(side, None), {side: reason}


def unusable(cfg: LanesConfig, state: LanesState) -> dict[Side, Reason]:
    """Boundaries that are followed, but are none to be given in this frame, and why."""
    reasons = {side: _fault(cfg, state, side, tracked) for side in SIDES if (tracked := state.side(side))}
    return {side: reason for side, reason in reasons.items() if reason is not None}


def _fault(cfg: LanesConfig, state: LanesState, side: Side, tracked: TrackedBoundary) -> Reason | None:
    if outward(side) * tracked.offset_m <= 0:
        return Reason("lanes", "car_on_boundary", (side,))
    if not tracked.is_sure:
        at_m = least_known_m(tracked)
        std_m = tracking.std_at(tracked.track, at_m)
        return Reason("lanes", "boundary_uncertain", (side, at_m, round(std_m, 2), cfg.max_std_m))
    std_m = tracking.std_at(tracked.track, JUDGED_AT_M)
    if std_m > _CERTAIN_STD_M and not _confirmed(tracked, state.side(other_side(side))):
        return Reason("lanes", "boundary_unconfirmed", (side, JUDGED_AT_M, round(std_m, 2)))
    return None


def _confirmed(tracked: TrackedBoundary, other: TrackedBoundary | None) -> bool:
    """Whether the other boundary runs beside this one."""
    if other is None:
        return False
    apart = tracked.track.state - other.track.state
    return abs(float(lateral(apart, np.array(JUDGED_AT_M)) - apart[0])) < _PARALLEL_M


def _contradiction(cfg: LanesConfig, side: Side, left: TrackedBoundary, right: TrackedBoundary) -> Reason | None:
    width_m = left.offset_m - right.offset_m
    if not cfg.min_width_m <= width_m <= cfg.max_width_m:
        return Reason("lanes", "lane_width", (side, round(width_m, 2), cfg.min_width_m, cfg.max_width_m))
    reach_m = min(left.reach_m, right.reach_m)
    x = np.append(np.arange(0.0, reach_m, _STEP_M), reach_m)
    crossed: Float = x[lateral(left.track.state - right.track.state, x) <= 0]
    return Reason("lanes", "boundaries_cross", (side, float(crossed[0]))) if len(crossed) else None


def _worse(left: TrackedBoundary, right: TrackedBoundary) -> bool:
    """Whether the left one is the worse: turned away, not measured for longer, or less certain."""
    turned = abs(float(left.track.state[1])) - abs(float(right.track.state[1]))
    if abs(turned) > _TURNED:
        return turned > 0
    if left.track.measured_ns != right.track.measured_ns:
        return left.track.measured_ns < right.track.measured_ns
    return tracking.std_at(left.track, JUDGED_AT_M) > tracking.std_at(right.track, JUDGED_AT_M)
