"""One frame of the ego lane: observe both boundaries, then track them over time."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from roadperc_stream.chain.stages.lanes import lane_change, lines, plausibility
from roadperc_stream.chain.stages.lanes.drawing import boundary_of
from roadperc_stream.chain.stages.lanes.following import followed, predicted
from roadperc_stream.chain.stages.lanes.memory import LanesState
from roadperc_stream.chain.stages.lanes.observe import Observation, RoadProjection, observe
from roadperc_stream.chain.stages.lanes.sides import other_side
from roadperc_stream.core.config import LanesConfig
from roadperc_stream.core.datatypes import SIDES, Absent, Boundary, Lanes, Mask, Odometry, Reason, Side, Surface
from roadperc_stream.core.scene import Scene
from roadperc_stream.core.time import NS_PER_S

_ELSEWHERE = frozenset(("camera_changed", "too_few_inliers", "impossible_motion"))
"""Why odometry is lost where the image, as far as anyone knows, shows another scene than the last one."""


def step(
    cfg: LanesConfig,
    state: LanesState,
    scene: Scene,
    surface: Surface | Absent,
    drivable: Mask | Absent,
    motion: Odometry | None,
) -> tuple[LanesState, Lanes | Absent]:
    """Measure the ego lane in one frame and filter it over time.

    Args:
        cfg: thresholds.
        state: what the last frame left.
        scene: the frame; without tags what is known is held.
        surface: the road in the front camera's frame.
        drivable: (H, W) drivable surface.
        motion: of the ego frame since the last frame, in metres, or that it is lost; None where it is not known.

    Returns:
        The new state, and the lanes: absent where nothing could be observed and nothing is held.
    """
    found = _observed(cfg, scene, surface, drivable)
    observation = None if isinstance(found, Absent) else found
    after = _followed(cfg, _remembered(cfg, state, motion, scene.stamp_ns), motion, observation, scene.stamp_ns)
    after = lane_change.handed_over(cfg, after, observation, scene.stamp_ns)
    after, implausible = plausibility.without_implausible(cfg, after)
    after = replace(after, lane_change=lane_change.change_of(cfg, after.lane_change, after))
    if isinstance(found, Absent) and after.left is None and after.right is None:
        return after, found
    reasons = implausible | plausibility.unusable(cfg, after)
    projection = None if isinstance(surface, Absent) else RoadProjection(scene.camera, scene.ego_T_camera, surface)
    boundaries = _boundaries(after, found, reasons, projection)
    lanes = Lanes(boundaries, lane_change=after.lane_change, lane_changes=after.lane_changes)
    if observation is None:
        return after, lanes
    merged = [lines.drawn(group, float(scene.camera.height), observation.far) for group in observation.groups]
    merged_px = np.array(merged).reshape(-1, 4)
    return after, replace(lanes, proposals_px=observation.proposals, merged_px=merged_px, edges=observation.edge_pixels)


def _remembered(cfg: LanesConfig, state: LanesState, motion: Odometry | None, stamp_ns: int) -> LanesState:
    """What still holds: of another scene, and after seconds in which nobody knows how the car moved, nothing."""
    known = [boundary.track.stamp_ns for side in SIDES if (boundary := state.side(side)) is not None]
    gap_s = (stamp_ns - max(known)) / NS_PER_S if known else 0.0
    elsewhere = motion is not None and motion.reason is not None and motion.reason.code in _ELSEWHERE
    if elsewhere or (_tracked(motion) is None and gap_s > cfg.hold_s):
        return LanesState(lane_changes=state.lane_changes)
    return state


def _tracked(motion: Odometry | None) -> Odometry | None:
    """A motion that can be used: one with its covariance."""
    return motion if motion is not None and motion.step is not None and motion.covariance else None


def _followed(
    cfg: LanesConfig, state: LanesState, motion: Odometry | None, observation: Observation | None, stamp_ns: int
) -> LanesState:
    """Both boundaries at this frame's time."""
    moved = _tracked(motion) if cfg.use_odometry else None
    before = {side: predicted(cfg, state.side(side), moved, stamp_ns) for side in SIDES}
    left, right = (followed(cfg, side, before[side], before[other_side(side)], observation, stamp_ns) for side in SIDES)
    return replace(state, left=left, right=right)


def _boundaries(
    state: LanesState,
    found: Observation | Absent,
    reasons: Mapping[Side, Reason],
    projection: RoadProjection | None,
) -> tuple[Boundary, ...]:
    """Both as the result has them, lost ones with their reason."""
    observation = None if isinstance(found, Absent) else found
    boundaries = []
    for side in SIDES:
        tracked = state.side(side)
        reason = reasons.get(side)
        if reason is None and tracked is None:
            reason = Reason("lanes", "boundary_lost", (side,), _why_unseen(side, found))
        given = reason if reason is not None else tracked
        assert given is not None
        boundaries.append(boundary_of(side, given, observation, projection))
    return tuple(boundaries)


def _why_unseen(side: Side, found: Observation | Absent) -> Reason:
    """Why a frame shows no boundary on a side."""
    if isinstance(found, Absent):
        return found.reason
    return Reason("lanes", "edges_disagree" if side in found.boundaries else "no_line_near")


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
