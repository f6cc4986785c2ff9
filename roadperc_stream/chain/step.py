"""The perception chain of one frame: ``observe`` its pixels, ``localise`` the car, ``perceive`` what is on the road."""

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from roadperc_stream.chain import pixels
from roadperc_stream.chain.frozen_image import FROZEN, ImageRepeats
from roadperc_stream.chain.own_stage import NO_OWN, OwnStages
from roadperc_stream.chain.protocols import LanesStage, ObjectsStage, OdometryStage, StereoStage, SurfaceStage
from roadperc_stream.chain.road_pitch import known_pitch
from roadperc_stream.chain.stage_runner import Stages, Timer, off
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
    drivable_mask,
    find_surface,
    or_assumed,
    remember,
)
from roadperc_stream.config import ReplayConfig
from roadperc_stream.geometry import inverse, transform_plane
from roadperc_stream.geometry.rectification import is_rectified
from roadperc_stream.model import Absent, Frame, FrameResult, Image, Mask, Objects, Odometry, Reason, Surface
from roadperc_stream.model.results import StereoDepth
from roadperc_stream.model.scene import DepthMap, Scene
from roadperc_stream.system.threads import opencv_threads
from roadperc_stream.system.time import LONGEST_PAUSE_NS

_TURNED: Final = np.deg2rad(0.5)
"""Turn of an assumed plane that moves a boundary 10 m ahead by a tenth of a metre, more than its standard deviation."""
_MATCHING_THREADS: Final = 2
"""More threads of OpenCV hardly make stereo matching faster."""
if TYPE_CHECKING:  # the built-in stages have the signatures that stages of the user's own must have
    _match: StereoStage = stereo.match
    _find: SurfaceStage[SurfaceState] = find_surface
    _follow: OdometryStage[OdometryState] = ego_motion.step
    _see: LanesStage[LanesState] = ego_lane.step
    _track: ObjectsStage[ObjectsState] = tracker.step


@dataclass(frozen=True)
class ChainState:
    """What the chain keeps between frames; bytes are the encoded state of a stage of the user's own."""

    stamp_ns: int | None = None
    surface: SurfaceState | bytes = field(default_factory=SurfaceState)
    odometry: OdometryState | bytes = field(default_factory=OdometryState)
    lanes: LanesState | bytes = field(default_factory=LanesState)
    objects: ObjectsState | bytes = field(default_factory=ObjectsState)
    repeats: ImageRepeats = field(default_factory=ImageRepeats)


@dataclass(frozen=True)
class LocalisedFrame:
    """A frame after surface and odometry: the road below the car and the car's motion.

    ``state`` is the chain's state after these two stages; its lanes and objects are unchanged. ``front_road`` is the
    road with its plane in the frame of the front camera. ``on_other_plane`` is true if the pitch
    became known or unknown, or has another source, and so the plane differs from that of the last frame. ``pitch`` is
    None with depth, or if it is unknown.
    """

    scene: Scene
    state: ChainState
    motion: Odometry | Absent
    road: Surface | Absent
    front_road: Surface | Absent
    drivable: Mask | Absent
    problems: tuple[Reason, ...]
    on_other_plane: bool = False
    pitch: KnownPitch | None = None


def step(
    cfg: ReplayConfig, state: ChainState, frame: Frame, timer: Timer = nullcontext, own: OwnStages = NO_OWN
) -> tuple[ChainState, FrameResult]:
    """Run all enabled stages on one frame, in the order of their dependencies; ``own`` ones replace built-in ones.

    Pure: the same configuration, state and frame give the same result, bit for bit. The timer's readings are not part
    of it. The configuration's seed and the frame's stamp seed the random numbers.
    """
    scene = observe(cfg, frame, timer, own=own)
    localised = localise(cfg, state, scene, timer, own)
    return perceive(cfg, state, localised, timer, own)


