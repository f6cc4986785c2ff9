"""The perception chain of one frame, as one straight function."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from roadperc_stream import inputs
from roadperc_stream.config import ReplayConfig
from roadperc_stream.datatypes import (
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
from roadperc_stream.geometry import Float, Float32, inverse, transform_plane
from roadperc_stream.inputs import DepthView
from roadperc_stream.semantics import TagTable
from roadperc_stream.stages import lanes, objects, occupancy, odometry, stereo, surface
from roadperc_stream.stages.lanes import LanesState
from roadperc_stream.stages.objects import ObjectsState
from roadperc_stream.stages.odometry import OdometryState

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
        problems.append(f"time went back from {state.stamp_ns} to {frame.stamp_ns} ns: memory of the stages cleared")
        state = ChainState()
    camera, ego_T_camera, stamp_ns = frame.camera, frame.ego_T_camera, frame.stamp_ns
    table = frame.segmentation.table if frame.segmentation else None
    rng = np.random.default_rng((cfg.seed, stamp_ns % 2**63))
    with timer("decode"):
        tags = inputs.tags_of(frame, problems)
        sensor = inputs.sensor_depth(frame, problems)
        grey = inputs.grey_of("image", frame.image, camera, problems) if _wants_grey(cfg, state, frame) else None
    with timer("stereo"):
        matched = _stereo(cfg, frame, grey, problems)
    depth = inputs.stereo_view(frame, matched) if sensor is None and isinstance(matched, StereoDepth) else sensor
    with timer("surface"):
        road = _labels(table, cfg.surface.classes, tags)
        plane = _surface(cfg, frame, depth, road, rng)
        depth_m = None if depth is None else depth.from_front(frame)
        front = _in_front_camera(plane, frame, depth)
        drivable = _drivable(cfg, frame, front, depth_m, road)
    with timer("odometry"):
        movable = _labels(table, _MOVABLE, tags)
        motion: Odometry | Absent = OFF
        odometry_state = state.odometry
        if cfg.odometry.enabled:
            odometry_state, motion = odometry.step(
                cfg.odometry,
                state.odometry,
                camera,
                ego_T_camera,
                grey,
                depth_m,
                None if movable is None else movable.view(bool),
                _trusted(front, frame),
                rng,
                stamp_ns,
            )
    with timer("lanes"):
        ego_lane: Lanes | Absent = OFF
        lanes_state = state.lanes
        if cfg.lanes.enabled:
            lanes_state, ego_lane = lanes.step(
                cfg.lanes,
                state.lanes,
                camera,
                ego_T_camera,
                front,
                tags,
                table,
                drivable,
                _metric_step(motion, state.stamp_ns),
                stamp_ns,
            )
    with timer("objects"):
        followed: Objects | Absent = OFF
        objects_state = state.objects
        limit_m = np.inf if depth is None else depth.limit_m
        if cfg.objects.enabled:
            objects_state, followed = objects.step(
                cfg.objects, state.objects, frame.detections, camera, tags, table, depth_m, limit_m, grey, stamp_ns
            )
    with timer("occupancy"):
        grid: Occupancy | Absent = OFF
        if cfg.occupancy.enabled:
            grid = occupancy.build(cfg.occupancy, camera, ego_T_camera, front, depth_m, drivable, tags, table)
    problems += _what_is_lacking(frame, tags, depth, followed)
    result = FrameResult(
        stamp_ns, camera.frame_id, plane, drivable, ego_lane, followed, tuple(problems), matched, motion, grid, front
    )
    return ChainState(stamp_ns, odometry_state, lanes_state, objects_state), result


def _in_front_camera(plane: Surface | Absent, frame: Frame, depth: DepthView | None) -> Surface | Absent:
    """The road with its plane in the frame of the front camera, where the depth belongs to another one."""
    if isinstance(plane, Absent) or depth is None or depth.camera.frame_id == frame.camera.frame_id:
        return plane
    return replace(plane, plane=transform_plane(inverse(frame.ego_T_camera) @ depth.ego_T_camera, plane.plane))


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
    matches = cfg.stereo.method != "off" and frame.right is not None and frame.left is None
    carries = cfg.objects.enabled and cfg.objects.template_search and bool(frame.detections or state.objects.tracks)
    return cfg.odometry.enabled or matches or carries


def _stereo(cfg: ReplayConfig, frame: Frame, grey: Image | None, problems: list[str]) -> StereoDepth | Absent:
    """Depth of the pair whose left camera is the front camera, or one of its own."""
    if cfg.stereo.method == "off":
        return OFF
    if frame.right is None:
        return Absent("no right image")
    left_grey = grey if frame.left is None else inputs.grey_of("left", frame.left, frame.left_camera, problems)
    right_grey = inputs.grey_of("right", frame.right, frame.right_camera, problems)
    return stereo.match(cfg.stereo, frame.left_camera, frame.right_camera, frame.ego_T_left, left_grey, right_grey)


def _surface(
    cfg: ReplayConfig, frame: Frame, depth: DepthView | None, road: Image | None, rng: np.random.Generator
) -> Surface | Absent:
    """The road, its plane in the frame of the camera the depth belongs to."""
    if not cfg.surface.enabled:
        return OFF
    if depth is None:
        return surface.assumed_surface(frame.camera, frame.ego_T_camera)
    mask = None if road is None else depth.labels(frame, road).view(bool)
    plane = surface.fit_surface(cfg.surface, depth.camera, depth.ego_T_camera, depth.depth_m, mask, rng)
    if isinstance(plane, Surface) and plane.source == "depth":
        return replace(plane, source=depth.source)
    return plane


def _drivable(
    cfg: ReplayConfig, frame: Frame, front: Surface | Absent, depth_m: Float32 | None, road: Image | None
) -> Mask | Absent:
    if not cfg.surface.enabled:
        return OFF
    return surface.drivable_mask(cfg.surface, front, frame.camera, depth_m, road, frame.ego_T_camera)


def _labels(table: TagTable | None, classes: tuple[str, ...], tags: Image | None) -> Image | None:
    """(H, W) uint8, 1 at pixels of the classes."""
    if table is None or tags is None:
        return None
    return np.asarray(cv2.LUT(tags, table.lookup(classes)), np.uint8)


def _what_is_lacking(
    frame: Frame, tags: Image | None, depth: DepthView | None, followed: Objects | Absent
) -> list[str]:
    """What a stage that gave something had to do without."""
    lacking = []
    if depth is None:
        lacking.append(f"surface: no depth, the {'mounting' if frame.mounted else 'assumed height'} gives the plane")
    elif tags is None:
        lacking.append("surface: no segmentation, the lower image stands in for the road")
    if isinstance(followed, Objects) and followed.objects:
        lacking += ["objects: no segmentation, nothing is judged"] if tags is None else []
        lacking += ["objects: no depth, no distances"] if depth is None else []
    return lacking
