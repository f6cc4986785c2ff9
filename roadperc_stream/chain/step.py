"""The perception chain of one frame: ``observe`` its pixels, ``localise`` the car, ``perceive`` what is on the road."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Final, TypeVar

import numpy as np

from roadperc_stream.chain import pixels
from roadperc_stream.chain.stages import occupancy, stereo
from roadperc_stream.chain.stages.lanes import ego_lane
from roadperc_stream.chain.stages.lanes.tracking import LanesState
from roadperc_stream.chain.stages.objects import contact, tracker
from roadperc_stream.chain.stages.objects.tracker import ObjectsState
from roadperc_stream.chain.stages.odometry import ego_motion
from roadperc_stream.chain.stages.odometry.keyframes import OdometryState, counted_from_here
from roadperc_stream.chain.stages.surface.road import SurfaceState, drivable_mask, find_surface, remember
from roadperc_stream.config import ReplayConfig
from roadperc_stream.geometry import inverse, transform_plane
from roadperc_stream.model import Absent, Frame, FrameResult, Image, Mask, Objects, Odometry, Reason, Surface
from roadperc_stream.model.results import StereoDepth
from roadperc_stream.model.scene import DepthMap, Scene
from roadperc_stream.system.threads import opencv_threads

T = TypeVar("T")
U = TypeVar("U")
_MATCHING_THREADS: Final = 2
"""More threads of OpenCV hardly make stereo matching faster."""
Timer = Callable[[str], AbstractContextManager[object]]
"""Called with a stage's name; the context it returns is active while the stage runs."""


@dataclass(frozen=True)
class ChainState:
    """What the chain keeps between frames."""

    stamp_ns: int | None = None
    surface: SurfaceState = field(default_factory=SurfaceState)
    odometry: OdometryState = field(default_factory=OdometryState)
    lanes: LanesState = field(default_factory=LanesState)
    objects: ObjectsState = field(default_factory=ObjectsState)


@dataclass(frozen=True)
class LocalisedFrame:
    """A frame after surface and odometry: the road below the car and the car's motion.

    ``state`` is the chain's state after these two stages; its lanes and objects are unchanged. ``front_road`` is the
    road with its plane in the frame of the front camera.
    """

    scene: Scene
    state: ChainState
    motion: Odometry | Absent
    road: Surface | Absent
    front_road: Surface | Absent
    drivable: Mask | Absent
    problems: tuple[Reason, ...]


def step(
    cfg: ReplayConfig, state: ChainState, frame: Frame, timer: Timer = nullcontext
) -> tuple[ChainState, FrameResult]:
    """Run all enabled stages on one frame, in the order of their dependencies.

    Pure: the same configuration, state and frame give the same result, bit for bit. The timer's readings are not part
    of it. The configuration's seed and the frame's stamp seed the random numbers.
    """
    scene = observe(cfg, frame, timer)
    localised = localise(cfg, state, scene, timer)
    return perceive(cfg, state, localised, timer)


def observe(cfg: ReplayConfig, frame: Frame, timer: Timer = nullcontext, threads: int = 1) -> Scene:
    """Decode what the enabled stages need, and match the stereo pair. This part of the chain needs no state.

    With two or more ``threads`` OpenCV matches in half the time, with the same bits.
    """
    stages, undecodable, problems = _EnabledStages(cfg, timer), list[Reason](), list[Reason]()
    camera = frame.camera
    tags = sensor = instances = grey = depth = None
    with timer("decode"):
        if pixels.needs_scene(cfg):
            tags = pixels.decoded("segmentation", frame.segmentation, lambda image: image.tags, camera, undecodable)
            sensor = pixels.sensor_depth(frame, undecodable)
        if cfg.objects.enabled:
            instances = pixels.decoded("instances", frame.instances, lambda image: image.ids, camera, undecodable)
        if pixels.needs_grey(cfg, frame):
            grey = pixels.grey_of("image", frame.image, camera, undecodable)
    matched = stages.run("stereo", lambda: _stereo(cfg, frame, grey, problems, threads), _off("stereo"))
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
    )


