"""The motion of one frame against the keyframe, by depth where the keyframe has it, else by the image alone.

Only a shift is searched: the stretch follows from the motion and the local planes. Features that matching lost are
found again where the motion predicts them, as in SVO (Forster, Pizzoli and Scaramuzza 2014).
"""

from dataclasses import dataclass

import numpy as np

from roadperc_stream.chain.kernels import align_patches
from roadperc_stream.chain.kernels.odometry_plain import REACH_PX
from roadperc_stream.chain.stages.odometry import camera_pitch
from roadperc_stream.chain.stages.odometry.camera_pitch import CameraPitch
from roadperc_stream.chain.stages.odometry.epipolar import motion_from_rays
from roadperc_stream.chain.stages.odometry.features import TrackingFrame
from roadperc_stream.chain.stages.odometry.keyframes import Keyframe, LastFrame, OdometryState, stretch
from roadperc_stream.chain.stages.odometry.motion import Motion, motion_from_points
from roadperc_stream.chain.stages.odometry.road_scale import Expected, Scale, expected_length, scaled_by_road
from roadperc_stream.config import OdometryConfig
from roadperc_stream.geometry import Float, Float32, inverse, project, transform
from roadperc_stream.system.time import NS_PER_S

_ITERATIONS = 4
_FARTHEST_PX = 1.5
"""Shift beyond which the alignment has found something else."""
_LEAST_CORRELATION = 0.7
_FIRST_LENGTH = 1.0
"""Length of the first step where its scale is not known."""


@dataclass(frozen=True)
class Estimate:
    """The (N, 2) pixels of the keyframe's features in a frame, and the motion and pose estimated from them.

    ``scale`` is None where the length comes from the features' own points, and ``noise_variance`` then 0.
    """

    px: Float32
    motion: Motion
    odom_T_ego: Float
    pitch: CameraPitch
    scale: Scale | None = None
    noise_variance: float = 0.0


def aligned(keyframe: Keyframe, frame: TrackingFrame, this_T_key: Float) -> Float32:
    """(N, 2) pixels of the keyframe's features in a frame, NaN where they do not look as predicted.

    Args:
        keyframe: with points and slopes.
        frame: the frame.
        this_T_key: the motion.
    """
    landmarks = keyframe.landmarks
    predicted = predicted_px(keyframe, frame, this_T_key)
    chosen = np.flatnonzero(np.isfinite(predicted[:, 0]) & np.isfinite(landmarks.slope[:, 0]))
    found = np.full_like(predicted, np.nan)
    if not len(chosen):
        return found
    key_px, start = landmarks.features.px[chosen], predicted[chosen]
    stretched = stretch(
        frame.camera, key_px.astype(float), landmarks.points_m[chosen, 2], landmarks.slope[chosen], this_T_key
    )
    px = start.astype(float)
    correlation = align_patches(keyframe.grey, key_px.astype(float), stretched, frame.grey, px, _ITERATIONS)
    good = (np.linalg.norm(px - start, axis=1) < _FARTHEST_PX) & (correlation > _LEAST_CORRELATION)
    found[chosen[good]] = px[good]
    return found


def predicted_px(keyframe: Keyframe, frame: TrackingFrame, this_T_key: Float) -> Float32:
    """(N, 2) pixels where a motion predicts the features, NaN outside the image or on movable objects."""
    px = project(frame.camera, transform(this_T_key, keyframe.landmarks.points_m)).astype(np.float32)
    inside = ((px >= REACH_PX) & (px <= np.array(frame.grey.shape[::-1]) - 1 - REACH_PX)).all(axis=1)
    px[~inside] = np.nan
    px[frame.on_movable(px)] = np.nan
    return px


