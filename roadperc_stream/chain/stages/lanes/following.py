"""Boundaries from frame to frame: predict, measure, hold, start, and hand over in a lane change.

The car is in another lane when its reference point, the origin of the ego frame, has passed the middle of the line
between both lanes.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from roadperc_stream.chain.stages.lanes import tracking
from roadperc_stream.chain.stages.lanes.curves import Curve, lateral, other_side, outward
from roadperc_stream.chain.stages.lanes.observe import Observation
from roadperc_stream.chain.stages.lanes.tracking import LanesState, TrackedBoundary
from roadperc_stream.config import LanesConfig
from roadperc_stream.model import SIDES, LaneChange, Side
from roadperc_stream.system.time import NS_PER_S

JUDGED_AT_M = 10.0
"""A boundary must be known at the car and at this distance ahead."""
_JUDGED_AT = np.array([0.0, JUDGED_AT_M])
MIN_WIDTH_M = 2.0
"""Narrowest lane: if boundaries are closer together, one of them is wrong."""
MAX_STD_M = 0.16
"""Standard deviation, at the car or ``JUDGED_AT_M`` ahead, beyond which a boundary is lost."""
_SAME_M = 0.6
"""A line this close to the other boundary's prediction is that boundary; covers both edges of a double line."""
_SAME_LINE_M = 0.05
"""Curves closer to each other than this are of the same edges: a third of a marking."""
_MARKING_M = 0.15
"""Assumed width of a marking if its other edge is not visible."""
_MARKING_STD_M = 0.1
_CROSSED_STD = 2.0
"""Standard deviations by which the car must be past the line, so that noise does not count as a crossing."""
_DOUBLE_M = 0.6
"""Widest marking, double markings included."""
_LINE_STEP = np.array([1.0, 0.0, 0.0])
_WIDTH_STD_M = 0.3
"""Standard deviation of the change of a lane's width while one of its boundaries is not seen."""
_REMEMBERED_NS = 10 * NS_PER_S
"""How long the last certain place of a boundary is kept: 10 s cover 40 m of missing lines at 4 m/s."""
_ALONG = 0.4
"""Largest angle between car and boundary in a lane change; a turn at a crossing passes lines at larger angles."""


def followed(
    cfg: LanesConfig,
    side: Side,
    before: TrackedBoundary | None,
    other: TrackedBoundary | None,
    observation: Observation | None,
    stamp_ns: int,
) -> TrackedBoundary | None:
    """The boundary of one side in this frame; None if it is not found yet or was last measured too long ago.

    ``before`` and ``other`` are the predictions of this side and the other; ``observation`` is None without tags.
    """
    curve = observation.curves.get(side) if observation else None
    # While the car crosses the other side's boundary, both sides may find it.
    if observation and curve and other and abs(float(curve.state[0]) - other.offset_m) < _SAME_M:
        curve = observation.curve_beyond(cfg, side, outward(side) * other.offset_m + MIN_WIDTH_M)
    if before is not None:
        for candidate in _candidates(cfg, side, before, observation, curve):
            updated = tracking.update(cfg, before.track, candidate)
            if updated is not None and observation is not None:
                return measured(cfg, replace(before, track=updated), side, candidate, observation)
        if not tracking.expired(cfg, before.track):
            return before
    if observation is None or curve is None or not curve.is_sure:
        return None
    begun = TrackedBoundary(tracking.start(curve, stamp_ns), curve.reach_m)
    return measured(cfg, begun, side, curve, observation)


