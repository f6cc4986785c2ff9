"""One frame of the ego lane: observe both boundaries, track them over time, and drop implausible ones."""

from dataclasses import replace

import numpy as np

from roadperc_stream.chain.stages.lanes import following, lines, tracking
from roadperc_stream.chain.stages.lanes.curves import lateral, other_side, outward
from roadperc_stream.chain.stages.lanes.following import JUDGED_AT_M, MAX_STD_M, MIN_WIDTH_M, followed, least_known_m
from roadperc_stream.chain.stages.lanes.observe import Observation, RoadProjection, observe
from roadperc_stream.chain.stages.lanes.tracking import LanesState, TrackedBoundary
from roadperc_stream.config import LanesConfig
from roadperc_stream.geometry import Float
from roadperc_stream.model import SIDES, Absent, Boundary, Lanes, Line, Mask, Odometry, Reason, Side, Surface
from roadperc_stream.model.frame import Frame
from roadperc_stream.system.time import NS_PER_S

_CHORD_AHEAD_M = 15.0
_MAX_WIDTH_M = 7.0
"""Widest lane: boundaries farther apart are not those of one lane."""
_SHORTEST_DRAWN_M = 10.0
_LEVEL_PX = 1e-6
_STEP_M = 1.0
_CERTAIN_STD_M = 0.09
"""Standard deviation ``JUDGED_AT_M`` ahead up to which a boundary needs no confirmation by the other one."""
_PARALLEL_M = 0.3
"""Largest change of the lane's width up to ``JUDGED_AT_M``: wrong tags may turn a boundary out of parallel."""
_TURNED = 0.1
"""If two headings differ by more, the boundary that is turned farther from the car's axis is wrong."""
_ELSEWHERE = frozenset(("camera_changed", "too_few_inliers", "impossible_motion"))
"""Reason codes of lost odometry after which the image may show a different frame than the last one."""


def _boundary(
    side: Side,
    tracked: TrackedBoundary | None,
    reason: Reason | None,
    found: Observation | Absent,
    projection: RoadProjection | None,
) -> Boundary:
    """One side's boundary; ``lost`` with a reason if it is not tracked or cannot be used."""
    raw_px = raw_offset_m = far = None
    if isinstance(found, Absent):
        unseen = found.reason
    else:
        far, unseen = found.far, Reason("lanes", "edges_disagree" if side in found.near else "no_line_near")
        if side in found.near:
            raw_px = lines.drawn(found.near[side][0], found.bottom, far)
            curve = found.curves[side]
            raw_offset_m = None if curve is None else float(curve.state[0])
    if tracked is None and reason is None:
        reason = Reason("lanes", "boundary_lost", (side,), unseen)
    if tracked is None or reason is not None:
        return Boundary(side, "lost", raw_px=raw_px, raw_offset_m=raw_offset_m, reason=reason)
    track = tracked.track
    offset, heading, curvature = (float(value) for value in track.reported_state)
    ahead, pixels = _drawn_curve(tracked, projection)
    return Boundary(
        side,
        "measured" if track.measured_ns == track.stamp_ns else "held",
        raw_px,
        _chord(track.reported_state, projection, far),
        offset,
        heading,
        curvature,
        raw_offset_m,
        tuple(track.reported_covariance.ravel().tolist()),
        tracked.inside.majority,
        tracked.outside.majority,
        ahead,
        pixels,
    )


def _drawn_curve(tracked: TrackedBoundary, projection: RoadProjection | None) -> tuple[Float, Float]:
    """(N, 3) ego points a metre apart on the road, and (M, 2) pixels of those that are in front of the camera.

    The car's own bonnet hides the others.
    """
    if projection is None:
        return np.empty((0, 3)), np.empty((0, 2))
    x = np.arange(max(tracked.reach_m, _SHORTEST_DRAWN_M) + 1)
    points = projection.on_road(x, tracking.lateral_at(tracked.track, x))
    pixels = projection.pixels(points[x >= tracked.hidden_m])
    return points, pixels[np.isfinite(pixels).all(axis=1) & (pixels[:, 1] <= 2 * projection.camera.height)]