def localised(
    cfg: OdometryConfig,
    state: OdometryState,
    keyframe: Keyframe,
    last: LastFrame,
    frame: TrackingFrame,
    px: Float32,
) -> Estimate | None:
    """The motion estimated from the features' pixels, and the pose that follows."""
    landmarks = keyframe.landmarks
    if landmarks.source != "depth":
        return _localised_without_depth(cfg, state, keyframe, last, frame, px)
    motion = motion_from_points(frame.camera, landmarks.points_m, px)
    if motion is not None:
        px = aligned(keyframe, frame, motion.this_T_key)
        motion = motion_from_points(frame.camera, landmarks.points_m, px, motion.this_T_key)
    if motion is None:
        return None
    odom_T_ego = _pose(keyframe, frame, motion)
    return Estimate(px, motion, odom_T_ego, _turned(cfg, state, last, frame, odom_T_ego))


def _localised_without_depth(
    cfg: OdometryConfig,
    state: OdometryState,
    keyframe: Keyframe,
    last: LastFrame,
    frame: TrackingFrame,
    px: Float32,
) -> Estimate | None:
    """The same, the length by the road where that is known, else by points triangulated before."""
    features_px, on_road = keyframe.landmarks.features.px, keyframe.landmarks.source == "plane"
    seconds = (frame.stamp_ns - keyframe.stamp_ns) / NS_PER_S
    length = _FIRST_LENGTH if last.velocity is None else float(np.linalg.norm(last.velocity[:3])) * seconds
    points_m = np.full_like(keyframe.landmarks.points_m, np.nan) if on_road else keyframe.landmarks.points_m
    motion = motion_from_rays(frame.camera, features_px, px, points_m, length)
    if motion is None:
        return None
    pitch = _turned(cfg, state, last, frame, _pose(keyframe, frame, motion))
    if not motion.this_T_key[:3, 3].any():
        return Estimate(px, motion, _pose(keyframe, frame, motion), pitch)
    direction = camera_pitch.expansion(motion, frame.ego_T_camera, features_px, frame.camera.width)
    pitch = camera_pitch.updated(pitch, direction)
    if not on_road:
        return Estimate(px, motion, _pose(keyframe, frame, motion), pitch)
    expected = _expected(state.odom_T_ego, keyframe, last, frame)
    found = scaled_by_road(frame, keyframe.grey, motion, pitch, expected, cfg.max_speed_mps * seconds)
    odom_T_ego = _pose(keyframe, frame, found.motion)
    return Estimate(px, found.motion, odom_T_ego, found.pitch, found.scale, found.noise_variance)


def _pose(keyframe: Keyframe, frame: TrackingFrame, motion: Motion) -> Float:
    """odom_T_ego after a motion from the keyframe."""
    return keyframe.odom_T_camera @ inverse(motion.this_T_key) @ inverse(frame.ego_T_camera)


def _turned(
    cfg: OdometryConfig, state: OdometryState, last: LastFrame, frame: TrackingFrame, odom_T_ego: Float
) -> CameraPitch:
    """The pitch as it has turned with the camera since the last frame."""
    pitch = camera_pitch.begun(cfg) if state.pitch is None else state.pitch
    seconds = (frame.stamp_ns - last.stamp_ns) / NS_PER_S
    return camera_pitch.predicted(cfg, pitch, inverse(state.odom_T_ego) @ odom_T_ego, seconds)


def _expected(odom_T_last: Float, keyframe: Keyframe, last: LastFrame, frame: TrackingFrame) -> Expected | None:
    """The distance from the keyframe by the speed so far; None where the road has shown none."""
    if last.velocity is None or last.speed_variance is None:
        return None
    driven_m = float(np.linalg.norm((odom_T_last @ frame.ego_T_camera - keyframe.odom_T_camera)[:3, 3]))
    speed_mps = float(np.linalg.norm(last.velocity[:3]))
    seconds = (frame.stamp_ns - last.stamp_ns) / NS_PER_S
    return expected_length(driven_m, last.length_variance, speed_mps, last.speed_variance, seconds)
