"""The perception chain of one frame, as one straight line: what it shows, where the car is, what is on the road."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace

import numpy as np

from roadperc_stream.chain import pixels
from roadperc_stream.chain.needs import left_is_front, needs_front_grey, needs_scene
from roadperc_stream.chain.stages import lanes, objects, occupancy, odometry, stereo, surface
from roadperc_stream.chain.stages.lanes import LanesState
from roadperc_stream.chain.stages.objects import ObjectsState
from roadperc_stream.chain.stages.odometry import OdometryState
from roadperc_stream.chain.stages.surface import SurfaceState
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import (
    Absent,
    Frame,
    FrameResult,
    Ids,
    Image,
    Lanes,
    Mask,
    Objects,
    Occupancy,
    Odometry,
    Reason,
    ReasonCode,
    StereoDepth,
    Surface,
)
from roadperc_stream.core.geometry import Float, inverse, transform_plane
from roadperc_stream.core.scene import DepthMap, Scene

Timer = Callable[[str], AbstractContextManager[object]]
"""Called with the name of a stage that runs: what it returns is entered while the stage works."""


@dataclass(frozen=True)
class ChainState:
    """What the chain remembers from one frame to the next."""

    stamp_ns: int | None = None
    surface: SurfaceState = field(default_factory=SurfaceState)
    odometry: OdometryState = field(default_factory=OdometryState)
    lanes: LanesState = field(default_factory=LanesState)
    objects: ObjectsState = field(default_factory=ObjectsState)


def untimed(_: str) -> AbstractContextManager[object]:
    """A timer that does not measure."""
    return nullcontext()


def _if_enabled(cfg: ReplayConfig, timer: Timer) -> Timer:
    return lambda stage: timer(stage) if getattr(cfg, stage).enabled else nullcontext()


@dataclass(frozen=True)
class Sight:
    """What a frame shows by itself, whatever came before it: its pixels as a scene, and the depth of its pair.

    ``undecoded`` are the front camera's images that cannot be used, ``problems`` what else is wrong.
    """

    frame: Frame
    scene: Scene
    matched: StereoDepth | Absent
    undecoded: tuple[Reason, ...]
    problems: tuple[Reason, ...]


@dataclass(frozen=True)
class Whereabouts:
    """Where the car is: the road below it and its motion.

    ``state`` is that after surface and odometry; of lanes and objects it remembers what it did before.
    """

    sight: Sight
    state: ChainState
    motion: Odometry | Absent
    road: Surface | Absent
    front_road: Surface | Absent
    drivable: Mask | Absent
    problems: tuple[Reason, ...]

    def counted_from_here(self) -> "Whereabouts":
        """The same with odometry counted from its frame on: that frame's pose is the identity, exactly."""
        state = replace(self.state, odometry=odometry.counted_from_here(self.state.odometry))
        if isinstance(self.motion, Absent):
            return replace(self, state=state)
        return replace(self, state=state, motion=replace(self.motion, odom_T_ego=state.odometry.odom_T_ego))


def step(cfg: ReplayConfig, state: ChainState, frame: Frame, timer: Timer = untimed) -> tuple[ChainState, FrameResult]:
    """Run every stage on one frame, in the order of what needs what.

    Pure: the same configuration, state and frame give the same result, bit for bit; the timer's readings stay out of
    it. Random numbers are seeded by the configuration's seed and the frame's stamp.
    """
    sight = see(cfg, frame, timer)
    place = locate(cfg, state, sight, timer)
    return perceive(cfg, state, place, timer)


def see(cfg: ReplayConfig, frame: Frame, timer: Timer = untimed) -> Sight:
    """Decode what the stages in use ask for, and match the pair: all that needs no memory of the frames before."""
    undecoded, problems = list[Reason](), list[Reason]()
    with timer("decode"):
        tags = pixels.tags_of(frame, undecoded) if needs_scene(cfg) else None
        sensor = pixels.sensor_depth(frame, undecoded) if needs_scene(cfg) else None
        instances = pixels.instances_of(frame, undecoded) if cfg.objects.enabled else None
        grey = _front_grey(frame, undecoded) if needs_front_grey(cfg, frame) else None
    timed = _if_enabled(cfg, timer)
    with timed("stereo"):
        matched = _stereo(cfg, frame, grey, problems)
    with timed("surface"):
        depth = _best_depth(frame, sensor, matched, problems) if needs_scene(cfg) else None
    return Sight(frame, _scene(frame, tags, grey, depth, instances), matched, tuple(undecoded), tuple(problems))