def _chord(state: Float, projection: RoadProjection | None, far: float | None) -> Line | None:
    """The smoothed line drawn straight from the image's bottom edge to the road's far end."""
    if projection is None or far is None:
        return None
    bottom, nearest = float(projection.camera.height), projection.nearest_m
    if not np.isfinite(nearest):
        return None
    x = np.array([nearest, max(nearest + 1.0, _CHORD_AHEAD_M)])
    (u1, v1), (u2, v2) = projection.pixels(projection.on_road(x, lateral(state, x)))
    if not abs(v2 - v1) > _LEVEL_PX:
        return None
    slope = (u2 - u1) / (v2 - v1)
    return float(u1 + slope * (bottom - v1)), bottom, float(u1 + slope * (far - v1)), far


def without_implausible(state: LanesState) -> tuple[LanesState, dict[Side, Reason]]:
    """The state, without the worse boundary if the two contradict each other, and the reason."""
    if state.left is None or state.right is None:
        return state, {}
    side: Side = "left" if _worse(state.left, state.right) else "right"
    reason = _contradiction(side, state.left, state.right)
    if reason is None:
        return state, {}
    return state.with_side(side, None), {side: reason}


def unusable(state: LanesState) -> dict[Side, Reason]:
    """The tracked boundaries that cannot be used in this frame, each with its reason."""
    reasons = {side: _fault(state, side, tracked) for side in SIDES if (tracked := state.side(side))}
    return {side: reason for side, reason in reasons.items() if reason is not None}


def _fault(state: LanesState, side: Side, tracked: TrackedBoundary) -> Reason | None:
    if outward(side) * tracked.offset_m <= 0:
        return Reason("lanes", "car_on_boundary", (side,))
    if not tracked.is_sure:
        at_m = least_known_m(tracked)
        std_m = tracking.std_at(tracked.track, at_m)
        return Reason("lanes", "boundary_uncertain", (side, at_m, round(std_m, 2), MAX_STD_M))
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


def _contradiction(side: Side, left: TrackedBoundary, right: TrackedBoundary) -> Reason | None:
    width_m = left.offset_m - right.offset_m
    if not MIN_WIDTH_M <= width_m <= _MAX_WIDTH_M:
        return Reason("lanes", "lane_width", (side, round(width_m, 2), MIN_WIDTH_M, _MAX_WIDTH_M))
    reach_m = min(left.reach_m, right.reach_m)
    x = np.append(np.arange(0.0, reach_m, _STEP_M), reach_m)
    crossed: Float = x[lateral(left.track.state - right.track.state, x) <= 0]
    return Reason("lanes", "boundaries_cross", (side, float(crossed[0]))) if len(crossed) else None


def _worse(left: TrackedBoundary, right: TrackedBoundary) -> bool:
    """Whether the left boundary is the worse one: turned more, measured longer ago, or less certain."""
    turned = abs(float(left.track.state[1])) - abs(float(right.track.state[1]))
    if abs(turned) > _TURNED:
        return turned > 0
    if left.track.measured_ns != right.track.measured_ns:
        return left.track.measured_ns < right.track.measured_ns
    return tracking.std_at(left.track, JUDGED_AT_M) > tracking.std_at(right.track, JUDGED_AT_M)