def without_other_lines(
    cfg: LanesConfig,
    before: Mapping[Side, TrackedBoundary],
    now: Mapping[Side, TrackedBoundary | None],
    certain: Mapping[Side, TrackedBoundary],
    stamp_ns: int,
) -> tuple[dict[Side, TrackedBoundary | None], dict[Side, TrackedBoundary]]:
    """The boundaries of this frame, and the last certain ones after it.

    A boundary that contradicts its last certain one is another line, such as a kerb: the prediction is held instead.
    Odometry moves the last certain boundary. If the other boundary is certain, it may also give the place, by the last
    lane width.

    Args:
        cfg: the time for which a boundary is held.
        before: the predictions of the tracked boundaries.
        now: this frame's boundaries.
        certain: the last certain boundaries, moved to this frame by odometry; empty without odometry.
        stamp_ns: stamp of this frame.
    """
    kept, after = dict(now), {}
    for side in SIDES:
        expected, found = _expected(side, now, certain, stamp_ns), now[side]
        if found is not None and expected is not None and not _continues(expected, found, stamp_ns):
            held = before.get(side)
            kept[side] = None if held is None or tracking.expired(cfg, held.track) else held
        elif found is not None and _is_certain(found, stamp_ns):
            expected = found
        if expected is not None and stamp_ns - expected.track.measured_ns <= _REMEMBERED_NS:
            after[side] = expected
    return kept, after


def _expected(
    side: Side, now: Mapping[Side, TrackedBoundary | None], certain: Mapping[Side, TrackedBoundary], stamp_ns: int
) -> TrackedBoundary | None:
    """The last certain boundary in this frame; None if there is none.

    It is moved by odometry or placed beside the other one, whichever is more certain.
    """
    boundary, last_other, other = certain.get(side), certain.get(other_side(side)), now[other_side(side)]
    if boundary is None or last_other is None or other is None or not _is_certain(other, stamp_ns):
        return boundary
    beside = tracking.shifted(other.track, boundary.offset_m - last_other.offset_m, _WIDTH_STD_M)
    if tracking.std_at(boundary.track, 0.0) < tracking.std_at(beside, 0.0):
        return boundary
    return replace(boundary, track=replace(beside, measured_ns=boundary.track.measured_ns))


def _is_certain(boundary: TrackedBoundary, stamp_ns: int) -> bool:
    return boundary.is_sure and boundary.is_clear and boundary.track.measured_ns == stamp_ns


def _continues(expected: TrackedBoundary, now: TrackedBoundary, stamp_ns: int) -> bool:
    """Whether a measured boundary can be the expected one.

    A clear boundary with the same class beyond it may move, as where a lane begins. A kerb beside a missing line is of
    another class, and noise may turn a boundary towards it in small steps.
    """
    latest = [name for seen_ns, name in now.outside.observations if seen_ns == stamp_ns]
    is_same = now.is_clear and latest == [expected.outside.majority]
    return is_same or tracking.agree(expected.track, now.track)


def measured(
    cfg: LanesConfig, tracked: TrackedBoundary, side: Side, curve: Curve, observation: Observation
) -> TrackedBoundary:
    """The boundary with this frame's curve and the classes on either side of it."""
    inside, outside = observation.classes_beside(side, curve)
    stamp_ns = tracked.track.stamp_ns
    now = replace(
        tracked,
        reach_m=curve.reach_m,
        hidden_m=observation.hidden_m,
        is_clear=curve.is_clear,
        inside=tracked.inside.add(cfg, stamp_ns, inside),
        outside=tracked.outside.add(cfg, stamp_ns, outside),
    )
    return judged(now)


def judged(tracked: TrackedBoundary) -> TrackedBoundary:
    """The boundary with ``is_sure`` set: whether it is certain enough to be used."""
    return replace(tracked, is_sure=tracking.std_at(tracked.track, least_known_m(tracked)) <= MAX_STD_M)


def least_known_m(tracked: TrackedBoundary) -> float:
    """Where the boundary is less certain: where it begins, at the car or the bonnet, or ``JUDGED_AT_M`` beyond."""
    begins_m = tracked.hidden_m
    return max(begins_m, begins_m + JUDGED_AT_M, key=lambda x_m: tracking.std_at(tracked.track, x_m))


