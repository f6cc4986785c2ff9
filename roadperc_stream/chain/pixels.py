"""The pixels of a frame: which ones the enabled stages need, and their decoding; an unusable image is missing."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Camera, inverse
from roadperc_stream.geometry.registration import depth_of_points
from roadperc_stream.model import CameraImage, Frame, Image, Reason
from roadperc_stream.model.scene import DepthMap

T = TypeVar("T")
P = TypeVar("P", bound=np.generic)


def needs_scene(cfg: ReplayConfig) -> bool:
    """Whether an enabled stage uses depth or tags: any stage except stereo."""
    return any(stage.enabled for stage in (cfg.surface, cfg.odometry, cfg.lanes, cfg.objects, cfg.occupancy))


def needs_grey(cfg: ReplayConfig, frame: Frame) -> bool:
    """Whether an enabled stage needs the front camera's pixels, independent of the state."""
    searches = cfg.objects.enabled and cfg.objects.template_search and bool(frame.detections)
    shown = cfg.objects.enabled and bool(cfg.objects.template_png)
    matches = cfg.stereo.enabled and frame.right is not None
    return cfg.odometry.enabled or searches or shown or (matches and left_is_front(frame))


def left_is_front(frame: Frame) -> bool:
    """Whether the front camera is also the left camera of the stereo pair."""
    return frame.left is None and frame.left_camera == frame.camera


def grey_of(role: str, image: CameraImage | None, camera: Camera, problems: list[Reason]) -> Image | None:
    """(H, W) grey of a camera image; None without an image."""
    return decoded(role, image, lambda image: image.grey, camera, problems)


def sensor_depth(frame: Frame, problems: list[Reason]) -> DepthMap | None:
    """The depth camera's depth."""
    depth_m = decoded("depth", frame.depth, lambda image: image.depth_m, frame.depth_camera, problems)
    if depth_m is None or frame.depth is None:
        return None
    return DepthMap(depth_m, frame.depth_camera, frame.ego_T_depth_camera, frame.depth.limit_m, "depth")


def lidar_depth(frame: Frame, problems: list[Reason]) -> DepthMap | None:
    """The lidar's points as a sparse depth image of the front camera."""
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
    return DepthMap(depth_m, frame.camera, frame.ego_T_camera, np.inf, "lidar")


def decoded(
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
