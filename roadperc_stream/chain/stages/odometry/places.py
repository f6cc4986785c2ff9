"""Features of a frame and where they lie: by depth, by the road's plane, or by the motions that triangulated them."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from roadperc_stream.chain.stages.odometry.facets import facets_from_depth, slope_of_plane
from roadperc_stream.chain.stages.odometry.features import FRONTENDS, Features, spread
from roadperc_stream.chain.stages.odometry.views import View
from roadperc_stream.core.config import OdometryConfig
from roadperc_stream.core.datatypes import Image, Mask, read_only
from roadperc_stream.core.geometry import Float, Float32, intersect_plane, transform, unproject

PlaceSource = Literal["depth", "plane", "carried"]
_ROAD_AHEAD_M: Final = (2.0, 20.0)
_ROAD_HALF_WIDTH_M = 3.0
"""Where the road is, in front of the car, if no depth says it (ego frame)."""


@dataclass(frozen=True)
class Places:
    """(N,) features, their (N, 3) points in the camera's frame, and the (N, 2) slope of 1 / depth around each.

    The slope is in 1/m per pixel to the right and down. Unknown is NaN; ``metric`` says whether lengths are in metres.
    """

    features: Features
    points_m: Float
    slope: Float
    source: PlaceSource
    metric: bool

    def __post_init__(self) -> None:
        read_only(self.points_m, np.float64, (None, 3), "points_m")
        read_only(self.slope, np.float64, (None, 2), "slope")

    @property
    def known(self) -> Mask:
        """(N,) which features have a place."""
        return np.isfinite(self.points_m[:, 2])


def place_features(cfg: OdometryConfig, view: View, carried: Places | None) -> Places:
    """Features of a frame, placed by the best there is.

    Args:
        cfg: how features are found.
        view: the frame.
        carried: features followed into the frame; they stay where neither depth nor plane is there.
    """
    return _by_depth(cfg, view) or _on_road(cfg, view) or _beside_carried(cfg, view, carried)


def _by_depth(cfg: OdometryConfig, view: View) -> Places | None:
    """Features where depth is known; None without depth, or where it places too few."""
    if view.depth_m is None:
        return None
    with np.errstate(invalid="ignore"):
        near = view.depth_m[:: view.shrink, :: view.shrink] < np.float32(cfg.max_depth_m)
    features = _detected(cfg, view, near.view(np.uint8))
    inverse_depth, slope = facets_from_depth(view.depth_m, features.px.astype(float), view.shrink)
    placed = inverse_depth > 1.0 / cfg.max_depth_m
    if int(np.sum(placed)) < 2 * cfg.min_inliers:
        return None
    features = features.take(placed)
    points_m = unproject(view.camera, features.px.astype(float), 1.0 / inverse_depth[placed])
    return Places(features, points_m, slope[placed], "depth", metric=True)


def _on_road(cfg: OdometryConfig, view: View) -> Places | None:
    """Features anywhere; those that show the road in front of the car lie on its plane. None without a plane."""
    if view.road is None:
        return None
    features = _detected(cfg, view, np.ones(view.grey.shape, np.uint8))
    px = features.px.astype(float)
    points_m = intersect_plane(view.camera, px, view.road.plane)
    x, y, _ = transform(view.ego_T_camera, points_m).T
    near, far = _ROAD_AHEAD_M
    points_m[~((x > near) & (x < far) & (np.abs(y) < _ROAD_HALF_WIDTH_M))] = np.nan
    slope = np.broadcast_to(slope_of_plane(view.camera, view.road.plane), px.shape)
    return Places(features, points_m, slope, "plane", metric=True)


def _beside_carried(cfg: OdometryConfig, view: View, carried: Places | None) -> Places:
    """What is carried along, and new features where it leaves room, whose place is unknown."""
    features, strength = _candidates(cfg, view, np.ones(view.grey.shape, np.uint8))
    points_m = np.full((len(features.px), 3), np.nan)
    if carried is not None:
        features, points_m = carried.features.joined(features), np.concatenate((carried.points_m, points_m))
        strength = np.concatenate((np.full(len(carried.points_m), np.inf, np.float32), strength))
    chosen = spread(cfg, features.px, strength, view.grey.shape)
    slope = np.full((len(chosen), 2), np.nan)
    return Places(features.take(chosen), points_m[chosen], slope, "carried", carried is not None and carried.metric)


def _detected(cfg: OdometryConfig, view: View, allowed: Image) -> Features:
    features, strength = _candidates(cfg, view, allowed)
    return features.take(spread(cfg, features.px, strength, view.grey.shape))


def _candidates(cfg: OdometryConfig, view: View, allowed: Image) -> tuple[Features, Float32]:
    if view.movable is not None:
        allowed = allowed & (view.movable == 0)
    return FRONTENDS[cfg.features].detect(cfg, view.grey, allowed)
