"""The pixels of a frame: decoded only where a stage asks for them, and brought into the front camera's view."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.registration import depth_of_points, sample_labels, warp_depth
from roadperc_stream.core.datatypes import CameraImage, Frame, Image, StereoDepth, SurfaceSource
from roadperc_stream.core.geometry import Camera, Float, Float32, inverse
from roadperc_stream.errors import DecodeError

T = TypeVar("T")
P = TypeVar("P", bound=np.generic)
_OTHER_SIZE: Final = " pixels, its calibration says "


@dataclass(frozen=True)
class DepthView:
    """(H, W) metres, NaN unknown, and the camera that has them; ``limit_m`` is where the encoding saturates."""

    depth_m: Float32
    camera: Camera
    ego_T_camera: Float
    limit_m: float
    source: SurfaceSource

    @property
    def dense(self) -> bool:
        """Whether most pixels have a depth: a lidar's points are few."""
        return self.source != "lidar"

    def from_front(self, frame: Frame) -> Float32:
        """The depth as the front camera would see it."""
        if self._shares_camera(frame):
            return self.depth_m
        return warp_depth(self.camera, self._front_T_depth(frame), frame.camera, self.depth_m)

    def labels(self, frame: Frame, labels: Image) -> Image:
        """The front camera's (h, w) labels at the pixels of this depth."""
        if self._shares_camera(frame):
            return labels
        return sample_labels(self.camera, self._front_T_depth(frame), frame.camera, self.depth_m, labels)

    def _front_T_depth(self, frame: Frame) -> Float:
        return inverse(frame.ego_T_camera) @ self.ego_T_camera

    def _shares_camera(self, frame: Frame) -> bool:
        """Whether depth and image share one camera, so that pixel lies on pixel."""
        same_place = np.allclose(frame.ego_T_camera, self.ego_T_camera, atol=1e-6)
        return bool(same_place) and frame.camera.same_view(self.camera)


def tags_of(frame: Frame, problems: list[str]) -> Image | None:
    """(H, W) tags of the front camera."""
    return _pixels("segmentation", frame.segmentation, lambda image: image.tags, frame.camera, problems)


def grey_of(role: str, image: CameraImage | None, camera: Camera | None, problems: list[str]) -> Image | None:
    """(H, W) grey of a camera image; None where there is none or its camera is not known."""
    if camera is None:
        return None
    return _pixels(role, image, lambda image: image.grey, camera, problems)


def colours_of(frame: Frame) -> Image | None:
    """(H, W, 3) colours of the front camera's image, whatever its size; None where it is missing or cannot be read."""
    return _decoded("image", frame.image, lambda image: image.bgr, [])


def image_fits(reasons: Iterable[str]) -> bool:
    """Whether a frame's reasons leave it open that its camera image is of its calibration's size."""
    return not any(reason.startswith("image: ") and _OTHER_SIZE in reason for reason in reasons)


def sensor_depth(frame: Frame, problems: list[str]) -> DepthView | None:
    """The depth camera's view."""
    depth_m = _pixels("depth", frame.depth, lambda image: image.depth_m, frame.depth_camera, problems)
    if depth_m is None or frame.depth is None:
        return None
    return DepthView(depth_m, frame.depth_camera, frame.ego_T_depth_camera, frame.depth.limit_m, "depth")


def stereo_view(frame: Frame, stereo: StereoDepth) -> DepthView:
    """Stereo's depth as a depth camera's view."""
    return DepthView(stereo.depth_m, frame.left_camera, frame.ego_T_left, np.inf, "stereo")


def lidar_view(frame: Frame, problems: list[str]) -> DepthView | None:
    """The lidar's points as a sparse depth image of the front camera."""
    if frame.points is None:
        return None
    if frame.ego_T_lidar is None:
        problems.append(f"lidar: no transform connects its frame {frame.points.frame_id!r} with ego")
        return None
    try:
        points_m = frame.points.points_m
    except DecodeError as error:
        problems.append(f"lidar: {error}")
        return None
    depth_m = depth_of_points(frame.camera, inverse(frame.ego_T_camera) @ frame.ego_T_lidar, points_m)
    if not np.isfinite(depth_m).any():
        left_out = frame.points.left_out
        lost = f"; {left_out} of them are not finite" if left_out else ""
        problems.append(f"lidar: none of its {len(points_m) + left_out} points lies in the camera's view{lost}")
        return None
    return DepthView(depth_m, frame.camera, frame.ego_T_camera, np.inf, "lidar")


def _pixels(
    role: str, image: T | None, decode: Callable[[T], NDArray[P]], camera: Camera, problems: list[str]
) -> NDArray[P] | None:
    """Decoded pixels of the camera's size; what cannot be used becomes a problem and counts as missing."""
    pixels = _decoded(role, image, decode, problems)
    if pixels is not None and pixels.shape[:2] != camera.size:
        height, width = pixels.shape[:2]
        problems.append(f"{role}: {width}x{height}{_OTHER_SIZE}{camera.width}x{camera.height}")
        return None
    return pixels


def _decoded(role: str, image: T | None, decode: Callable[[T], NDArray[P]], problems: list[str]) -> NDArray[P] | None:
    """Decoded pixels, of any size; what cannot be decoded becomes a problem and counts as missing."""
    if image is None:
        return None
    try:
        return decode(image)
    except DecodeError as error:
        problems.append(f"{role}: {error}")
        return None
