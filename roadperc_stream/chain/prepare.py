"""Prepares a frame for the stages: decodes the pixels that they need, and matches the stereo pair.

An unusable image counts as missing, with a reason.
"""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.own_stage import NO_OWN, OwnStages
from roadperc_stream.chain.stage_runner import Stages, Timer, needs_scene, off
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Camera, Float32, inverse
from roadperc_stream.geometry.registration import depth_of_points
from roadperc_stream.model import Absent, CameraImage, Frame, Image, Reason
from roadperc_stream.model.results import StereoDepth
from roadperc_stream.system.threads import opencv_threads

_MATCHING_THREADS: Final = 2
"""More threads of OpenCV hardly make stereo matching faster."""
T = TypeVar("T")
P = TypeVar("P", bound=np.generic)


def prepare(
    cfg: ReplayConfig, frame: Frame, timer: Timer = nullcontext, threads: int = 1, own: OwnStages = NO_OWN
) -> Frame:
    """The frame with its pixels, for ``step``; it needs no state.

    With two or more ``threads`` OpenCV matches in half the time, with the same bits.
    """
    stages, problems, camera = Stages(cfg, timer, own, frame), list[Reason](), frame.camera
    tags = sensor_m = instances = grey = None
    with timer("decode"):
        if needs_scene(cfg):
            tags = _decoded("segmentation", frame.segmentation, lambda image: image.tags, camera, problems)
            sensor_m = _decoded("depth", frame.depth_image, lambda image: image.depth_m, frame.depth_camera, problems)
        if cfg.objects.enabled:
            instances = _decoded("instances", frame.instance_image, lambda image: image.ids, camera, problems)
        if own or _needs_grey(cfg, frame):
            grey = _grey("image", frame.image, camera, problems)
    matched = stages.run("stereo", lambda: _stereo(stages, frame, grey, problems, threads), off("stereo"))
    with timer("decode"):
        if needs_scene(cfg):
            frame = _with_depth(frame, sensor_m, matched, problems)
    return replace(
        frame,
        table=frame.segmentation.table if frame.segmentation else None,
        tags=tags,
        grey=grey,
        instances=instances,
        stereo=matched,
        problems=tuple(problems),
    )


def _needs_grey(cfg: ReplayConfig, frame: Frame) -> bool:
    """Whether an enabled stage needs the front camera's pixels."""
    searches = cfg.objects.enabled and (cfg.objects.template_search or bool(cfg.objects.template_png))
    matches = cfg.stereo.enabled and frame.right is not None and _left_is_front(frame)
    return cfg.odometry.enabled or searches or matches


def _left_is_front(frame: Frame) -> bool:
    """Whether the front camera is also the left camera of the stereo pair."""
    return frame.left is None and frame.left_camera == frame.camera


def _stereo(
    stages: Stages, frame: Frame, grey: Image | None, problems: list[Reason], threads: int
) -> StereoDepth | Absent:
    """Depth of the stereo pair; its left camera may be the front camera."""
    if frame.right is None:
        return Absent(Reason("stereo", "no_right_image"))
    if frame.right_camera is None:
        return Absent(Reason("stereo", "no_right_calibration"))
    left_grey = grey if _left_is_front(frame) else _grey("left", frame.left, frame.left_camera, problems)
    right_grey = _grey("right", frame.right, frame.right_camera, problems)
    with opencv_threads(min(threads, _MATCHING_THREADS)):
        return stages.match(frame.left_camera, frame.right_camera, frame.ego_T_left, left_grey, right_grey)


def _with_depth(frame: Frame, sensor_m: Float32 | None, matched: StereoDepth | Absent, problems: list[Reason]) -> Frame:
    """The frame with the depth camera's depth, else stereo's, else the lidar's few points."""
    if sensor_m is not None and frame.depth_image is not None:
        return replace(frame, raw_depth_m=sensor_m, depth_limit_m=frame.depth_image.limit_m, depth_source="depth")
    if isinstance(matched, StereoDepth):
        return replace(
            frame,
            depth_camera=frame.left_camera,
            ego_T_depth_camera=frame.ego_T_left,
            raw_depth_m=matched.depth_m,
            depth_source="stereo",
            inverse_depth_std=matched.inverse_std,
        )
    return replace(
        frame,
        depth_camera=frame.camera,
        ego_T_depth_camera=frame.ego_T_camera,
        raw_depth_m=_lidar_depth_m(frame, problems),
        depth_source="lidar",
    )


def _lidar_depth_m(frame: Frame, problems: list[Reason]) -> Float32 | None:
    """(H, W) the lidar's points as a sparse depth image of the front camera."""
    if frame.points is None:
        return None
    if frame.ego_T_lidar is None:
        problems.append(Reason("lidar", "no_transform", (frame.points.frame_id,)))
        return None
    points_m = _of_any_size("lidar", frame.points, lambda points: points.points_m, problems)
    if points_m is None:
        return None
    depth_m = depth_of_points(frame.camera, inverse(frame.ego_T_camera) @ frame.ego_T_lidar, points_m)
    if not np.isfinite(depth_m).any():
        finite, infinite = len(points_m), frame.points.left_out
        none_in_view = Reason("lidar", "no_points_in_view", (finite,))
        if infinite:
            none_in_view = Reason("lidar", "no_finite_points_in_view", (finite + infinite, infinite))
        problems.append(none_in_view)
        return None
    return depth_m


def _grey(role: str, image: CameraImage | None, camera: Camera, problems: list[Reason]) -> Image | None:
    """(H, W) grey of a camera image; None without an image."""
    return _decoded(role, image, lambda image: image.grey, camera, problems)


def _decoded(
    role: str, image: T | None, decode: Callable[[T], NDArray[P]], camera: Camera, problems: list[Reason]
) -> NDArray[P] | None:
    """Decoded pixels of the camera's size; an unusable image becomes a problem and counts as missing."""
    pixels = _of_any_size(role, image, decode, problems)
    if pixels is not None and pixels.shape[:2] != camera.size:
        height, width = pixels.shape[:2]
        problems.append(Reason(role, "wrong_size", (width, height, camera.width, camera.height)))
        return None
    return pixels


def _of_any_size(
    role: str, message: T | None, decode: Callable[[T], NDArray[P]], problems: list[Reason]
) -> NDArray[P] | None:
    """A decoded array of any size; an undecodable message becomes a problem and counts as missing."""
    if message is None:
        return None
    try:
        return decode(message)
    except DecodeError as error:
        problems.append(Reason(role, "undecodable", (str(error),)))
        return None