def step(
    cfg: LanesConfig,
    state: LanesState,
    frame: Frame,
    surface: Surface | Absent,
    drivable: Mask | Absent,
    motion: Odometry | None,
) -> tuple[LanesState, Lanes | Absent]:
    """Measure the ego lane in one frame and filter it over time.

    Without tags, boundaries are held. ``surface`` is in the front camera's frame, ``drivable`` is (H, W). ``motion`` is
    that of the ego frame since the last frame, in metres, or lost; None if it is unknown.

    Returns:
        The new state and the lanes; lanes are absent if no boundary is observed or held.
    """
    found = _observed(cfg, frame, surface, drivable)
    observation = None if isinstance(found, Absent) else found
    after = _followed(cfg, _remembered(cfg, state, motion, frame.stamp_ns), motion, observation, frame.stamp_ns)
    after = following.handed_over(cfg, after, observation, frame.stamp_ns)
    after, implausible = without_implausible(after)
    after = replace(after, lane_change=following.change_of(cfg, after.lane_change, after))
    if isinstance(found, Absent) and after.left is None and after.right is None:
        return after, found
    reasons = implausible | unusable(after)
    projection = None if isinstance(surface, Absent) else RoadProjection(frame.camera, frame.ego_T_camera, surface)
    boundaries = tuple(_boundary(side, after.side(side), reasons.get(side), found, projection) for side in SIDES)
    lanes = Lanes(boundaries, lane_change=after.lane_change, lane_changes=after.lane_changes)
    if observation is None:
        return after, lanes
    merged = [lines.drawn(group, float(frame.camera.height), observation.far) for group in observation.groups]
    merged_px = np.array(merged).reshape(-1, 4)
    return after, replace(lanes, proposals_px=observation.proposals, merged_px=merged_px, edges=observation.edge_pixels)


def _remembered(cfg: LanesConfig, state: LanesState, motion: Odometry | None, stamp_ns: int) -> LanesState:
    """The state, cleared if the frame changed or the motion was unknown for more than ``lanes.hold_s``."""
    known = [boundary.track.stamp_ns for side in SIDES if (boundary := state.side(side)) is not None]
    gap_s = (stamp_ns - max(known)) / NS_PER_S if known else 0.0
    elsewhere = motion is not None and motion.reason is not None and motion.reason.code in _ELSEWHERE
    if elsewhere or (_tracked(motion) is None and gap_s > cfg.hold_s):
        return LanesState(lane_changes=state.lane_changes)
    return state


def _tracked(motion: Odometry | None) -> Odometry | None:
    """The motion if it has a step and a covariance, else None."""
    return motion if motion is not None and motion.step is not None and motion.covariance else None


def _followed(
    cfg: LanesConfig, state: LanesState, motion: Odometry | None, observation: Observation | None, stamp_ns: int
) -> LanesState:
    """Both boundaries at the stamp of this frame."""
    moved = _tracked(motion) if cfg.use_odometry else None

    def predicted(boundary: TrackedBoundary) -> TrackedBoundary:
        return replace(boundary, track=tracking.predict(cfg, boundary.track, stamp_ns, moved))

    before = {side: predicted(boundary) for side in SIDES if (boundary := state.side(side))}
    certain: dict[Side, TrackedBoundary | None] = {"left": state.left_certain, "right": state.right_certain}
    expected = {
        side: before[side] if last is state.side(side) else predicted(last)  # often they are the same
        for side, last in certain.items()
        if last is not None and moved is not None
    }
    found = {
        side: followed(cfg, side, before.get(side), before.get(other_side(side)), observation, stamp_ns)
        for side in SIDES
    }
    now, known = following.without_other_lines(cfg, before, found, expected, stamp_ns)
    left, right = now["left"], now["right"]
    return replace(state, left=left, right=right, left_certain=known.get("left"), right_certain=known.get("right"))


def _observed(
    cfg: LanesConfig, frame: Frame, surface: Surface | Absent, drivable: Mask | Absent
) -> Observation | Absent:
    if frame.tags is None or frame.table is None:
        return Absent(Reason("lanes", "no_segmentation"))
    if isinstance(surface, Absent):
        return Absent(Reason("lanes", "no_surface", cause=surface.reason))
    if isinstance(drivable, Absent):
        return Absent(Reason("lanes", "no_drivable_surface", cause=drivable.reason))
    projection = RoadProjection(frame.camera, frame.ego_T_camera, surface)
    return observe(cfg, projection, frame.tags, frame.table, drivable)