def _candidates(
    cfg: LanesConfig, side: Side, before: TrackedBoundary, observation: Observation | None, curve: Curve | None
) -> Iterator[Curve]:
    """Candidates for the boundary: the edges along the prediction, then the curve of the closest line.

    Visible dashes are often too short for a Hough line; the closest line is then a different one farther out. If a
    clear line is closer than the prediction, it contradicts the prediction, and edges along that are not used. If a
    clear line lies on the prediction, the edges along both are the same.
    """
    if curve is not None and curve.is_clear:
        is_closer = outward(side) * (before.offset_m - float(curve.state[0])) > _SAME_M
        if is_closer or _lies_on(curve, before):
            yield curve
            return
    along = None if observation is None else observation.curve_along(cfg, side, before.track.state)
    if along is not None:
        yield along
    if curve is not None:
        yield curve


def _lies_on(curve: Curve, predicted: TrackedBoundary) -> bool:
    """Whether a curve is closer to a prediction than two lines are to each other, at the car and ``JUDGED_AT_M``."""
    apart = curve.state - predicted.track.state
    return bool(np.abs(lateral(apart, _JUDGED_AT)).max() < _SAME_LINE_M)


def handed_over(cfg: LanesConfig, state: LanesState, observation: Observation | None, stamp_ns: int) -> LanesState:
    """The state with the boundaries of the next lane, if the car has crossed a boundary of this lane.

    A lane change counts only if the boundary runs along the car. The boundaries are the far edge of the crossed marking
    and the next boundary beyond it, if that is visible.
    """
    for side in SIDES:
        crossed = state.side(side)
        if crossed is None or outward(side) * crossed.offset_m > 0:
            continue
        width_m, far_edge = _far_edge(cfg, side, crossed, observation)
        if not outward(side) * crossed.offset_m + width_m / 2 < -_CROSSED_STD * tracking.std_at(crossed.track, 0.0):
            continue
        track = tracking.shifted(crossed.track, outward(side) * width_m, _MARKING_STD_M)
        if far_edge is not None:
            updated = tracking.update(cfg, track, far_edge)
            track = updated or tracking.start(far_edge, stamp_ns)
        inner = judged(TrackedBoundary(track, crossed.reach_m, crossed.outside, crossed.inside))
        outer = followed(cfg, side, None, inner, observation, stamp_ns)
        if _runs_along(crossed):
            state = replace(state, lane_change=side, lane_changes=state.lane_changes + 1)
        state = replace(state, left_certain=None, right_certain=None)
        return state.with_side(side, outer).with_side(other_side(side), inner)
    return state


def change_of(cfg: LanesConfig, before: LaneChange, state: LanesState) -> LaneChange:
    """The side on which the car is partly over a line while it changes lanes; ``before`` is the last frame's."""
    known = {side: b for side in SIDES if (b := state.side(side)) is not None and _runs_along(b)}
    over = {side: b for side, b in known.items() if outward(side) * b.offset_m < cfg.car_width_m / 2}
    if before != "none":
        return before if over else "none"
    return next((side for side, b in over.items() if outward(side) * b.track.rate_mps < 0), "none")


def _runs_along(boundary: TrackedBoundary) -> bool:
    """Whether the car moves along a boundary, and does not turn across it."""
    return abs(float(boundary.track.state[1])) < _ALONG


def _far_edge(
    cfg: LanesConfig, side: Side, crossed: TrackedBoundary, observation: Observation | None
) -> tuple[float, Curve | None]:
    """Width of a boundary's marking to its outer edge, metres, and the curve of that edge if it is visible."""
    if observation is not None:
        line = crossed.track.state + outward(side) * _MARKING_M * _LINE_STEP
        curve = observation.curve_along(cfg, other_side(side), line)
        width_m = 0.0 if curve is None else outward(side) * (float(curve.state[0]) - crossed.offset_m)
        if 0.0 < width_m < _DOUBLE_M:
            return width_m, curve
    return _MARKING_M, None
