"""The perception chain of one frame, as one straight function."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np

from roadperc_stream.chain import pixels
from roadperc_stream.chain.pixels import DepthView
from roadperc_stream.chain.stages import lanes, objects, occupancy, odometry, stereo, surface
from roadperc_stream.chain.stages.lanes import LanesState
from roadperc_stream.chain.stages.objects import ObjectsState
from roadperc_stream.chain.stages.odometry import OdometryState
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import (
    Absent,
    Frame,
    FrameResult,
    Image,
    Lanes,
    Mask,
    Objects,
    Occupancy,
    Odometry,
    StereoDepth,
    Surface,
)
from roadperc_stream.core.geometry import Float, Float32, inverse, transform_plane
from roadperc_stream.core.semantics import TagTable

Timer = Callable[[str], AbstractContextManager[object]]
"""Called with a stage's name: what it returns is entered while the stage works."""

OFF = Absent("switched off")
_MOVABLE = ("vehicle", "pedestrian")


@dataclass(frozen=True)
class ChainState:
    """What the chain remembers from one frame to the next."""

    stamp_ns: int | None = None
    odometry: OdometryState = field(default_factory=OdometryState)
    lanes: LanesState = field(default_factory=LanesState)
    objects: ObjectsState = field(default_factory=ObjectsState)


@dataclass(frozen=True)
class View:
    """What the stages see of a frame: its decoded pixels, and the depth, from whichever source."""

    frame: Frame
    tags: Image | None
    grey: Image | None
    depth: DepthView | None

    @property
    def dense_depth_m(self) -> Float32 | None:
        """(H, W) depth as the front camera sees it, for what needs it at most pixels; None of a lidar's points."""
        return self.depth_m if self.depth is not None and self.depth.dense else None

    @property
    def table(self) -> TagTable | None:
        """The tags' table."""
        return self.frame.segmentation.table if self.frame.segmentation else None

    @cached_property
    def depth_m(self) -> Float32 | None:
        """(H, W) depth as the front camera sees it."""
        return None if self.depth is None else self.depth.from_front(self.frame)

    def labels(self, classes: tuple[str, ...]) -> Image | None:
        """(H, W) uint8, 1 at pixels of the classes; None without tags."""
        if self.table is None or self.tags is None:
            return None
        return np.asarray(cv2.LUT(self.tags, self.table.lookup(classes)), np.uint8)


def untimed(_: str) -> AbstractContextManager[object]:
    """A timer that does not measure."""
    return nullcontext()


def step(cfg: ReplayConfig, state: ChainState, frame: Frame, timer: Timer = untimed) -> tuple[ChainState, FrameResult]:
    """Run every stage on one frame, in the order of what needs what.

    Pure: the same configuration, state and frame give the same result, bit for bit; the timer's readings stay out of
    it. Random numbers are seeded by the configuration's seed and the frame's stamp.
    """
    problems: list[str] = []
    if state.stamp_ns is not None and frame.stamp_ns <= state.stamp_ns:
        problems.append(f"{_time_in_words(state.stamp_ns, frame.stamp_ns)}: memory of the stages cleared")
        state = ChainState()
    rng = np.random.default_rng((cfg.seed, frame.stamp_ns % 2**63))
    with timer("decode"):
        tags = pixels.tags_of(frame, problems)
        sensor = pixels.sensor_depth(frame, problems)
        grey = pixels.grey_of("image", frame.image, frame.camera, problems) if _wants_grey(cfg, state, frame) else None
    with timer("stereo"):
        matched = _stereo(cfg, frame, grey, problems)
    with timer("surface"):
        view = View(frame, tags, grey, _depth(frame, sensor, matched, problems))
        plane = _surface(cfg, view, rng, problems)
        front = _in_front_camera(plane, view)
        drivable = _drivable(cfg, view, front)
    with timer("odometry"):
        odometry_state, motion = _odometry(cfg, state, view, front, rng)
    with timer("lanes"):
        lanes_state, ego_lane = _lanes(cfg, state, view, front, drivable, motion)
    with timer("objects"):
        objects_state, followed = _objects(cfg, state, view)
    with timer("occupancy"):
        grid = _occupancy(cfg, view, front, drivable)
    problems += _what_is_lacking(view, followed)
    result = FrameResult(
        frame.stamp_ns,
        frame.camera.frame_id,
        plane,
        drivable,
        ego_lane,
        followed,
        tuple(problems),
        matched,
        motion,
        grid,
        front,
    )
    return ChainState(frame.stamp_ns, odometry_state, lanes_state, objects_state), result


