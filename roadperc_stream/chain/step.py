"""The perception chain: one step takes a prepared frame from the state after the last frame to its results."""

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from roadperc_stream.chain.frozen_image import FROZEN, ImageRepeats
from roadperc_stream.chain.own_stage import NO_OWN, OwnStages
from roadperc_stream.chain.protocols import LanesStage, ObjectsStage, OdometryStage, StereoStage, SurfaceStage
from roadperc_stream.chain.road_pitch import known_pitch
from roadperc_stream.chain.stage_runner import Stages, Timer, needs_scene, off
from roadperc_stream.chain.stages import occupancy, stereo
from roadperc_stream.chain.stages.lanes import ego_lane
from roadperc_stream.chain.stages.lanes.tracking import LanesState
from roadperc_stream.chain.stages.objects import contact, tracker
from roadperc_stream.chain.stages.objects.tracker import ObjectsState
from roadperc_stream.chain.stages.odometry import ego_motion
from roadperc_stream.chain.stages.odometry.keyframes import OdometryState, counted_from_here
from roadperc_stream.chain.stages.surface.road import (
    KnownPitch,
    SurfaceState,
    choose_road,
    drivable_mask,
    find_surface,
    or_assumed,
)
from roadperc_stream.config import ReplayConfig
from roadperc_stream.geometry import inverse, transform_plane
from roadperc_stream.geometry.rectification import is_rectified
from roadperc_stream.model import Absent, Frame, FrameResult, Objects, Odometry, Reason, Surface
from roadperc_stream.system.time import LONGEST_PAUSE_NS

_TURNED: Final = np.deg2rad(0.5)
"""Turn of an assumed plane that moves a boundary 10 m ahead by a tenth of a metre, more than its standard deviation."""
if TYPE_CHECKING:  # the built-in stages have the signatures that stages of the user's own must have
    _match: StereoStage = stereo.match
    _find: SurfaceStage[SurfaceState] = find_surface
    _follow: OdometryStage[OdometryState] = ego_motion.step
    _see: LanesStage[LanesState] = ego_lane.step
    _track: ObjectsStage[ObjectsState] = tracker.step


@dataclass(frozen=True)
class State:
    """What the chain keeps between frames; bytes are the encoded state of a stage of the user's own.

    ``pitch`` is that of the front camera in the last frame, known from motion or lanes; None with depth, or if unknown.
    """

    stamp_ns: int | None = None
    surface: SurfaceState | bytes = field(default_factory=SurfaceState)
    repeats: ImageRepeats = field(default_factory=ImageRepeats)
    odometry: OdometryState | bytes = field(default_factory=OdometryState)
    pitch: KnownPitch | None = None
    lanes: LanesState | bytes = field(default_factory=LanesState)
    objects: ObjectsState | bytes = field(default_factory=ObjectsState)


def step(
    cfg: ReplayConfig, state: State, frame: Frame, timer: Timer = nullcontext, own: OwnStages = NO_OWN
) -> tuple[State, FrameResult]:
    """Run all enabled stages on a prepared frame, in the order of their dependencies.

    ``own`` stages replace built-in ones.

    Pure: the same configuration, state and frame give the same result, bit for bit. The timer's readings are not part
    of it. The configuration's seed and the frame's stamp seed the random numbers.
    """
    stages = Stages(cfg, timer, own, frame)
    last, out_of_order = _in_order(state, frame.stamp_ns)
    rng = np.random.default_rng((cfg.seed, frame.stamp_ns % 2**63))

    # Surface: the road that the frame's depth shows, in the frame of its camera, or that of the mounting.
    surface_state, found = stages.step("surface", find_surface, last.surface, frame, rng)
    is_built_in = cfg.surface.enabled and "surface" not in own
    seen = or_assumed(frame, found) if is_built_in else found

    # Odometry, with its scale from the road: not of an image that repeats while the car moves.
    repeats = last.repeats
    if cfg.odometry.enabled:
        with timer("odometry"):
            repeats = repeats.after(frame)
    known_road = _with_known_height(frame, _in_front_camera(frame, seen))
    odometry_state, motion = (
        (last.odometry, FROZEN)
        if repeats.is_frozen
        else stages.step("odometry", ego_motion.step, last.odometry, frame, known_road, rng)
    )
    if frame.is_origin and last.stamp_ns is not None and not isinstance(odometry_state, bytes):
        odometry_state, motion = _with_origin_here(odometry_state, motion)  # an own stage begins odom by itself
    metric = _metric_motion(motion, last.stamp_ns)
    last_T_this = None if metric is None else metric.step

    # Pitch: without depth the motion or the lanes may show it. Then the road is chosen: measured, held or assumed.
    pitch, road, held = None, found, tuple[Reason, ...]()
    if is_built_in and isinstance(surface_state, SurfaceState):
        with timer("surface"):
            pitch = known_pitch(cfg, surface_state, odometry_state, frame, last.stamp_ns)
            surface_state, road, held = choose_road(cfg.surface, surface_state, frame, found, last_T_this, pitch)
    front_road = _in_front_camera(frame, road)
    drivable = stages.run("surface", lambda: drivable_mask(cfg.surface, frame, front_road), off("drivable"))

    # Lanes: after a turn of the road's plane their headings do not fit it.
    lanes_state = last.lanes
    if _on_other_plane(road, last.pitch, pitch) and isinstance(lanes_state, LanesState):
        lanes_state = LanesState(lane_changes=lanes_state.lane_changes)
    lanes_state, found_lanes = stages.step("lanes", ego_lane.step, lanes_state, frame, front_road, drivable, metric)

    # Objects, with distances from depth, else from the road.
    lane = None if isinstance(found_lanes, Absent) else found_lanes
    ground = _ground(cfg, frame, front_road, pitch)
    objects_state, tracked = stages.step("objects", tracker.step, last.objects, frame, lane, last_T_this, ground)

    grid = stages.run(
        "occupancy", lambda: occupancy.build(cfg.occupancy, frame, front_road, drivable), off("occupancy")
    )
    missing = _missing_inputs(frame, road, pitch, tracked) if needs_scene(cfg) else ()
    result = FrameResult(
        frame.stamp_ns,
        frame.camera.frame_id,
        surface=road,
        front_surface=front_road,
        drivable=drivable,
        lanes=found_lanes,
        objects=tracked,
        stereo=frame.stereo,
        odometry=motion,
        occupancy=grid,
        problems=(*out_of_order, *frame.problems, *held, *_odd_camera(frame), *missing),
    )
    state = State(
        frame.stamp_ns,
        surface=surface_state,
        repeats=repeats,
        odometry=odometry_state,
        pitch=pitch,
        lanes=lanes_state,
        objects=objects_state,
    )
    return state, result


