"""The input of the stages: a frame's decoded pixels, its depth from any source, and its detections."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from roadperc_stream.chain.kernels import mark
from roadperc_stream.geometry import Camera, Float, Float32, inverse
from roadperc_stream.geometry.arrays import read_only
from roadperc_stream.geometry.registration import sample_labels, warp_depth
from roadperc_stream.model import Absent, CameraImage, Detection, Ids, Image, Reason, StereoDepth, SurfaceSource
from roadperc_stream.model.tag_tables import TagTable

_NOT_RUN: Final = Absent(Reason("stereo", "not_run"))
_SAME_PLACE_M: Final = 1e-6


@dataclass(frozen=True)
class DepthMap:
    """(H, W) depth, metres along z, NaN unknown, with its camera; the encoding saturates at ``limit_m``."""

    depth_m: Float32
    camera: Camera
    ego_T_camera: Float
    limit_m: float
    source: SurfaceSource

    @property
    def dense(self) -> bool:
        """Whether most pixels have a depth; a lidar has few points."""
        return self.source != "lidar"

    def registered_to(self, camera: Camera, ego_T_camera: Float) -> Float32:
        """(h, w) depth in another camera's image."""
        if self._is_of(camera, ego_T_camera):
            return self.depth_m
        return warp_depth(self.camera, inverse(ego_T_camera) @ self.ego_T_camera, camera, self.depth_m)

    def labels_from(self, camera: Camera, ego_T_camera: Float, labels: Image) -> Image:
        """(H, W) another camera's (h, w) labels at the pixels of this depth."""
        if self._is_of(camera, ego_T_camera):
            return labels
        return sample_labels(self.camera, inverse(ego_T_camera) @ self.ego_T_camera, camera, self.depth_m, labels)

    def _is_of(self, camera: Camera, ego_T_camera: Float) -> bool:
        """Whether the depth is in that camera's image, pixel by pixel."""
        return np.allclose(ego_T_camera, self.ego_T_camera, atol=_SAME_PLACE_M) and camera.same_view(self.camera)


@dataclass(frozen=True)
class Scene:
    """One frame as input of the stages, with the decoded pixels that they need.

    ``camera`` is the front camera, to which ``tags`` (H, W, of ``table``), ``grey`` (H, W), ``instances`` (H, W, 0 for
    no object) and ``detections`` belong; ``depth`` may be from another camera. Missing and unusable
    inputs are None; an empty detections message is (). ``grey`` is decoded from ``image``.
    Without a mounting (``mounted`` False) ``ego_T_camera`` is that of a level camera at the assumed height.
    ``is_origin``, ``number`` and ``pose_mark`` as in ``Frame``. ``undecodable`` are the front camera's images that
    cannot be used, ``problems`` all other problems.
    """

    stamp_ns: int
    camera: Camera
    ego_T_camera: Float
    mounted: bool = False
    is_origin: bool = False
    tags: Image | None = None
    table: TagTable | None = None
    image: CameraImage | None = None
    grey: Image | None = None
    depth: DepthMap | None = None
    stereo: StereoDepth | Absent = _NOT_RUN
    detections: tuple[Detection, ...] | None = None
    instances: Ids | None = None
    undecodable: tuple[Reason, ...] = ()
    problems: tuple[Reason, ...] = ()
    number: int | None = None
    pose_mark: int | None = None

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
        depth_m = None if self.depth is None else self.depth.registered_to(self.camera, self.ego_T_camera)
        return None if depth_m is None else read_only(depth_m, np.float32, (None, None), "depth_m")

    @property
    def dense_depth_m(self) -> Float32 | None:
        """``depth_m`` if most pixels have a depth; None for lidar points."""
        return self.depth_m if self.depth is not None and self.depth.dense else None

    @property
    def depth_limit_m(self) -> float:
        """Depth at which the encoding saturates; infinite without depth."""
        return np.inf if self.depth is None else self.depth.limit_m

    @property
    def plane_source(self) -> str:
        """The source of the assumed road plane, in words."""
        return "the mounting" if self.mounted else "the assumed height"

    def labels(self, classes: tuple[str, ...]) -> Image | None:
        """(H, W) uint8, 1 at pixels of the classes, read-only; None without tags."""
        if self.table is None or self.tags is None:
            return None
        if classes not in self._labels:
            self._labels[classes] = mark(self.tags, self.table.lookup(classes))
            self._labels[classes].setflags(write=False)
        return self._labels[classes]

    @cached_property
    def _labels(self) -> dict[tuple[str, ...], Image]:
        """A cache by classes, because several stages use the same."""
        return {}
