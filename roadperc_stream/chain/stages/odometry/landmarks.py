"""Landmarks: features of a frame with their points, by depth, by the road's plane, or triangulated by motions."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from roadperc_stream.chain.stages.odometry.features import FRONTENDS, Features, spread
from roadperc_stream.chain.stages.odometry.local_planes import local_planes_from_depth, slope_of_plane
from roadperc_stream.chain.stages.odometry.tracking_frame import TrackingFrame
from roadperc_stream.core.config import OdometryConfig
from roadperc_stream.core.datatypes import Image, Mask, read_only
from roadperc_stream.core.geometry import Float, Float32, intersect_plane, transform, unproject

LandmarkSource = Literal["depth", "plane", "carried"]
_ROAD_AHEAD_M: Final = (2.0, 20.0)
_ROAD_HALF_WIDTH_M = 3.0
"""Where the road is, in front of the car, if no depth says it (ego frame)."""


@dataclass(frozen=True)
class Landmarks:
    """(N,) features, their (N, 3) points in the camera's frame, and the (N, 2) slope of 1 / depth around each.

    The slope is in 1/m per pixel to the right and down. Unknown is NaN; ``metric`` says whether lengths are in metres.
    """

    features: Features
    points_m: Float
    slope: Float
    source: LandmarkSource
    metric: bool

    def __post_init__(self) -> None:
        read_only(self.points_m, np.float64, (None, 3), "points_m")
        read_only(self.slope, np.float64, (None, 2), "slope")

    @property
    def known(self) -> Mask:
        """(N,) which features have a point."""
        return np.isfinite(self.points_m[:, 2])


def find_landmarks(cfg: OdometryConfig, frame: TrackingFrame, carried: Landmarks | None) -> Landmarks:
    """Features of a frame with their points by the best source there is.

    Args:
        cfg: how features are found.
        frame: the frame.
        carried: landmarks tracked into the frame; they stay where neither depth nor plane is there.
    """
    return _by_depth(cfg, frame) or _on_road(cfg, frame) or _carried_on(cfg, frame, carried)


def _by_depth(cfg: OdometryConfig, frame: TrackingFrame) -> Landmarks | None:
    """Features where depth is known; None without depth, or where too few have one."""
    if frame.depth_m is None:
        return None
    with np.errstate(invalid="ignore"):
        near = frame.depth_m[:: frame.shrink, :: frame.shrink] < np.float32(cfg.max_depth_m)
    features = _detected(cfg, frame, near.view(np.uint8))
    inverse_depth, slope = local_planes_from_depth(frame.depth_m, features.px.astype(float), frame.shrink)
    known = inverse_depth > 1.0 / cfg.max_depth_m
    if int(np.sum(known)) < 2 * cfg.min_inliers:
        return None
    features = features.take(known)
    points_m = unproject(frame.camera, features.px.astype(float), 1.0 / inverse_depth[known])
    return Landmarks(features, points_m, slope[known], "depth", metric=True)


def _on_road(cfg: OdometryConfig, frame: TrackingFrame) -> Landmarks | None:
    """Features anywhere; those that show the road in front of the car lie on its plane. None without a plane."""
    if frame.road is None:
        return None
    features = _detected(cfg, frame, np.ones(frame.grey.shape, np.uint8))
    px = features.px.astype(float)
    points_m = intersect_plane(frame.camera, px, frame.road.plane)
    x, y, _ = transform(frame.ego_T_camera, points_m).T
    near, far = _ROAD_AHEAD_M
    points_m[~((x > near) & (x < far) & (np.abs(y) < _ROAD_HALF_WIDTH_M))] = np.nan
    slope = np.broadcast_to(slope_of_plane(frame.camera, frame.road.plane), px.shape)
    return Landmarks(features, points_m, slope, "plane", metric=True)


def _carried_on(cfg: OdometryConfig, frame: TrackingFrame, carried: Landmarks | None) -> Landmarks:
    """The landmarks tracked into the frame, and new features between them, whose points are unknown."""
    features, strength = _candidates(cfg, frame, np.ones(frame.grey.shape, np.uint8))
    points_m = np.full((len(features.px), 3), np.nan)
    if carried is not None:
        features, points_m = carried.features.joined(features), np.concatenate((carried.points_m, points_m))
        strength = np.concatenate((np.full(len(carried.points_m), np.inf, np.float32), strength))
    chosen = spread(cfg, features.px, strength, frame.grey.shape)
    slope = np.full((len(chosen), 2), np.nan)
    return Landmarks(features.take(chosen), points_m[chosen], slope, "carried", carried is not None and carried.metric)


def _detected(cfg: OdometryConfig, frame: TrackingFrame, allowed: Image) -> Features:
    features, strength = _candidates(cfg, frame, allowed)
    return features.take(spread(cfg, features.px, strength, frame.grey.shape))


def _candidates(cfg: OdometryConfig, frame: TrackingFrame, allowed: Image) -> tuple[Features, Float32]:
    if frame.movable is not None:
        allowed = allowed & (frame.movable == 0)
    return FRONTENDS[cfg.features].detect(cfg, frame.grey, allowed)