def _time_in_words(last_ns: int, stamp_ns: int) -> str:
    """How a stamp that is not after the last one stands to it."""
    return (
        f"time stood still at {stamp_ns} ns"
        if stamp_ns == last_ns
        else f"time went back from {last_ns} to {stamp_ns} ns"
    )


def _depth(
    frame: Frame, sensor: DepthView | None, matched: StereoDepth | Absent, problems: list[str]
) -> DepthView | None:
    """The depth camera's view, else stereo's, else the lidar's few points."""
    if sensor is not None:
        return sensor
    if isinstance(matched, StereoDepth):
        return pixels.stereo_view(frame, matched)
    return pixels.lidar_view(frame, problems)


def _in_front_camera(plane: Surface | Absent, view: View) -> Surface | Absent:
    """The road with its plane in the frame of the front camera, where the depth belongs to another one."""
    frame, depth = view.frame, view.depth
    if isinstance(plane, Absent) or depth is None or depth.camera.frame_id == frame.camera.frame_id:
        return plane
    return replace(plane, plane=transform_plane(inverse(frame.ego_T_camera) @ depth.ego_T_camera, plane.plane))


def _odometry(
    cfg: ReplayConfig, state: ChainState, view: View, front: Surface | Absent, rng: np.random.Generator
) -> tuple[OdometryState, Odometry | Absent]:
    if not cfg.odometry.enabled:
        return state.odometry, OFF
    frame, movable = view.frame, view.labels(_MOVABLE)
    unusable = "its image cannot be used" if frame.image is not None and view.grey is None else ""
    return odometry.step(
        cfg.odometry,
        state.odometry,
        frame.camera,
        frame.ego_T_camera,
        view.grey,
        view.dense_depth_m,
        None if movable is None else movable.view(bool),
        _trusted(front, frame),
        rng,
        frame.stamp_ns,
        unusable,
    )


def _lanes(
    cfg: ReplayConfig,
    state: ChainState,
    view: View,
    front: Surface | Absent,
    drivable: Mask | Absent,
    motion: Odometry | Absent,
) -> tuple[LanesState, Lanes | Absent]:
    if not cfg.lanes.enabled:
        return state.lanes, OFF
    frame, moved = view.frame, _metric_step(motion, state.stamp_ns)
    return lanes.step(
        cfg.lanes,
        state.lanes,
        frame.camera,
        frame.ego_T_camera,
        front,
        view.tags,
        view.table,
        drivable,
        moved,
        frame.stamp_ns,
    )


def _objects(cfg: ReplayConfig, state: ChainState, view: View) -> tuple[ObjectsState, Objects | Absent]:
    if not cfg.objects.enabled:
        return state.objects, OFF
    frame, limit_m = view.frame, np.inf if view.depth is None else view.depth.limit_m
    return objects.step(
        cfg.objects,
        state.objects,
        frame.detections,
        frame.camera,
        view.tags,
        view.table,
        view.depth_m,
        limit_m,
        view.grey,
        frame.stamp_ns,
    )


def _occupancy(cfg: ReplayConfig, view: View, front: Surface | Absent, drivable: Mask | Absent) -> Occupancy | Absent:
    if not cfg.occupancy.enabled:
        return OFF
    frame = view.frame
    return occupancy.build(
        cfg.occupancy,
        frame.camera,
        frame.ego_T_camera,
        front,
        view.depth_m,
        drivable,
        view.tags,
        view.table,
        dense=view.depth is not None and view.depth.dense,
    )


def _trusted(front: Surface | Absent, frame: Frame) -> Surface | None:
    """A road whose height is known, measured or by the mounting: one that gives odometry its scale."""
    if isinstance(front, Absent) or (front.source == "assumed" and not frame.mounted):
        return None
    return front


