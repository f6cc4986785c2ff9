"""The frame in which features are tracked, its features, and their matches in a later one.

The pyramidal Lucas-Kanade tracker (Bouguet 2000) follows Shi-Tomasi corners (1994). It keeps those that the backward
track returns to their start (Kalal, Mikolajczyk and Matas 2010). Descriptors are ORB (Rublee et al. 2011) or SIFT (Lowe
2004), with Lowe's ratio test. ORB's corners are whole pixels of a pyramid, so optical flow refines its matches to
sub-pixel accuracy.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.config import OdometryConfig, scaled
from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.geometry.ground import part
from roadperc_stream.model import Image, Mask, Surface, read_only
from roadperc_stream.model.frame import Frame, mark

_MOVABLE = ("vehicle", "pedestrian")
"""Classes on which no feature is detected or tracked."""
_PYRAMID_LEVELS = 4
_REFINING_LEVELS = 0
_FLOW_STOP: Final = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01)
_CORNER_BLOCK_PX = 5
_SMALLEST_WINDOW_PX = 5
MAX_POINTS: Final = 400
"""Points per keyframe. Twice as many take twice as long and hardly improve the motion."""
_CELL_PX: Final = 80.0
"""Side, at 960 rows, of the cells that share the points equally. Points all over the image determine the rotation."""
WINDOW_PX: Final = 20.0
"""Side, at 960 rows, of the window that flow compares. Corners keep this distance from each other and from movable
objects."""
FORWARD_BACKWARD_PX: Final = 1.0
"""Largest distance, at 960 rows, between a point and its forward and backward track."""
_MATCH_RATIO: Final = 0.8
"""Largest ratio of a match's descriptor distance to that of the second nearest (Lowe 2004)."""
_CORNER_FLOOR = 1e-5
"""Eigenvalue below which a window has too little texture to track."""
_CANDIDATES_PER_POINT = 4
_ORB_FAST_THRESHOLD = 7
_ORB_SMALLEST_SIDE_PX = 2
"""For smaller images OpenCV's pyramid is empty and its detector fails."""
_SIFT_CONTRAST = 0.01


