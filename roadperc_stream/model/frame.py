"""The input of the chain at one instant."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np

from roadperc_stream.geometry import Camera, Float, Float32, inverse
from roadperc_stream.geometry.arrays import Ids, Image, read_only
from roadperc_stream.geometry.planes import SurfaceSource
from roadperc_stream.geometry.registration import sample_labels, warp_depth
from roadperc_stream.model.inputs import CameraImage, DepthImage, Detection, InstanceImage, PointCloud, TagImage
from roadperc_stream.model.reason import Reason
from roadperc_stream.model.results import Absent, StereoDepth
from roadperc_stream.model.tag_tables import TagTable

_NOT_RUN: Final = Absent(Reason("stereo", "not_run"))
_SAME_PLACE_M: Final = 1e-6


def mark(tags: Image, lookup: Image) -> Image:
    """(H, W) 1 at pixels of a class, else 0; ``lookup`` is (256,) 1 at its tags. ``tags`` (H, W) are not empty."""
    import cv2  # readers of results do not need it

    return np.asarray(cv2.LUT(tags, lookup), np.uint8)


@dataclass(frozen=True)
class Frame:
    """The whole input of the chain at one instant: its messages, and the pixels that ``prepare`` decodes from them.

    ``camera`` is the front camera, to which ``image``, ``segmentation`` (tags of ``table``), ``instance_image`` and
    ``detections`` belong; ``depth_image`` belongs to ``depth_camera``. The left camera of a stereo pair is the front
    camera if ``left_camera`` is ``camera`` and ``left`` is None. Without a mounting (``mounted`` False) the transforms
    are those of a level camera at the assumed height. ``ego_T_lidar`` is None if no transform connects it with ego.
    ``is_origin`` says that odom begins at this frame: earlier frames only warmed up the chain. A missing input is None;
    an empty detections message is ().

    The chain's stages use ``tags`` (H, W), ``grey`` (H, W), ``stereo``, ``instances`` (H, W, 0 for no object) and
    ``raw_depth_m``: (H, W) metres along z, NaN unknown, in the image of ``depth_camera``. ``prepare`` takes it from the
    depth image, else from stereo, else from lidar (``depth_source``), and sets ``depth_camera`` to the camera of that
    depth, or without depth to the front camera. ``depth_limit_m`` is where the encoding saturates. Unusable inputs are
    None, with a reason in ``problems``.
    """

    stamp_ns: int
    camera: Camera
    ego_T_camera: Float
    depth_camera: Camera
    ego_T_depth_camera: Float
    left_camera: Camera
    ego_T_left: Float
    mounted: bool = False
    image: CameraImage | None = None
    left: CameraImage | None = None
    right: CameraImage | None = None
    right_camera: Camera | None = None
    depth_image: DepthImage | None = None
    segmentation: TagImage | None = None
    instance_image: InstanceImage | None = None
    detections: tuple[Detection, ...] | None = None
    points: PointCloud | None = None
    ego_T_lidar: Float | None = None
    is_origin: bool = False
    number: int | None = None
    """Number of the frame in the replay, for messages; None for a frame that is not written."""
    pose_mark: int | None = None
    """CRC-32 of the car's pose in the log. It says only whether the pose changed; None without one."""

    table: TagTable | None = None
    tags: Image | None = field(default=None, repr=False)
    grey: Image | None = field(default=None, repr=False)
    raw_depth_m: Float32 | None = field(default=None, repr=False)
    depth_limit_m: float = np.inf
    depth_source: SurfaceSource = "depth"
    inverse_depth_std: float = 0.0
    """Standard deviation of 1 / depth that the pixels of an object share, 1/m."""
    instances: Ids | None = field(default=None, repr=False)
    stereo: StereoDepth | Absent = field(default=_NOT_RUN, repr=False)
    problems: tuple[Reason, ...] = ()

    def __post_init__(self) -> None:
        read_only(self.ego_T_camera, np.float64, (4, 4), "ego_T_camera")
        read_only(self.ego_T_depth_camera, np.float64, (4, 4), "ego_T_depth_camera")
        if self.ego_T_lidar is not None:
            read_only(self.ego_T_lidar, np.float64, (4, 4), "ego_T_lidar")

    @classmethod
    def of(cls, stamp_ns: int, camera: Camera, ego_T_camera: Float, **inputs: Any) -> "Frame":
        """A frame whose depth and left image, if there are any, are of the front camera."""
        return cls(stamp_ns, camera, ego_T_camera, camera, ego_T_camera, camera, ego_T_camera, **inputs)

    @property
    def bgr(self) -> Image | None:
        """(H, W, 3) colours blue, green, red; None if ``grey`` is None."""
        return None if self.image is None or self.grey is None else self.image.bgr

    @property
    def image_unusable(self) -> bool:
        """Whether ``grey`` is None although the frame has an image."""
        return self.image is not None and self.grey is None

    @cached_property
    def depth_m(self) -> Float32 | None:
        """(H, W) depth in metres in the front camera's image."""
        depth_m = self.raw_depth_m
        if depth_m is not None and not self._is_depth_of_camera:
            depth_m = warp_depth(self.depth_camera, self._camera_T_depth, self.camera, depth_m)
        return None if depth_m is None else read_only(depth_m, np.float32, (None, None), "depth_m")

    @property
    def has_dense_depth(self) -> bool:
        """Whether most pixels have a depth; a lidar has few points."""
        return self.raw_depth_m is not None and self.depth_source != "lidar"

    @property
    def dense_depth_m(self) -> Float32 | None:
        """``depth_m`` if most pixels have a depth; None for lidar points."""
        return self.depth_m if self.has_dense_depth else None

    @cached_property
    def _is_depth_of_camera(self) -> bool:
        """Whether the depth is in the front camera's image, pixel by pixel."""
        is_here = np.allclose(self.ego_T_camera, self.ego_T_depth_camera, atol=_SAME_PLACE_M)
        return is_here and self.camera.same_view(self.depth_camera)

    @property
    def _camera_T_depth(self) -> Float:
        return inverse(self.ego_T_camera) @ self.ego_T_depth_camera

    @property
    def plane_source(self) -> str:
        """The source of the assumed road plane, in words."""
        return "the mounting" if self.mounted else "the assumed height"

    def labels(self, classes: tuple[str, ...]) -> Image | None:
        """(H, W) uint8, 1 at pixels of the classes, read-only; None without tags."""
        if self.table is None or self.tags is None:
            return None
        if classes not in self._labels:
            chosen = np.zeros(self.tags.shape, bool)
            for tag in self.table.tags_of(classes):  # for a few tags, a third of the time of ``mark``
                chosen |= self.tags == tag
            self._labels[classes] = read_only(chosen.view(np.uint8), np.uint8, (None, None), "labels")
        return self._labels[classes]

    def labels_of_depth(self, classes: tuple[str, ...]) -> Image | None:
        """(H, W) ``labels`` at the pixels of ``raw_depth_m``; None without tags or depth."""
        labels = self.labels(classes)
        if labels is None or self.raw_depth_m is None:
            return None
        if self._is_depth_of_camera:
            return labels
        return sample_labels(self.depth_camera, self._camera_T_depth, self.camera, self.raw_depth_m, labels)

    @cached_property
    def _labels(self) -> dict[tuple[str, ...], Image]:
        """A cache by classes, because several stages use the same."""
        return {}
