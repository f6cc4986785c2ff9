"""The frame in which features are tracked: halved as long as it keeps enough rows."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from roadperc_stream.core.config import OdometryConfig, scaled
from roadperc_stream.core.datatypes import Image, Mask, Surface
from roadperc_stream.core.geometry import Camera, Float, Float32
from roadperc_stream.core.kernels.class_pixels import mark
from roadperc_stream.core.scene import Scene

_MOVABLE = ("vehicle", "pedestrian")
"""Classes on which no feature is detected or tracked."""


@dataclass(frozen=True)
class TrackingFrame:
    """The frame in which features are tracked.

    ``camera``, ``grey`` and ``movable`` (uint8, not 0 on movable objects and around them) are ``shrink`` times smaller
    than the frame, ``depth_m`` is not. ``road`` is in the camera's frame.
    """

    camera: Camera
    ego_T_camera: Float
    grey: Image
    shrink: int
    depth_m: Float32 | None
    movable: Image | None
    road: Surface | None
    stamp_ns: int

    def whole(self, px: Float32) -> Float32:
        """(N, 2) pixels of the tracked image in the frame's: pixel centres are at integers in both."""
        return np.asarray((px + 0.5) * self.shrink - 0.5, np.float32)

    def on_movable(self, px: Float32) -> Mask:
        """(N,) which of (N, 2) pixels lie on movable objects; NaN lies on none."""
        on = np.zeros(len(px), bool)
        if self.movable is not None:
            known = np.isfinite(px).all(axis=1)
            columns, rows = np.rint(px[known]).astype(int).T
            on[known] = self.movable[rows, columns] > 0
        return on


def tracking_frame(cfg: OdometryConfig, scene: Scene, grey: Image, road: Surface | None) -> TrackingFrame:
    """The frame at the resolution in which features are tracked.

    Args:
        cfg: its least number of rows.
        scene: the frame.
        grey: (H, W) its image.
        road: the road in the front camera's frame; None: it is not known.
    """
    camera, shrink = scene.camera, 1
    while grey.shape[0] % 2 == 0 and grey.shape[1] % 2 == 0 and grey.shape[0] // 2 >= cfg.min_rows:
        grey = np.asarray(cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)
        camera = _halved(camera)
        shrink *= 2
    movable = _movable(cfg, scene, grey)
    return TrackingFrame(camera, scene.ego_T_camera, grey, shrink, scene.dense_depth_m, movable, road, scene.stamp_ns)


def _halved(camera: Camera) -> Camera:
    """Pixel centres are at integers: u becomes (u - 0.5) / 2."""
    return replace(
        camera,
        width=camera.width // 2,
        height=camera.height // 2,
        fx=camera.fx / 2,
        fy=camera.fy / 2,
        cx=(camera.cx - 0.5) / 2,
        cy=(camera.cy - 0.5) / 2,
    )


def _movable(cfg: OdometryConfig, scene: Scene, grey: Image) -> Image | None:
    """Movable objects in the tracked image, and as far around them as a window reaches; None without tags."""
    if scene.tags is None or scene.table is None:
        return None
    rows, columns = grey.shape
    tags = cv2.resize(scene.tags, (columns, rows), interpolation=cv2.INTER_NEAREST)
    movable: Image = mark(np.asarray(tags, np.uint8), scene.table.lookup(_MOVABLE))
    if not movable.any():
        return movable
    side = max(round(scaled(cfg.window_px, rows)), 1) | 1
    return np.asarray(cv2.dilate(movable, np.ones((side, side), np.uint8)), np.uint8)
