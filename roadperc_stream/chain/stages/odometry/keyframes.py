"""What is kept of a keyframe, when the next one is due, and which landmarks are carried over to it.

Every motion is measured against the last keyframe, not the last frame, so that a car standing still keeps its keyframe
and does not drift.
"""

from dataclasses import dataclass, replace

import numpy as np

from roadperc_stream.chain.stages.odometry.landmarks import Landmarks, find_landmarks
from roadperc_stream.chain.stages.odometry.motion import Motion
from roadperc_stream.chain.stages.odometry.tracking_frame import TrackingFrame
from roadperc_stream.core.config import OdometryConfig, scaled
from roadperc_stream.core.datatypes import Image, Mask, read_only
from roadperc_stream.core.geometry import Camera, Float, Float32, transform


@dataclass(frozen=True)
class Keyframe:
    """An image, its landmarks, and its pose."""

    camera: Camera
    grey: Image
    landmarks: Landmarks
    odom_T_camera: Float
    stamp_ns: int

    def __post_init__(self) -> None:
        read_only(self.odom_T_camera, np.float64, (4, 4), "odom_T_camera")


def make_keyframe(
    cfg: OdometryConfig, frame: TrackingFrame, odom_T_camera: Float, carried: Landmarks | None = None
) -> Keyframe:
    """A frame at a pose as the keyframe of the next ones, with the landmarks tracked into it."""
    return Keyframe(frame.camera, frame.grey, find_landmarks(cfg, frame, carried), odom_T_camera, frame.stamp_ns)


def is_due(cfg: OdometryConfig, keyframe: Keyframe, frame: TrackingFrame, px: Float32, inliers: Mask) -> bool:
    """Whether the frame must become the next keyframe: few points are left, or they have moved far.

    One that has depth is not given up early for a frame that has none.

    Args:
        cfg: thresholds.
        keyframe: the current one.
        frame: the frame.
        px: (N, 2) where its features are in the frame.
        inliers: (N,) those that agree on the motion.
    """
    share = float(np.sum(inliers)) / max(len(px), 1)
    if keyframe.landmarks.source == "depth" and frame.depth_m is None:
        return share < cfg.keyframe_share / 2 or int(np.sum(inliers)) < 2 * cfg.min_inliers
    shift = float(np.median(np.linalg.norm(px[inliers] - keyframe.landmarks.features.px[inliers], axis=1)))
    return share < cfg.keyframe_share or shift > scaled(cfg.keyframe_flow_px, frame.grey.shape[0])


def carry(landmarks: Landmarks, motion: Motion, px: Float32) -> Landmarks:
    """The landmarks that agree on a motion, at their (N, 2) pixels in its frame, with their points in its camera."""
    kept = motion.inliers
    features = replace(landmarks.features.take(kept), px=px[kept])
    points_m = transform(motion.this_T_key, motion.points_m[kept])
    return Landmarks(features, points_m, landmarks.slope[kept], "carried", landmarks.metric)