def locate(cfg: ReplayConfig, state: ChainState, sight: Sight, timer: Timer = untimed) -> Whereabouts:
    """Find the road and the car's motion; of the state what lanes and objects remember is not asked for."""
    frame, scene, problems = sight.frame, sight.scene, list[Reason]()
    state, _ = _in_order(state, frame)
    rng = np.random.default_rng((cfg.seed, frame.stamp_ns % 2**63))
    timed = _if_enabled(cfg, timer)
    with timed("surface"):
        seen, failed = _seen_road(cfg, scene, rng)
    with timed("odometry"):
        odometry_state, motion = _odometry(cfg, state, scene, _in_front_camera(scene, seen), rng)
    with timed("surface"):
        surface_state, road = _road(cfg, state, scene, seen, failed, motion, odometry_state, problems)
        front_road = _in_front_camera(scene, road)
        drivable = _drivable(cfg, scene, front_road)
    state = replace(state, stamp_ns=frame.stamp_ns, surface=surface_state, odometry=odometry_state)
    return Whereabouts(sight, state, motion, road, front_road, drivable, tuple(problems))


def perceive(
    cfg: ReplayConfig, state: ChainState, place: Whereabouts, timer: Timer = untimed
) -> tuple[ChainState, FrameResult]:
    """Find what is on the road; of the state only the stamp and what lanes and objects remember is asked for."""
    sight, frame, motion, drivable = place.sight, place.sight.frame, place.motion, place.drivable
    state, out_of_order = _in_order(state, frame)
    scene, undecoded = _with_grey_for_tracks(cfg, state, sight, timer)
    timed = _if_enabled(cfg, timer)
    with timed("lanes"):
        lanes_state, ego_lane = _lanes(cfg, state, scene, place.front_road, drivable, motion)
    with timed("objects"):
        objects_state, tracked = _objects(cfg, state, scene, ego_lane, motion)
    with timed("occupancy"):
        grid = _occupancy(cfg, scene, place.front_road, drivable)
    missing = _missing_inputs(scene, place.road, tracked) if needs_scene(cfg) else ()
    result = FrameResult(
        frame.stamp_ns,
        frame.camera.frame_id,
        place.road,
        drivable,
        ego_lane,
        tracked,
        (*out_of_order, *undecoded, *sight.problems, *place.problems, *_odd_camera(scene), *missing),
        sight.matched,
        motion,
        grid,
        place.front_road,
    )
    return replace(place.state, lanes=lanes_state, objects=objects_state), result


def _in_order(state: ChainState, frame: Frame) -> tuple[ChainState, list[Reason]]:
    """The state, cleared where the frame's time is not after the last one's, and that as a problem."""
    last_ns, stamp_ns = state.stamp_ns, frame.stamp_ns
    if last_ns is None or stamp_ns > last_ns:
        return state, []
    if stamp_ns == last_ns:
        return ChainState(), [Reason("time", "time_stood_still", (stamp_ns,))]
    return ChainState(), [Reason("time", "time_went_back", (last_ns, stamp_ns))]


def _off(stage: str) -> Absent:
    return Absent(Reason(stage, "switched_off"))


def _scene(
    frame: Frame, tags: Image | None, grey: Image | None, depth: DepthMap | None, instances: Ids | None
) -> Scene:
    return Scene(
        frame.stamp_ns,
        frame.camera,
        frame.ego_T_camera,
        frame.mounted,
        tags,
        frame.segmentation.table if frame.segmentation else None,
        grey,
        frame.image is not None and grey is None,
        depth,
        frame.detections,
        instances,
    )


