"""The calls of OpenCV that following corners from frame to frame takes: what odometry cannot do without."""

from typing import Final

import cv2
import numpy as np

from roadperc_stream.chain.stages.odometry.features import FORWARD_BACKWARD_PX, MAX_POINTS, WINDOW_PX
from roadperc_stream.chain.stages.odometry.keyframes import KEYFRAME_FLOW_PX, KEYFRAME_SHARE
from roadperc_stream.config import OdometryConfig, scaled

from .course import FARTHEST_M, Times
from .course_log import Array

_LEVELS: Final = 4
_STOP: Final = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01)
_CORNER_QUALITY: Final = 1e-3
_LEAST_POINTS: Final = 6


class Tracking:
    """Corners of a keyframe, found again in each frame by flow there and back, and the camera's motion by them.

    A frame becomes the next keyframe by the chain's own rule: few corners are left, or they have moved far.
    """

    def __init__(self, cfg: OdometryConfig, K: Array, times: Times) -> None:
        self._cfg, self._times = cfg, times
        self._K = np.array(K, float)
        self._keyframe: tuple[Array, Array, Array] | None = None
        self._found = np.empty((0, 2), np.float32)
        self._motion: tuple[Array, Array] = np.zeros(3), np.zeros(3)
        self.keyframes = 0

    def step(self, grey: Array, depth_m: Array) -> None:
        """A frame's image, (H, W) uint8, and its depth."""
        shrink = 1
        while grey.shape[0] // 2 >= self._cfg.min_rows:
            with self._times("track"):
                grey = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            shrink *= 2
        K = np.diag((1 / shrink, 1 / shrink, 1.0)) @ self._K
        if self._keyframe is None:
            self._begin(grey, depth_m, K, shrink)
            return
        before, px, points_m = self._keyframe
        there, good = self._followed(before, grey, px)
        if good.sum() >= _LEAST_POINTS:
            self._locate(points_m[good], there[good], K)
        self._found = there
        shift = float(np.median(np.linalg.norm((there - px)[good], axis=1))) if good.any() else np.inf
        if good.mean() < KEYFRAME_SHARE or shift > scaled(KEYFRAME_FLOW_PX, grey.shape[0]):
            self._begin(grey, depth_m, K, shrink)

    def _begin(self, grey: Array, depth_m: Array, K: Array, shrink: int) -> None:
        """Detect the corners of a keyframe."""
        self.keyframes += 1
        side = self._side(grey)
        with self._times("track"):
            found = cv2.goodFeaturesToTrack(grey, MAX_POINTS, _CORNER_QUALITY, side, blockSize=5)
        px = np.empty((0, 2), np.float32) if found is None else np.asarray(found, np.float32).reshape(-1, 2)
        columns, rows = np.rint((px + 0.5) * shrink - 0.5).astype(int).T
        z = depth_m[rows, columns]
        known = (z > 0) & (z < FARTHEST_M)
        px, z = px[known], z[known]
        rays = np.column_stack((px, np.ones(len(px)))) @ np.linalg.inv(K).T
        self._keyframe = grey, px, rays * z[:, np.newaxis]
        self._found, self._motion = px, (np.zeros(3), np.zeros(3))

    def _followed(self, before: Array, grey: Array, px: Array) -> tuple[Array, Array]:
        """(N, 2) pixels of the corners in this image, and (N,) which of them were found."""
        if not len(px):
            return px, np.zeros(0, bool)
        with self._times("track"):
            there, found = self._flow(before, grey, px, self._found)
            back, returned = self._flow(grey, before, there, px)
        miss = np.linalg.norm(back - px, axis=1)
        return there, found & returned & (miss < scaled(FORWARD_BACKWARD_PX, grey.shape[0]))

    def _flow(self, first: Array, second: Array, px: Array, guess: Array) -> tuple[Array, Array]:
        side = self._side(first)
        there, found, _ = cv2.calcOpticalFlowPyrLK(
            first,
            second,
            px,
            guess.copy(),
            winSize=(side, side),
            maxLevel=_LEVELS,
            criteria=_STOP,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        return there, found.ravel().astype(bool)

    def _locate(self, points_m: Array, px: Array, K: Array) -> None:
        rotation, translation = (part.copy() for part in self._motion)
        with self._times("track"):
            _, turned, moved = cv2.solvePnP(
                points_m, px.astype(float), K, None, rotation, translation, True, cv2.SOLVEPNP_ITERATIVE
            )
        self._motion = turned.ravel(), moved.ravel()

    def _side(self, grey: Array) -> int:
        """Of the window that is compared, pixels."""
        return max(round(scaled(WINDOW_PX, grey.shape[0])), 5) | 1
