"""The perception chain of one frame, as one straight function."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import ReplayConfig
from roadperc_stream.datatypes import Absent, Frame, FrameResult, Image, Objects, Surface
from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Camera, Float, Float32, inverse, transform_plane
from roadperc_stream.registration import sample_labels, warp_depth
from roadperc_stream.semantics import TagTable
from roadperc_stream.stages import lanes, surface
from roadperc_stream.stages.lanes import LanesState
from roadperc_stream.stages.objects.judge import judge

Timer = Callable[[str], AbstractContextManager[object]]
"""Called with a stage's name: what it returns is entered while the stage works."""

OFF = Absent("switched off")
T = TypeVar("T")
P = TypeVar("P", bound=np.generic)


@dataclass(frozen=True)
class ChainState:
    """What the chain remembers from one frame to the next."""

    stamp_ns: int | None = None
    lanes: LanesState = field(default_factory=LanesState)


@dataclass(frozen=True)
class Rasters:
    """The decoded pixels of a frame; ``front_depth_m`` is the depth as the front camera would see it."""

    tags: Image | None
    depth_m: Float32 | None
    front_depth_m: Float32 | None
    depth_limit_m: float


def untimed(_: str) -> AbstractContextManager[object]:
    """A timer that does not measure."""
    return nullcontext()


def step(cfg: ReplayConfig, state: ChainState, frame: Frame, timer: Timer = untimed) -> tuple[ChainState, FrameResult]:
    """Run every stage on one frame.

    Pure: the same configuration, state and frame give the same result, bit for bit; the timer's readings stay out of
    it. Random numbers are seeded by the configuration's seed and the frame's stamp.
    """
    problems: list[str] = []
    if state.stamp_ns is not None and frame.stamp_ns <= state.stamp_ns:
        problems.append(f"time went back from {state.stamp_ns} to {frame.stamp_ns} ns: memory of the stages cleared")
        state = ChainState()
    camera = frame.camera
    table = frame.segmentation.table if frame.segmentation else None
    with timer("decode"):
        rasters = _decode(frame, problems)
    with timer("surface"):
        road = _labels(table, cfg.surface.classes, rasters.tags)
        plane = _surface(cfg, frame, rasters, road) if cfg.surface.enabled else OFF
        front_plane = surface_in_front_camera(plane, frame)
        drivable = (
            surface.drivable_mask(cfg.surface, front_plane, camera, rasters.front_depth_m, road)
            if cfg.surface.enabled
            else OFF
        )
    with timer("lanes"):
        lanes_state, ego_lane = (
            lanes.step(
                cfg.lanes,
                state.lanes,
                camera,
                frame.ego_T_camera,
                front_plane,
                rasters.tags,
                table,
                drivable,
                frame.stamp_ns,
            )
            if cfg.lanes.enabled
            else (LanesState(), OFF)
        )
    with timer("objects"):
        judged = (
            judge(
                cfg.objects,
                frame.detections,
                camera,
                rasters.tags,
                table,
                rasters.front_depth_m,
                rasters.depth_limit_m,
            )
            if cfg.objects.enabled
            else OFF
        )
    problems += _what_is_lacking(frame, rasters, judged)
    result = FrameResult(frame.stamp_ns, camera.frame_id, plane, drivable, ego_lane, judged, tuple(problems))
    return ChainState(frame.stamp_ns, lanes_state), result


def _what_is_lacking(frame: Frame, rasters: Rasters, judged: Objects | Absent) -> list[str]:
    """What a stage that gave something had to do without."""
    lacking = []
    if rasters.depth_m is None:
        lacking.append(f"surface: no depth, the {'mounting' if frame.mounted else 'assumed height'} gives the plane")
    elif rasters.tags is None:
        lacking.append("surface: no segmentation, the lower image stands in for the road")
    if isinstance(judged, Objects) and judged.objects:
        lacking += ["objects: no segmentation, nothing is judged"] if rasters.tags is None else []
        lacking += ["objects: no depth, no distances"] if rasters.depth_m is None else []
    return lacking


def _decode(frame: Frame, problems: list[str]) -> Rasters:
    """Pixels of the inputs; what cannot be decoded becomes a problem and counts as missing."""
    tags = _pixels("segmentation", frame.segmentation, lambda image: image.tags, frame.camera, problems)
    depth_m = _pixels("depth", frame.depth, lambda image: image.depth_m, frame.depth_camera, problems)
    limit_m = frame.depth.limit_m if frame.depth and depth_m is not None else np.inf
    if depth_m is None or _same_camera(frame):
        return Rasters(tags, depth_m, depth_m, limit_m)
    front = warp_depth(frame.depth_camera, _camera_T_depth(frame), frame.camera, depth_m)
    return Rasters(tags, depth_m, front, limit_m)


def _pixels(
    role: str,
    image: T | None,
    decode: Callable[[T], NDArray[P]],
    camera: Camera,
    problems: list[str],
) -> NDArray[P] | None:
    if image is None:
        return None
    try:
        pixels = decode(image)
    except DecodeError as error:
        problems.append(f"{role}: {error}")
        return None
    if pixels.shape != camera.size:
        height, width = pixels.shape
        problems.append(f"{role}: {width}x{height} pixels, its calibration says {camera.width}x{camera.height}")
        return None
    return pixels


def _surface(cfg: ReplayConfig, frame: Frame, rasters: Rasters, road: Image | None) -> Surface | Absent:
    """The plane, in the frame of the camera the depth belongs to."""
    if rasters.depth_m is None:
        return surface.assumed_surface(frame.camera, frame.ego_T_camera)
    seen = road
    if road is not None and not _same_camera(frame):
        seen = sample_labels(frame.depth_camera, _camera_T_depth(frame), frame.camera, rasters.depth_m, road)
    rng = np.random.default_rng((cfg.seed, frame.stamp_ns % 2**63))
    mask = None if seen is None else seen.view(bool)
    return surface.fit_surface(cfg.surface, frame.depth_camera, frame.ego_T_depth_camera, rasters.depth_m, mask, rng)


def surface_in_front_camera(plane: Surface | Absent, frame: Frame) -> Surface | Absent:
    """The plane in the frame of the front camera, where the depth belongs to another one."""
    if isinstance(plane, Absent) or plane.frame_id == frame.camera.frame_id:
        return plane
    return replace(plane, plane=transform_plane(_camera_T_depth(frame), plane.plane))


def _labels(table: TagTable | None, classes: tuple[str, ...], tags: Image | None) -> Image | None:
    """(H, W) uint8, 1 at pixels of the classes."""
    if table is None or tags is None:
        return None
    return np.asarray(cv2.LUT(tags, table.lookup(classes)), np.uint8)


def _camera_T_depth(frame: Frame) -> Float:
    return inverse(frame.ego_T_camera) @ frame.ego_T_depth_camera


def _same_camera(frame: Frame) -> bool:
    """Whether depth and image share one camera, so that pixel lies on pixel."""
    same_place = np.allclose(frame.ego_T_camera, frame.ego_T_depth_camera, atol=1e-6)
    return bool(same_place) and frame.camera.same_view(frame.depth_camera)