def localise(cfg: ReplayConfig, state: ChainState, scene: Scene, timer: Timer = nullcontext) -> LocalisedFrame:
    """Find the road and the car's motion. Use only stamp, surface and odometry of the state."""
    stages, no_road = _EnabledStages(cfg, timer), _off("surface")
    last, _ = _in_order(state, scene.stamp_ns)
    rng = np.random.default_rng((cfg.seed, scene.stamp_ns % 2**63))
    seen, failed = stages.run("surface", lambda: find_surface(cfg.surface, scene, rng), (no_road, None))
    moved, motion = stages.run(
        "odometry",
        lambda: ego_motion.step(
            cfg.odometry, last.odometry, scene, _metric_road(scene, _in_front_camera(scene, seen)), rng
        ),
        (last.odometry, _off("odometry")),
    )
    metric = _metric_motion(motion, last.stamp_ns)
    last_T_this = None if metric is None else metric.step
    kept, road, held = stages.run(
        "surface",
        lambda: remember(cfg.surface, last.surface, scene, seen, failed, last_T_this, _shown_pitch(moved)),
        (last.surface, no_road, ()),
    )
    front_road = _in_front_camera(scene, road)
    drivable = stages.run("surface", lambda: drivable_mask(cfg.surface, scene, front_road), _off("drivable"))
    state = replace(last, stamp_ns=scene.stamp_ns, surface=kept, odometry=moved)
    localised = LocalisedFrame(scene, state, motion, road, front_road, drivable, held)
    return _with_origin_here(localised) if scene.is_origin and last.stamp_ns is not None else localised


def perceive(
    cfg: ReplayConfig, state: ChainState, localised: LocalisedFrame, timer: Timer = nullcontext
) -> tuple[ChainState, FrameResult]:
    """Find what is on the road. Use only stamp, lanes and objects of the state."""
    stages, road, drivable = _EnabledStages(cfg, timer), localised.front_road, localised.drivable
    last, out_of_order = _in_order(state, localised.scene.stamp_ns)
    scene = _with_grey_for_tracks(cfg, last, localised.scene, timer)
    motion = _metric_motion(localised.motion, last.stamp_ns)
    last_T_this = None if motion is None else motion.step
    lanes_state, found_lanes = stages.run(
        "lanes",
        lambda: ego_lane.step(cfg.lanes, last.lanes, scene, road, drivable, motion),
        (last.lanes, _off("lanes")),
    )
    known_lane = None if isinstance(found_lanes, Absent) else found_lanes
    objects_state, tracked = stages.run(
        "objects",
        lambda: tracker.step(cfg.objects, last.objects, scene, known_lane, last_T_this, _ground(cfg, localised)),
        (last.objects, _off("objects")),
    )
    grid = stages.run("occupancy", lambda: occupancy.build(cfg.occupancy, scene, road, drivable), _off("occupancy"))
    missing = _missing_inputs(scene, localised.road, tracked) if pixels.needs_scene(cfg) else ()
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


@dataclass(frozen=True)
class _EnabledStages:
    """Runs the enabled stages, each timed under its name."""

    cfg: ReplayConfig
    timer: Timer

    def run(self, stage: str, compute: Callable[[], T], otherwise: U) -> T | U:
        """The result of ``compute``, or ``otherwise`` if the stage is switched off."""
        if not getattr(self.cfg, stage).enabled:
            return otherwise
        with self.timer(stage):
            return compute()


def _off(stage: str) -> Absent:
    return Absent(Reason(stage, "switched_off"))


def _in_order(state: ChainState, stamp_ns: int) -> tuple[ChainState, list[Reason]]:
    """The state, cleared if the stamp is not after the last one, and the problem."""
    last_ns = state.stamp_ns
    if last_ns is None or stamp_ns > last_ns:
        return state, []
    if stamp_ns == last_ns:
        return ChainState(), [Reason("time", "time_stood_still", (stamp_ns,))]
    return ChainState(), [Reason("time", "time_went_back", (last_ns, stamp_ns))]


def _with_origin_here(localised: LocalisedFrame) -> LocalisedFrame:
    """The frame with odom at its ego frame: its pose is exactly the identity."""
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
    if isinstance(road, Absent) or depth is None or depth.camera.frame_id == scene.camera.frame_id:
        return road
    return replace(road, plane=transform_plane(inverse(scene.ego_T_camera) @ depth.ego_T_camera, road.plane))