def _best_depth(
    frame: Frame, sensor: DepthMap | None, matched: StereoDepth | Absent, problems: list[Reason]
) -> DepthMap | None:
    """The depth camera's depth, else stereo's, else the lidar's few points."""
    if sensor is not None:
        return sensor
    if isinstance(matched, StereoDepth):
        return pixels.stereo_depth(frame, matched)
    return pixels.lidar_depth(frame, problems)


def _seen_road(cfg: ReplayConfig, scene: Scene, rng: np.random.Generator) -> tuple[Surface | Absent, Reason | None]:
    """The road by this frame alone, and why its depth does not show it."""
    if not cfg.surface.enabled:
        return _off("surface"), None
    return surface.find_surface(cfg.surface, scene, rng)


def _road(
    cfg: ReplayConfig,
    state: ChainState,
    scene: Scene,
    seen: Surface | Absent,
    failed: Reason | None,
    motion: Odometry | Absent,
    odometry_state: OdometryState,
    problems: list[Reason],
) -> tuple[SurfaceState, Surface | Absent]:
    """The road in the frame of its depth's camera: the frame's own, else that of the frames before, else assumed."""
    if not cfg.surface.enabled:
        return state.surface, seen
    last_T_this = _metric_step(motion, state.stamp_ns)
    surface_state, road, stood_in = surface.remember(cfg.surface, state.surface, scene, seen, failed, last_T_this)
    road = _with_pitch(scene, road, odometry_state)
    estimated = not isinstance(road, Absent) and road.source == "estimated"
    problems += [replace(reason, code="plane_estimated") for reason in stood_in] if estimated else stood_in
    return surface_state, road


def _drivable(cfg: ReplayConfig, scene: Scene, front_road: Surface | Absent) -> Mask | Absent:
    return surface.drivable_mask(cfg.surface, scene, front_road) if cfg.surface.enabled else _off("drivable")


def _odometry(
    cfg: ReplayConfig, state: ChainState, scene: Scene, front_road: Surface | Absent, rng: np.random.Generator
) -> tuple[OdometryState, Odometry | Absent]:
    if not cfg.odometry.enabled:
        return state.odometry, _off("odometry")
    return odometry.step(cfg.odometry, state.odometry, scene, _metric_road(scene, front_road), rng)


def _lanes(
    cfg: ReplayConfig,
    state: ChainState,
    scene: Scene,
    front_road: Surface | Absent,
    drivable: Mask | Absent,
    motion: Odometry | Absent,
) -> tuple[LanesState, Lanes | Absent]:
    if not cfg.lanes.enabled:
        return state.lanes, _off("lanes")
    return lanes.step(cfg.lanes, state.lanes, scene, front_road, drivable, _since(motion, state.stamp_ns))


def _objects(
    cfg: ReplayConfig, state: ChainState, scene: Scene, ego_lane: Lanes | Absent, motion: Odometry | Absent
) -> tuple[ObjectsState, Objects | Absent]:
    if not cfg.objects.enabled:
        return state.objects, _off("objects")
    known_lane = None if isinstance(ego_lane, Absent) else ego_lane
    return objects.step(cfg.objects, state.objects, scene, known_lane, _metric_step(motion, state.stamp_ns))


def _occupancy(
    cfg: ReplayConfig, scene: Scene, front_road: Surface | Absent, drivable: Mask | Absent
) -> Occupancy | Absent:
    if not cfg.occupancy.enabled:
        return _off("occupancy")
    return occupancy.build(cfg.occupancy, scene, front_road, drivable)


def _in_front_camera(scene: Scene, road: Surface | Absent) -> Surface | Absent:
    """The road with its plane in the frame of the front camera, where the depth belongs to another one."""
    depth = scene.depth
    if isinstance(road, Absent) or depth is None or depth.camera.frame_id == scene.camera.frame_id:
        return road
    return replace(road, plane=transform_plane(inverse(scene.ego_T_camera) @ depth.ego_T_camera, road.plane))


def _metric_road(scene: Scene, front_road: Surface | Absent) -> Surface | None:
    """A road whose height is known, measured or by the mounting: one that gives odometry its scale."""
    if isinstance(front_road, Absent) or (front_road.source == "assumed" and not scene.mounted):
        return None
    return front_road