def _in_order(state: State, stamp_ns: int) -> tuple[State, list[Reason]]:
    """The state, cleared if the stamp begins a new segment, and the problem."""
    last_ns = state.stamp_ns
    if last_ns is None or 0 < stamp_ns - last_ns <= LONGEST_PAUSE_NS:
        return state, []
    code = "time_jumped" if stamp_ns > last_ns else "time_went_back"
    return State(), [Reason("time", code, (last_ns, stamp_ns))]


def _with_origin_here(state: OdometryState, motion: Odometry | Absent) -> tuple[OdometryState, Odometry | Absent]:
    """State and motion with odom at the ego frame of this frame: its pose is exactly the identity."""
    moved = counted_from_here(state)
    return moved, motion if isinstance(motion, Absent) else replace(motion, odom_T_ego=moved.odom_T_ego)


def _in_front_camera(frame: Frame, road: Surface | Absent) -> Surface | Absent:
    """The road with its plane in the frame of the front camera."""
    if isinstance(road, Absent) or road.frame_id == frame.camera.frame_id:
        return road
    camera_T_depth = inverse(frame.ego_T_camera) @ frame.ego_T_depth_camera
    return replace(road, plane=transform_plane(camera_T_depth, road.plane))


def _with_known_height(frame: Frame, front_road: Surface | Absent) -> Surface | None:
    """The road, which gives odometry its scale; None if neither depth nor the mounting gives its height."""
    if isinstance(front_road, Absent) or (front_road.source == "assumed" and not frame.mounted):
        return None
    return front_road


def _on_other_plane(road: Surface | Absent, before: KnownPitch | None, now: KnownPitch | None) -> bool:
    """Whether the plane of a road without depth has turned because the pitch has another source, or none."""
    sources = before and before.source, now and now.source
    if isinstance(road, Absent) or road.source not in ("assumed", "estimated") or sources[0] == sources[1]:
        return False
    return bool(abs((before.offset if before else 0.0) - (now.offset if now else 0.0)) > _TURNED)


def _metric_motion(motion: Odometry | Absent, since_ns: int | None) -> Odometry | None:
    """The motion if it is lost, or if it is in metres and begins at the last frame; else None."""
    if isinstance(motion, Absent) or motion.status == "first" or motion.up_to_scale:
        return None
    return motion if motion.status == "lost" or motion.since_ns == since_ns else None


def _ground(
    cfg: ReplayConfig, frame: Frame, front_road: Surface | Absent, pitch: KnownPitch | None
) -> contact.GroundPlane | None:
    """The road that gives the objects' distances; None with depth."""
    if frame.raw_depth_m is not None or isinstance(front_road, Absent):
        return None
    pitch_std = float(np.deg2rad(cfg.odometry.pitch_std_deg) if pitch is None else np.sqrt(pitch.variance))
    return contact.ground_of(front_road, pitch_std, mounted=frame.mounted)


def _odd_camera(frame: Frame) -> Iterator[Reason]:
    """Problems of the front camera's calibration."""
    if not is_rectified(frame.camera):
        yield Reason("image", "not_rectified")
    if not frame.camera.square_pixels:
        yield Reason("image", "pixels_not_square", (frame.camera.fx, frame.camera.fy))


def _missing_inputs(
    frame: Frame, road: Surface | Absent, pitch: KnownPitch | None, tracked: Objects | Absent
) -> Iterator[Reason]:
    """The missing inputs of stages that still have an output."""
    source = None if isinstance(road, Absent) else road.source
    if frame.raw_depth_m is None and source != "held":  # a held plane has its own reason
        yield (
            Reason("surface", "no_depth_pitch_estimated", (frame.plane_source, pitch.source))
            if pitch is not None and source == "estimated"
            else Reason("surface", "no_depth_plane_assumed", (frame.plane_source,))
        )
    if frame.raw_depth_m is not None and frame.tags is None:
        yield Reason("surface", "no_segmentation_lower_image")
    if isinstance(tracked, Objects) and tracked.objects:
        if frame.tags is None:
            yield Reason("objects", "no_segmentation_not_filtered")
        if frame.raw_depth_m is None:
            known = not isinstance(road, Absent)
            yield Reason("objects", "no_depth_ground_distances" if known else "no_depth_no_distances")