def _metric_step(motion: Odometry | Absent, since_ns: int | None) -> Float | None:
    """last_T_this of a tracked motion in metres that begins at the last frame; None of any other."""
    if isinstance(motion, Absent) or motion.status != "tracked" or motion.up_to_scale or motion.since_ns != since_ns:
        return None
    return motion.step


def _wants_grey(cfg: ReplayConfig, state: ChainState, frame: Frame) -> bool:
    """Whether any stage needs the front camera's pixels."""
    matches = cfg.stereo.method != "off" and frame.right is not None and _left_is_front(frame)
    carries = cfg.objects.enabled and cfg.objects.template_search and bool(frame.detections or state.objects.tracks)
    return cfg.odometry.enabled or matches or carries


def _left_is_front(frame: Frame) -> bool:
    """Whether the pair's left camera is the front camera, and not one of its own, whose image may be missing."""
    return frame.left is None and frame.left_camera == frame.camera


def _stereo(cfg: ReplayConfig, frame: Frame, grey: Image | None, problems: list[str]) -> StereoDepth | Absent:
    """Depth of the pair whose left camera is the front camera, or one of its own."""
    if cfg.stereo.method == "off":
        return OFF
    if frame.right is None:
        return Absent("no right image")
    if frame.right_camera is None:
        return Absent("no calibration of the right camera")
    left_grey = grey if _left_is_front(frame) else pixels.grey_of("left", frame.left, frame.left_camera, problems)
    right_grey = pixels.grey_of("right", frame.right, frame.right_camera, problems)
    return stereo.match(cfg.stereo, frame.left_camera, frame.right_camera, frame.ego_T_left, left_grey, right_grey)


def _surface(cfg: ReplayConfig, view: View, rng: np.random.Generator, problems: list[str]) -> Surface | Absent:
    """The road, its plane in the frame of the camera the depth belongs to."""
    if not cfg.surface.enabled:
        return OFF
    frame, depth = view.frame, view.depth
    if depth is None:
        return surface.assumed_surface(frame.camera, frame.ego_T_camera)
    road = view.labels(cfg.surface.classes)
    mask = None if road is None else depth.labels(frame, road).view(bool)
    plane = surface.fit_surface(cfg.surface, depth.camera, depth.ego_T_camera, depth.depth_m, mask, rng)
    if isinstance(plane, Absent) and not depth.dense:
        # A lidar that misses the road tells no more of it than no lidar; what it hits is as far away as before.
        problems.append(f"surface: {plane.reason}: {_who_knows(frame)} gives the plane")
        return surface.assumed_surface(frame.camera, frame.ego_T_camera)
    if isinstance(plane, Surface) and plane.source == "depth":
        return replace(plane, source=depth.source)
    return plane


def _drivable(cfg: ReplayConfig, view: View, front: Surface | Absent) -> Mask | Absent:
    if not cfg.surface.enabled:
        return OFF
    frame, road = view.frame, view.labels(cfg.surface.classes)
    if road is None and view.depth is not None and not view.depth.dense:
        return Absent("no segmentation, and a lidar's points are too few to tell pixels apart")
    return surface.drivable_mask(cfg.surface, front, frame.camera, view.dense_depth_m, road, frame.ego_T_camera)


def _who_knows(frame: Frame) -> str:
    """What the assumed plane rests on."""
    return "the mounting" if frame.mounted else "the assumed height"


def _what_is_lacking(view: View, followed: Objects | Absent) -> list[str]:
    """What a stage that gave something had to do without."""
    lacking = []
    if view.frame.camera.lens is not None:
        lacking.append("image: its camera is not rectified, and only stereo undoes the distortion")
    if view.depth is None:
        lacking.append(f"surface: no depth, {_who_knows(view.frame)} gives the plane")
    elif view.tags is None:
        lacking.append("surface: no segmentation, the lower image stands in for the road")
    if isinstance(followed, Objects) and followed.objects:
        lacking += ["objects: no segmentation, nothing is judged"] if view.tags is None else []
        lacking += ["objects: no depth, no distances"] if view.depth is None else []
    return lacking
