"""The motion of one camera without depth.

Its direction comes from the rays of the features. Its length comes from the road, from triangulated points, or from the
last known speed.
"""

from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from roadperc_stream.chain.stages.odometry import camera_pitch
from roadperc_stream.chain.stages.odometry.epipolar import motion_from_rays, parallax_px
from roadperc_stream.chain.stages.odometry.followed import MIN_INLIER_RATIO, Estimate, FollowedFrame
from roadperc_stream.chain.stages.odometry.motion import Motion, motion_from_points, standing_motion
from roadperc_stream.chain.stages.odometry.road_scale import Expected, scaled_by_road
from roadperc_stream.geometry import Float, Float32
from roadperc_stream.system.time import NS_PER_S

_FIRST_LENGTH = 1.0
"""Length of the first step in a log without a metric scale: the unit of its path."""
_POINTS_SHARE: Final = 0.02
"""Standard deviation of a length by triangulated points, as a share."""
_SEARCH_SHARE: Final = 0.03
"""Standard deviation by which the search for a length extends beyond the possible lengths, as a share."""
_SIGMAS: Final = 3.0
_UNKNOWN_MPS2: Final = 2.0
"""Acceleration of a car whose last speed is unknown: one standard deviation in town."""


def localised_without_depth(this: FollowedFrame, px: Float32) -> Estimate | None:
    """The estimate without depth: the length comes from the road, from triangulated points or from the last speed."""
    frame, landmarks = this.frame, this.keyframe.landmarks
    key_px, points_m = landmarks.features.px, landmarks.triangulated_m
    unit = min(this.speed.per_s * this.seconds if this.speed else _FIRST_LENGTH, this.cfg.max_speed_mps * this.seconds)
    motion = motion_from_rays(frame.camera, key_px, px, points_m, unit or _FIRST_LENGTH, this.expected_this_T_key)
    if motion is None or not motion.scaled:
        motion = _by_points(this, points_m, px) or motion
    if motion is None:
        return None
    pitch, findable = this.turned_pitch(this.pose(motion)), int(np.sum(np.isfinite(px[:, 0])))
    if not motion.this_T_key[:3, 3].any():
        motion = standing_motion(frame.camera, landmarks.points_m, key_px, px, motion)
        return Estimate(px, motion, this.pose(motion), pitch, findable)
    direction = camera_pitch.expansion(motion, frame.ego_T_camera, key_px, frame.camera.width)
    pitch = camera_pitch.updated(pitch, direction)
    if landmarks.source == "plane":
        shift_px, expected = parallax_px(frame.camera, key_px, px, motion), _expected_length(this, motion)
        acceleration = partial(_acceleration_mps2, this)
        motion, pitch = scaled_by_road(
            frame, this.keyframe, motion, pitch, *expected, acceleration, parallax_px=shift_px
        )
    elif not motion.scaled:
        motion = _in_units(this, motion)
    return Estimate(px, motion, this.pose(motion), pitch, findable)


def _in_units(this: FollowedFrame, motion: Motion) -> Motion:
    """A motion whose scale nothing shows: after a start without a metric scale, its length is the path's unit."""
    if this.keyframe.landmarks.metric or this.last.velocity is not None:
        return replace(motion, scale="none")
    return replace(motion, scaled=True, scale=None if this.speed is None else "carried")


def _by_points(this: FollowedFrame, points_m: Float, px: Float32) -> Motion | None:
    """The motion by known points: while the car stops and drives off, rays hardly show its direction.

    Points that are unknown do not contradict it.
    """
    motion = motion_from_points(this.frame.camera, points_m, px, this.expected_this_T_key)
    found, known = np.isfinite(px[:, 0]), np.isfinite(points_m[:, 2])
    least = max(2 * MIN_INLIER_RATIO * np.sum(found & known), this.cfg.min_inliers)
    if motion is None or np.sum(motion.inliers) < least:
        return None
    return replace(motion, inliers=motion.inliers | (found & ~known))


def _expected_length(this: FollowedFrame, motion: Motion) -> tuple[Expected | None, tuple[float, float]]:
    """The length since the keyframe by triangulated points, else by the last speed, and the range of possible lengths.

    The length is None if neither is known.
    """
    last, seconds, speed = this.last, this.seconds, this.metric_speed
    driven_m = _driven_m(this)
    least, most = (limit * seconds for limit in this.limits_mps((_SEARCH_SHARE * speed.per_s) ** 2 if speed else 0.0))
    reach_m = _SIGMAS * float(np.sqrt(last.length_variance))
    tried_m = max(driven_m + (least or -most) - reach_m, 0.0), driven_m + most + reach_m
    if motion.scaled:
        length_m = float(np.linalg.norm(motion.this_T_key[:3, 3]))
        share = this.keyframe.landmarks.scale_variance + _POINTS_SHARE**2
        return Expected(length_m, motion.length_variance + share * length_m**2), tried_m
    if speed is None:
        return None, tried_m
    variance = speed.variance_after((this.middle_ns - speed.stamp_ns) / NS_PER_S)
    return Expected(driven_m + speed.per_s * seconds, last.length_variance + variance * seconds**2), tried_m


def _acceleration_mps2(this: FollowedFrame, length_m: float, variance: float) -> float:
    """Least size of the acceleration since the last speed, by a length since the keyframe with its variance."""
    if (speed := this.metric_speed) is None:
        return _UNKNOWN_MPS2
    seconds = (this.middle_ns - speed.stamp_ns) / NS_PER_S
    change_mps = abs((length_m - _driven_m(this)) / this.seconds - speed.per_s)
    variance = (variance + this.last.length_variance) / this.seconds**2 + speed.variance
    return max(change_mps - _SIGMAS * float(np.sqrt(variance)), 0.0) / seconds


def _driven_m(this: FollowedFrame) -> float:
    """Distance of the camera from the keyframe at the last frame."""
    return float(np.linalg.norm((this.odom_T_last @ this.frame.ego_T_camera - this.keyframe.odom_T_camera)[:3, 3]))
