"""What is remembered of a keyframe, when the next one is due, and what is carried over to it.

Every motion is measured against the last keyframe, not the last frame, so that a car standing still keeps its keyframe
and does not drift.
"""

from dataclasses import dataclass, replace

import numpy as np

from roadperc_stream.chain.stages.odometry.features import scaled
from roadperc_stream.chain.stages.odometry.motion import Motion
from roadperc_stream.chain.stages.odometry.places import Places, place_features
from roadperc_stream.chain.stages.odometry.views import View
from roadperc_stream.core.config import OdometryConfig
from roadperc_stream.core.datatypes import Image, Mask, read_only
from roadperc_stream.core.geometry import Camera, Float, Float32, transform


@dataclass(frozen=True)
class Keyframe:
    """An image, what is known of its features, and its pose."""

    camera: Camera
    grey: Image
    places: Places
    odom_T_camera: Float
    stamp_ns: int

    def __post_init__(self) -> None:
        read_only(self.odom_T_camera, np.float64, (4, 4), "odom_T_camera")


def make_keyframe(cfg: OdometryConfig, view: View, odom_T_camera: Float, carried: Places | None = None) -> Keyframe:
    """A frame at a pose as the keyframe of the next ones, with what was carried along into it."""
    return Keyframe(view.camera, view.grey, place_features(cfg, view, carried), odom_T_camera, view.stamp_ns)


def is_due(cfg: OdometryConfig, keyframe: Keyframe, view: View, px: Float32, inliers: Mask) -> bool:
    """Whether the frame must become the next keyframe: few points are left, or they have moved far.

    One that has depth is not given up early for a frame that has none.

    Args:
        cfg: thresholds.
        keyframe: the current one.
        view: the frame.
        px: (N, 2) where its features are in the frame.
        inliers: (N,) those that agree on the motion.
    """
    share = float(np.sum(inliers)) / max(len(px), 1)
    if keyframe.places.source == "depth" and view.depth_m is None:
        return share < cfg.keyframe_share / 2 or int(np.sum(inliers)) < 2 * cfg.min_inliers
    shift = float(np.median(np.linalg.norm(px[inliers] - keyframe.places.features.px[inliers], axis=1)))
    return share < cfg.keyframe_share or shift > scaled(cfg.keyframe_flow_px, view.grey.shape[0])


def carry(places: Places, motion: Motion, px: Float32) -> Places:
    """The features that agree on a motion, at their (N, 2) pixels in its frame, with their points in its camera."""
    kept = motion.inliers
    features = replace(places.features.take(kept), px=px[kept])
    points_m = transform(motion.this_T_key, motion.points_m[kept])
    return Places(features, points_m, places.slope[kept], "carried", places.metric)