def _with_pitch(scene: Scene, road: Surface | Absent, memory: OdometryState) -> Surface | Absent:
    """A road that is assumed, with the pitch that the drive has shown."""
    if isinstance(road, Absent) or road.source != "assumed" or memory.pitch is None or not memory.pitch.measured:
        return road
    return surface.estimated_surface(scene, memory.pitch.offset)


def _since(motion: Odometry | Absent, since_ns: int | None) -> Odometry | None:
    """A motion in metres that begins at the last frame, or that it is lost; None of any other."""
    if isinstance(motion, Absent) or motion.status == "first" or motion.up_to_scale:
        return None
    return motion if motion.status == "lost" or motion.since_ns == since_ns else None


def _metric_step(motion: Odometry | Absent, since_ns: int | None) -> Float | None:
    """last_T_this of a motion in metres that begins at the last frame; None of any other."""
    moved = _since(motion, since_ns)
    return None if moved is None else moved.step


def _front_grey(frame: Frame, problems: list[Reason]) -> Image | None:
    return pixels.grey_of("image", frame.image, frame.camera, problems)


def _with_grey_for_tracks(
    cfg: ReplayConfig, state: ChainState, sight: Sight, timer: Timer
) -> tuple[Scene, tuple[Reason, ...]]:
    """The scene with the front camera's pixels where the objects remembered are to be searched in them.

    Returns:
        That scene, and the images that cannot be used.
    """
    frame = sight.frame
    searches = cfg.objects.enabled and cfg.objects.template_search and bool(state.objects.tracks)
    if not searches or needs_front_grey(cfg, frame):
        return sight.scene, sight.undecoded
    undecoded = list(sight.undecoded)
    with timer("decode"):
        grey = _front_grey(frame, undecoded)
    return replace(sight.scene, grey=grey, image_unusable=frame.image is not None and grey is None), tuple(undecoded)


def _stereo(cfg: ReplayConfig, frame: Frame, grey: Image | None, problems: list[Reason]) -> StereoDepth | Absent:
    """Depth of the pair whose left camera is the front camera, or one of its own."""
    if not cfg.stereo.enabled:
        return _off("stereo")
    if frame.right is None:
        return Absent(Reason("stereo", "no_right_image"))
    if frame.right_camera is None:
        return Absent(Reason("stereo", "no_right_calibration"))
    left_grey = grey if left_is_front(frame) else pixels.grey_of("left", frame.left, frame.left_camera, problems)
    right_grey = pixels.grey_of("right", frame.right, frame.right_camera, problems)
    return stereo.match(cfg.stereo, frame.left_camera, frame.right_camera, frame.ego_T_left, left_grey, right_grey)


def _odd_camera(scene: Scene) -> list[Reason]:
    """What is wrong with the front camera's pictures, whatever is done with them."""
    odd = []
    if scene.camera.lens is not None:
        odd.append(Reason("image", "not_rectified"))
    if not scene.camera.square_pixels:
        odd.append(Reason("image", "pixels_not_square", (scene.camera.fx, scene.camera.fy)))
    return odd


def _missing_inputs(scene: Scene, road: Surface | Absent, tracked: Objects | Absent) -> list[Reason]:
    """What a stage that gave something had to do without."""
    missing = list[Reason]()
    if scene.depth is None:
        missing += _instead_of_depth(scene, road)
    elif scene.tags is None:
        missing.append(Reason("surface", "no_segmentation_lower_image"))
    if isinstance(tracked, Objects) and tracked.objects:
        missing += [Reason("objects", "no_segmentation_not_filtered")] if scene.tags is None else []
        missing += [Reason("objects", "no_depth_no_distances")] if scene.depth is None else []
    return missing


def _instead_of_depth(scene: Scene, road: Surface | Absent) -> list[Reason]:
    """What gives the road's plane without depth; of one that is held its own reason says so."""
    source = None if isinstance(road, Absent) else road.source
    if source == "held":
        return []
    code: ReasonCode = "no_depth_pitch_estimated" if source == "estimated" else "no_depth_plane_assumed"
    return [Reason("surface", code, (scene.plane_source,))]