@dataclass(frozen=True)
class TrackingFrame:
    """The frame in which features are tracked.

    ``camera``, ``grey`` and ``movable`` (uint8, nonzero on and around movable objects) are ``shrink`` times smaller
    than the frame; ``depth_m`` has its full size. ``road`` is in the camera's frame.
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
        """(N, 2) pixels of the frame from those of the tracked image; pixel centres are at integers in both."""
        return np.asarray((px + 0.5) * self.shrink - 0.5, np.float32)

    def on_movable(self, px: Float32) -> Mask:
        """(N,) which of (N, 2) pixels lie on movable objects; False for NaN."""
        on = np.zeros(len(px), bool)
        if self.movable is not None:
            known = np.isfinite(px).all(axis=1)
            columns, rows = np.rint(px[known]).astype(int).T
            on[known] = self.movable[rows, columns] > 0
        return on


@dataclass(frozen=True)
class Features:
    """(N, 2) float32 pixels in their image, and (N, D) descriptors; D = 0 for corners."""

    px: Float32
    descriptors: NDArray[Any]

    def __post_init__(self) -> None:
        read_only(self.px, np.float32, (None, 2), "px")
        self.descriptors.setflags(write=False)
        if len(self.descriptors) != len(self.px):
            raise ValueError(f"descriptors: expected {len(self.px)}, got {len(self.descriptors)}")

    def take(self, chosen: NDArray[Any]) -> "Features":
        """The features at a mask or indices."""
        return Features(self.px[chosen], self.descriptors[chosen])

    def joined(self, others: "Features") -> "Features":
        """These features, then the others."""
        return Features(*map(np.concatenate, ((self.px, others.px), (self.descriptors, others.descriptors))))


@dataclass(frozen=True)
class Frontend:
    """One way to detect features and to match them.

    ``detect(grey, allowed)`` returns the features of an image where ``allowed`` (uint8) is nonzero, and their (N,)
    strengths. ``match(cfg, before, features, guess_px, grey)`` finds the features of the image ``before`` in ``grey``.
    It returns their (N, 2) pixels, NaN if not found. Descriptors ignore the guess.
    """

    detect: Callable[[Image, Image], tuple[Features, Float32]]
    match: Callable[[OdometryConfig, Image, Features, Float32, Image], Float32]


def tracking_frame(cfg: OdometryConfig, frame: Frame, grey: Image, road: Surface | None) -> TrackingFrame:
    """The frame at the tracking resolution: halved while ``odometry.min_rows`` rows remain.

    ``grey`` is its (H, W) image, ``road`` the road in the front camera's frame.
    """
    camera, shrink = frame.camera, 1
    while grey.shape[0] % 2 == 0 and grey.shape[1] % 2 == 0 and grey.shape[0] // 2 >= cfg.min_rows:
        grey = np.asarray(cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)
        # Pixel centres are at integers: u becomes (u - 0.5) / 2.
        camera = replace(part(camera, 2, 2), cx=(camera.cx - 0.5) / 2, cy=(camera.cy - 0.5) / 2)
        shrink *= 2
    movable = _movable(frame, shrink)
    return TrackingFrame(camera, frame.ego_T_camera, grey, shrink, frame.dense_depth_m, movable, road, frame.stamp_ns)


def _movable(frame: Frame, shrink: int) -> Image | None:
    """(H, W) nonzero on movable objects of the tracked image, widened by half a window; None without tags."""
    if frame.tags is None or frame.table is None:
        return None
    movable = mark(frame.tags[::shrink, ::shrink], frame.table.lookup(_MOVABLE))
    if not movable.any():
        return movable
    side = max(round(scaled(WINDOW_PX, len(movable))), 1) | 1
    return np.asarray(cv2.dilate(movable, np.ones((side, side), np.uint8)), np.uint8)


def window_side(rows: int) -> int:
    """Odd side in pixels of the optical flow window in an image with this number of rows."""
    return max(round(scaled(WINDOW_PX, rows)), _SMALLEST_WINDOW_PX) | 1


def spread(px: Float32, strength: Float32, shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Indices of the strongest points of each cell, equally many from each: at most ``MAX_POINTS``.

    Cells grow until they are no more than the points. If border cells make the points too many, the weakest are
    dropped. The points are at (N, 2) pixels of an image of that shape, with (N,) strengths.
    """
    side = max(scaled(_CELL_PX, shape[0]), float(np.sqrt(shape[0] * shape[1] / MAX_POINTS)))
    columns = int(np.ceil(shape[1] / side))
    cell = (px[:, 1] // side).astype(int) * columns + (px[:, 0] // side).astype(int)
    order = np.lexsort((-strength, cell))
    by_cell = cell[order]
    rank = np.arange(len(order)) - np.searchsorted(by_cell, by_cell)
    each = max(MAX_POINTS // max(len(np.unique(cell)), 1), 1)
    chosen = order[rank < each]
    strongest = np.argsort(-strength[chosen], kind="stable")[:MAX_POINTS]
    return np.asarray(chosen[np.sort(strongest)])


def _detect_corners(grey: Image, allowed: Image) -> tuple[Features, Float32]:
    """Pixels whose smaller eigenvalue is the largest within a window."""
    strength = cv2.cornerMinEigenVal(grey, _CORNER_BLOCK_PX)
    side = window_side(grey.shape[0])
    highest = cv2.dilate(strength, np.ones((side, side), np.uint8))
    peaks = (strength == highest) & (strength > _CORNER_FLOOR) & allowed.view(bool)
    # np.nonzero of two axes takes several times as long.
    rows, columns = np.divmod(np.flatnonzero(peaks), grey.shape[1])
    px = np.stack((columns, rows), axis=-1).astype(np.float32)
    return Features(px, np.empty((len(px), 0), np.uint8)), np.asarray(strength[rows, columns], np.float32)


def _detect_orb(grey: Image, allowed: Image) -> tuple[Features, Float32]:
    none = np.empty((0, 32), np.uint8)
    if min(grey.shape) < _ORB_SMALLEST_SIDE_PX:
        return Features(np.empty((0, 2), np.float32), none), np.empty(0, np.float32)
    orb = cv2.ORB.create(nfeatures=_CANDIDATES_PER_POINT * MAX_POINTS, fastThreshold=_ORB_FAST_THRESHOLD)
    return _described(orb, grey, allowed, none)


def _detect_sift(grey: Image, allowed: Image) -> tuple[Features, Float32]:
    sift = cv2.SIFT.create(nfeatures=_CANDIDATES_PER_POINT * MAX_POINTS, contrastThreshold=_SIFT_CONTRAST)
    return _described(sift, grey, allowed, np.empty((0, 128), np.float32))


def _described(detector: Any, grey: Image, allowed: Image, none: NDArray[Any]) -> tuple[Features, Float32]:
    keypoints, descriptors = detector.detectAndCompute(grey, allowed)
    px = np.array([point.pt for point in keypoints], np.float32).reshape(-1, 2)
    strength = np.array([point.response for point in keypoints], np.float32)
    return Features(px, none if descriptors is None else descriptors), strength


def _follow(_: OdometryConfig, before: Image, features: Features, guess_px: Float32, grey: Image) -> Float32:
    return _flow(before, features.px, guess_px, grey, _PYRAMID_LEVELS)


def _match_orb(cfg: OdometryConfig, before: Image, features: Features, _: Float32, grey: Image) -> Float32:
    coarse = _nearest(cfg, features, _detect_orb(grey, np.full_like(grey, 255))[0], cv2.NORM_HAMMING)
    return _flow(before, features.px, coarse, grey, _REFINING_LEVELS)


def _match_sift(cfg: OdometryConfig, _: Image, features: Features, __: Float32, grey: Image) -> Float32:
    return _nearest(cfg, features, _detect_sift(grey, np.full_like(grey, 255))[0], cv2.NORM_L2)


def _flow(before: Image, px: Float32, guess_px: Float32, grey: Image, levels: int) -> Float32:
    """(N, 2) pixels by forward and backward optical flow from the guess (NaN: not tracked)."""
    found = np.full_like(px, np.nan)
    tried = np.isfinite(guess_px).all(axis=1)
    if not tried.any():
        return found
    side = window_side(grey.shape[0])

    def track(a: Image, b: Image, start: Float32, guess: Float32) -> tuple[Float32, NDArray[np.uint8]]:
        end, good, _ = cv2.calcOpticalFlowPyrLK(
            a,
            b,
            start[:, None],
            guess[:, None].copy(),
            winSize=(side, side),
            maxLevel=levels,
            criteria=_FLOW_STOP,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        return np.asarray(end, np.float32)[:, 0], np.asarray(good, np.uint8)[:, 0]

    chosen = np.flatnonzero(tried)
    there, good = track(before, grey, px[chosen], guess_px[chosen])
    inside = ((there >= 0) & (there <= np.array(grey.shape[::-1]) - 1)).all(axis=1)
    kept = good.astype(bool) & inside
    if not kept.any():
        return found
    chosen, there = chosen[kept], there[kept]
    back, returned = track(grey, before, there, px[chosen])
    miss = np.linalg.norm(back - px[chosen], axis=1)
    kept = returned.astype(bool) & (miss < scaled(FORWARD_BACKWARD_PX, grey.shape[0]))
    found[chosen[kept]] = there[kept]
    return found


def _nearest(cfg: OdometryConfig, features: Features, others: Features, norm: int) -> Float32:
    """(N, 2) pixels of the features' matches among others, by the ratio test; each match is used once."""
    found = np.full_like(features.px, np.nan)
    if len(features.px) == 0 or len(others.px) < 2:
        return found
    matcher = _flann(norm) if cfg.matcher == "flann" else cv2.BFMatcher(norm)
    pairs = matcher.knnMatch(features.descriptors, others.descriptors, k=2)
    clear = [p[0] for p in pairs if len(p) == 2 and p[0].distance < _MATCH_RATIO * p[1].distance]
    # Later entries win, so the nearest match of a feature remains.
    best = {match.trainIdx: match for match in sorted(clear, key=lambda match: -match.distance)}
    for match in best.values():
        found[match.queryIdx] = others.px[match.trainIdx]
    return found


def _flann(norm: int) -> cv2.DescriptorMatcher:
    """A FLANN matcher: k-d trees, or locality-sensitive hashing for binary descriptors."""
    trees = {"algorithm": 1, "trees": 4}
    hashing = {"algorithm": 6, "table_number": 6, "key_size": 12, "multi_probe_level": 1}
    index: dict[str, Any] = hashing if norm == cv2.NORM_HAMMING else trees
    return cv2.FlannBasedMatcher(index, {"checks": 64})


FRONTENDS: Final[dict[Literal["klt", "orb", "sift"], Frontend]] = {
    "klt": Frontend(_detect_corners, _follow),
    "orb": Frontend(_detect_orb, _match_orb),
    "sift": Frontend(_detect_sift, _match_sift),
}