def observe(
    cfg: ReplayConfig, frame: Frame, timer: Timer = nullcontext, threads: int = 1, own: OwnStages = NO_OWN
) -> Scene:
    """Decode what the enabled stages need, and match the stereo pair. This part of the chain needs no state.

    With two or more ``threads`` OpenCV matches in half the time, with the same bits.
    """
    stages, undecodable, problems = Stages(cfg, timer, own, frame), list[Reason](), list[Reason]()
    camera = frame.camera
    tags = sensor = instances = grey = depth = None
    with timer("decode"):
        if pixels.needs_scene(cfg):
            tags = pixels.decoded("segmentation", frame.segmentation, lambda image: image.tags, camera, undecodable)
            sensor = pixels.sensor_depth(frame, undecodable)
        if cfg.objects.enabled:
            instances = pixels.decoded("instances", frame.instances, lambda image: image.ids, camera, undecodable)
        if own or pixels.needs_grey(cfg, frame):
            grey = pixels.grey_of("image", frame.image, camera, undecodable)
    matched = stages.run("stereo", lambda: _stereo(stages, frame, grey, problems, threads), off("stereo"))
    with timer("decode"):
        if pixels.needs_scene(cfg):
            depth = _best_depth(frame, sensor, matched, problems)
    return Scene(
        frame.stamp_ns,
        camera,
        frame.ego_T_camera,
        mounted=frame.mounted,
        is_origin=frame.is_origin,
        tags=tags,
        table=frame.segmentation.table if frame.segmentation else None,
        image=frame.image,
        grey=grey,
        depth=depth,
        stereo=matched,
        detections=frame.detections,
        instances=instances,
        undecodable=tuple(undecodable),
        problems=tuple(problems),
        number=frame.number,
        pose_mark=frame.pose_mark,
    )


def localise(
    cfg: ReplayConfig, state: ChainState, scene: Scene, timer: Timer = nullcontext, own: OwnStages = NO_OWN
) -> LocalisedFrame:
    """Find the road and the car's motion. Use only stamp, surface, odometry and repeats of the state."""
    stages = Stages(cfg, timer, own, scene)
    last, _ = _in_order(state, scene.stamp_ns)
    rng = np.random.default_rng((cfg.seed, scene.stamp_ns % 2**63))
    surfaces, found = stages.step("surface", find_surface, last.surface, scene, rng)
    is_built_in = cfg.surface.enabled and "surface" not in own
    seen = or_assumed(scene, found) if is_built_in else found
    metric_road = _metric_road(scene, _in_front_camera(scene, seen))
    repeats = last.repeats
    if cfg.odometry.enabled:
        with timer("odometry"):
            repeats = repeats.after(scene)
    moved, motion = (
        (last.odometry, FROZEN)
        if repeats.is_frozen
        else stages.step("odometry", ego_motion.step, last.odometry, scene, metric_road, rng)
    )
    metric, pitch = _metric_motion(motion, last.stamp_ns), None
    last_T_this = None if metric is None else metric.step
    kept, road, held = surfaces, found, tuple[Reason, ...]()
    if is_built_in and isinstance(surfaces, SurfaceState):
        with timer("surface"):
            pitch = known_pitch(cfg, surfaces, moved, scene, last.stamp_ns)
            kept, road, held = remember(cfg.surface, surfaces, scene, found, last_T_this, pitch)
            kept = replace(kept, pitch=pitch)
    front_road = _in_front_camera(scene, road)
    drivable = stages.run("surface", lambda: drivable_mask(cfg.surface, scene, front_road), off("drivable"))
    state = replace(last, stamp_ns=scene.stamp_ns, surface=kept, odometry=moved, repeats=repeats)
    other_plane = _on_other_plane(road, _last_pitch(last), pitch)
    localised = LocalisedFrame(scene, state, motion, road, front_road, drivable, held, other_plane, pitch)
    return _with_origin_here(localised) if scene.is_origin and last.stamp_ns is not None else localised