def _metric_road(scene: Scene, front_road: Surface | Absent) -> Surface | None:
    """The road, which gives odometry its scale; None if neither depth nor the mounting gives its height."""
    if isinstance(front_road, Absent) or (front_road.source == "assumed" and not scene.mounted):
        return None
    return front_road


def _shown_pitch(state: OdometryState) -> float | None:
    """The pitch of the camera beyond its mounting, radians, downwards; None if no motion has shown it."""
    return state.pitch.offset if state.pitch is not None and state.pitch.measured else None


def _metric_motion(motion: Odometry | Absent, since_ns: int | None) -> Odometry | None:
    """The motion if it is lost, or if it is in metres and begins at the last frame; else None."""
    if isinstance(motion, Absent) or motion.status == "first" or motion.up_to_scale:
        return None
    return motion if motion.status == "lost" or motion.since_ns == since_ns else None


def _ground(cfg: ReplayConfig, localised: LocalisedFrame) -> contact.GroundPlane | None:
    """The road that gives the objects' distances; None with depth."""
    scene, road, pitch = localised.scene, localised.front_road, localised.state.odometry.pitch
    if scene.depth is not None or isinstance(road, Absent):
        return None
    mounting_std = float(np.deg2rad(cfg.odometry.pitch_std_deg))
    pitch_std = mounting_std if pitch is None or not pitch.measured else float(np.sqrt(pitch.variance))
    return contact.ground_of(road, pitch_std, mounted=scene.mounted)


def _with_grey_for_tracks(cfg: ReplayConfig, state: ChainState, scene: Scene, timer: Timer) -> Scene:
    """The scene with the front camera's pixels if the tracked objects are searched in them."""
    searches = cfg.objects.enabled and cfg.objects.template_search and bool(state.objects.tracks)
    was_decoded = scene.grey is not None or any(reason.source == "image" for reason in scene.undecodable)
    if not searches or was_decoded:
        return scene
    undecodable = list(scene.undecodable)
    with timer("decode"):
        grey = pixels.grey_of("image", scene.image, scene.camera, undecodable)
    return replace(scene, grey=grey, undecodable=tuple(undecodable))


def _stereo(
    cfg: ReplayConfig, frame: Frame, grey: Image | None, problems: list[Reason], threads: int
) -> StereoDepth | Absent:
    """Depth of the stereo pair; its left camera may be the front camera."""
    if frame.right is None:
        return Absent(Reason("stereo", "no_right_image"))
    if frame.right_camera is None:
        return Absent(Reason("stereo", "no_right_calibration"))
    left_grey = grey if pixels.left_is_front(frame) else pixels.grey_of("left", frame.left, frame.left_camera, problems)
    right_grey = pixels.grey_of("right", frame.right, frame.right_camera, problems)
    with opencv_threads(min(threads, _MATCHING_THREADS)):
        return stereo.match(cfg.stereo, frame.left_camera, frame.right_camera, frame.ego_T_left, left_grey, right_grey)


def _odd_camera(scene: Scene) -> Iterator[Reason]:
    """Problems of the front camera's calibration."""
    if scene.camera.lens is not None:
        yield Reason("image", "not_rectified")
    if not scene.camera.square_pixels:
        yield Reason("image", "pixels_not_square", (scene.camera.fx, scene.camera.fy))


def _missing_inputs(scene: Scene, road: Surface | Absent, tracked: Objects | Absent) -> Iterator[Reason]:
    """The missing inputs of stages that still have an output."""
    source = None if isinstance(road, Absent) else road.source
    if scene.depth is None and source != "held":  # a held plane has its own reason
        code = "no_depth_pitch_estimated" if source == "estimated" else "no_depth_plane_assumed"
        yield Reason("surface", code, (scene.plane_source,))
    if scene.depth is not None and scene.tags is None:
        yield Reason("surface", "no_segmentation_lower_image")
    if isinstance(tracked, Objects) and tracked.objects:
        if scene.tags is None:
            yield Reason("objects", "no_segmentation_not_filtered")
        if scene.depth is None:
            known = not isinstance(road, Absent)
            yield Reason("objects", "no_depth_ground_distances" if known else "no_depth_no_distances")