def perceive(
    cfg: ReplayConfig, state: ChainState, localised: LocalisedFrame, timer: Timer = nullcontext, own: OwnStages = NO_OWN
) -> tuple[ChainState, FrameResult]:
    """Find what is on the road. Use only stamp, lanes and objects of the state."""
    road, drivable = localised.front_road, localised.drivable
    last, out_of_order = _in_order(state, localised.scene.stamp_ns)
    scene = _with_grey_for_tracks(cfg, last, localised.scene, timer)
    stages = Stages(cfg, timer, own, scene)
    motion = _metric_motion(localised.motion, last.stamp_ns)
    last_T_this = None if motion is None else motion.step
    lanes_state = last.lanes
    if localised.on_other_plane and isinstance(lanes_state, LanesState):
        lanes_state = LanesState(lane_changes=lanes_state.lane_changes)  # its headings do not fit this plane
    lanes_state, found_lanes = stages.step("lanes", ego_lane.step, lanes_state, scene, road, drivable, motion)
    known_lane = None if isinstance(found_lanes, Absent) else found_lanes
    ground = _ground(cfg, localised)
    objects_state, tracked = stages.step("objects", tracker.step, last.objects, scene, known_lane, last_T_this, ground)
    grid = stages.run("occupancy", lambda: occupancy.build(cfg.occupancy, scene, road, drivable), off("occupancy"))
    missing = _missing_inputs(localised, tracked) if pixels.needs_scene(cfg) else ()
    problems = (*out_of_order, *scene.undecodable, *scene.problems, *localised.problems, *_odd_camera(scene), *missing)
    result = FrameResult(
        scene.stamp_ns,
        scene.camera.frame_id,
        surface=localised.road,
        front_surface=road,
        drivable=drivable,
        lanes=found_lanes,
        objects=tracked,
        stereo=scene.stereo,
        odometry=localised.motion,
        occupancy=grid,
        problems=problems,
    )
    return replace(localised.state, lanes=lanes_state, objects=objects_state), result


def _in_order(state: ChainState, stamp_ns: int) -> tuple[ChainState, list[Reason]]:
    """The state, cleared if the stamp begins a new segment, and the problem."""
    last_ns = state.stamp_ns
    if last_ns is None or 0 < stamp_ns - last_ns <= LONGEST_PAUSE_NS:
        return state, []
    code = "time_jumped" if stamp_ns > last_ns else "time_went_back"
    return ChainState(), [Reason("time", code, (last_ns, stamp_ns))]


def _with_origin_here(localised: LocalisedFrame) -> LocalisedFrame:
    """The frame with odom at its ego frame: its pose is exactly the identity."""
    if isinstance(localised.state.odometry, bytes):
        return localised  # an own stage begins odom by itself
    moved = counted_from_here(localised.state.odometry)
    motion = localised.motion
    motion = motion if isinstance(motion, Absent) else replace(motion, odom_T_ego=moved.odom_T_ego)
    return replace(localised, state=replace(localised.state, odometry=moved), motion=motion)


def _best_depth(
    frame: Frame, sensor: DepthMap | None, matched: StereoDepth | Absent, problems: list[Reason]
) -> DepthMap | None:
    """The depth camera's depth, else stereo's, else the lidar's few points."""
    if sensor is not None:
        return sensor
    if isinstance(matched, StereoDepth):
        return DepthMap(matched.depth_m, frame.left_camera, frame.ego_T_left, np.inf, "stereo")
    return pixels.lidar_depth(frame, problems)


def _in_front_camera(scene: Scene, road: Surface | Absent) -> Surface | Absent:
    """The road with its plane in the frame of the front camera."""
    depth = scene.depth
    if isinstance(road, Absent) or depth is None or road.frame_id == scene.camera.frame_id:
        return road
    return replace(road, plane=transform_plane(inverse(scene.ego_T_camera) @ depth.ego_T_camera, road.plane))


def _metric_road(scene: Scene, front_road: Surface | Absent) -> Surface | None:
    """The road, which gives odometry its scale; None if neither depth nor the mounting gives its height."""
    if isinstance(front_road, Absent) or (front_road.source == "assumed" and not scene.mounted):
        return None
    return front_road


def _last_pitch(last: ChainState) -> KnownPitch | None:
    """The pitch in the last frame; None if it was unknown."""
    return None if isinstance(last.surface, bytes) else last.surface.pitch


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


def _ground(cfg: ReplayConfig, localised: LocalisedFrame) -> contact.GroundPlane | None:
    """The road that gives the objects' distances; None with depth."""
    scene, road, pitch = localised.scene, localised.front_road, localised.pitch
    if scene.depth is not None or isinstance(road, Absent):
        return None
    pitch_std = float(np.deg2rad(cfg.odometry.pitch_std_deg) if pitch is None else np.sqrt(pitch.variance))
    return contact.ground_of(road, pitch_std, mounted=scene.mounted)


def _with_grey_for_tracks(cfg: ReplayConfig, state: ChainState, scene: Scene, timer: Timer) -> Scene:
    """The scene with the front camera's pixels if the tracked objects are searched in them."""
    tracks = () if isinstance(state.objects, bytes) else state.objects.tracks
    searches = cfg.objects.enabled and cfg.objects.template_search and bool(tracks)
    was_decoded = scene.grey is not None or any(reason.source == "image" for reason in scene.undecodable)
    if not searches or was_decoded:
        return scene
    undecodable = list(scene.undecodable)
    with timer("decode"):
        grey = pixels.grey_of("image", scene.image, scene.camera, undecodable)
    return replace(scene, grey=grey, undecodable=tuple(undecodable))


def _stereo(
    stages: Stages, frame: Frame, grey: Image | None, problems: list[Reason], threads: int
) -> StereoDepth | Absent:
    """Depth of the stereo pair; its left camera may be the front camera."""
    if frame.right is None:
        return Absent(Reason("stereo", "no_right_image"))
    if frame.right_camera is None:
        return Absent(Reason("stereo", "no_right_calibration"))
    left_grey = grey if pixels.left_is_front(frame) else pixels.grey_of("left", frame.left, frame.left_camera, problems)
    right_grey = pixels.grey_of("right", frame.right, frame.right_camera, problems)
    with opencv_threads(min(threads, _MATCHING_THREADS)):
        return stages.match(frame.left_camera, frame.right_camera, frame.ego_T_left, left_grey, right_grey)


def _odd_camera(scene: Scene) -> Iterator[Reason]:
    """Problems of the front camera's calibration."""
    if not is_rectified(scene.camera):
        yield Reason("image", "not_rectified")
    if not scene.camera.square_pixels:
        yield Reason("image", "pixels_not_square", (scene.camera.fx, scene.camera.fy))


def _missing_inputs(localised: LocalisedFrame, tracked: Objects | Absent) -> Iterator[Reason]:
    """The missing inputs of stages that still have an output."""
    scene, road, pitch = localised.scene, localised.road, localised.pitch
    source = None if isinstance(road, Absent) else road.source
    if scene.depth is None and source != "held":  # a held plane has its own reason
        yield (
            Reason("surface", "no_depth_pitch_estimated", (scene.plane_source, pitch.source))
            if pitch is not None and source == "estimated"
            else Reason("surface", "no_depth_plane_assumed", (scene.plane_source,))
        )
    if scene.depth is not None and scene.tags is None:
        yield Reason("surface", "no_segmentation_lower_image")
    if isinstance(tracked, Objects) and tracked.objects:
        if scene.tags is None:
            yield Reason("objects", "no_segmentation_not_filtered")
        if scene.depth is None:
            known = not isinstance(road, Absent)
            yield Reason("objects", "no_depth_ground_distances" if known else "no_depth_no_distances")
