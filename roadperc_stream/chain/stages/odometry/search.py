"""The search for the first motion that a car can make.

With depth the features are aligned where a steady motion predicts them. Without depth, or if they are not near, they
are matched there, then near their last pixels; ORB is the last resort.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from roadperc_stream.chain.stages.odometry import keyframes
from roadperc_stream.chain.stages.odometry.alignment import aligned
from roadperc_stream.chain.stages.odometry.features import FRONTENDS
from roadperc_stream.chain.stages.odometry.followed import MIN_INLIER_RATIO, Estimate, FollowedFrame
from roadperc_stream.chain.stages.odometry.motion import motion_from_points
from roadperc_stream.chain.stages.odometry.rivals import along_path, best_shift
from roadperc_stream.chain.stages.odometry.without_depth import localised_without_depth
from roadperc_stream.config import scaled
from roadperc_stream.geometry import Float, Float32, project, transform
from roadperc_stream.model import Absent, Reason

_ASTRAY_PX = 20.0
"""Largest distance, at 960 rows, from the pixel that steady motion predicts; farther matches are wrong."""
MIN_VISIBLE_SHARE: Final = 0.2
"""Minimum share of the visible points with depth that agree on a steady motion by matches. A motion by aligned
patches, or an unexpected one, needs twice that. Noise hides most points of a smooth road."""
_NEAR_PX: Final = 0.6
"""Median distance, at 960 rows, of aligned features from their predicted pixels, above which the nearest points are
too far off to be aligned. Without them distant points agree with any speed."""
_MOST_MATCHED: Final = 200
"""Number of features with depth that are matched: their motion predicts all others well enough to align them."""
_DEPTH_JITTER_M: Final = 0.07
"""Standard deviation of the difference of two steps by depth with 30 % noise; their covariances do not show it."""


def estimated(this: FollowedFrame) -> Estimate | Absent:
    """The first plausible motion; absent with a reason if no motion is plausible."""
    if this.frame.camera != this.keyframe.camera:
        return Absent(Reason("odometry", "camera_changed"))
    rejected = Reason("odometry", "too_few_inliers")
    for estimate, ratio, expected in _estimates(this):
        if np.sum(estimate.motion.inliers) < max(ratio * estimate.findable, this.cfg.min_inliers):
            continue
        impossible = _impossible(this, estimate)
        if impossible is None:
            return _verified(this, estimate, expected=expected)
        rejected = impossible
    return Absent(rejected)


def _estimates(this: FollowedFrame) -> Iterator[tuple[Estimate, float, bool]]:
    """Estimates, the share of the findable features that must agree, and whether each continues the last motion."""
    cfg, frame, keyframe = this.cfg, this.frame, this.keyframe
    has_depth = keyframe.landmarks.source == "depth"
    if has_depth and cfg.features == "klt" and (steady := _steady(this)) is not None:
        yield steady, 2 * MIN_VISIBLE_SHARE, True
    for guess_px, near_px, ratio in guesses(this):
        start_px = _few_inside(guess_px, frame.grey.shape) if has_depth else guess_px
        px = FRONTENDS[cfg.features].match(cfg, keyframe.grey, keyframe.landmarks.features, start_px, frame.grey)
        astray = np.linalg.norm(px - near_px, axis=1) > scaled(_ASTRAY_PX, frame.grey.shape[0])
        px[astray | frame.on_movable(px)] = np.nan
        estimate = _localised(this, px)
        if estimate is not None:
            yield estimate, ratio, bool(np.isfinite(near_px).any())


def _steady(this: FollowedFrame) -> Estimate | None:
    """The motion with depth if the features look as the continued last motion predicts, near their predicted pixels."""
    if (start := this.expected_this_T_key) is None:
        return None
    px, predicted_px = aligned(this.keyframe, this.frame, start)
    return _located(this, px, predicted_px, start) if _are_near(this, px, predicted_px) else None


def estimated_by_orb(this: FollowedFrame, failed: Absent) -> tuple[FollowedFrame, Estimate | Absent]:
    """The motion by ORB features of the keyframe; the failure of optical flow if it is not plausible."""
    cfg = this.cfg.model_copy(update={"features": "orb"})
    keyframe, last = keyframes.detected_again(cfg, this.keyframe, this.last, this.frame)
    wide = replace(this, keyframe=keyframe, last=last)
    estimate = estimated(replace(wide, cfg=cfg))
    return (this, failed) if isinstance(estimate, Absent) else (wide, replace(estimate, by_orb=True))


def _verified(this: FollowedFrame, estimate: Estimate, *, expected: bool) -> Estimate:
    """The estimate after a search for other shifts that fit both images and depths, unless it continues a sure motion.

    If another shift fits better, it replaces the estimate. Shifts that fit about as well enlarge the variance.
    """
    keyframe, frame = this.keyframe, this.frame
    sure = expected and (this.speed is None or this.speed.variance == 0)
    if keyframe.landmarks.source != "depth" or frame.depth_m is None or sure:
        return estimate
    shift_m, std_m = best_shift(keyframe, frame, estimate.motion.this_T_key)
    if shift_m:
        estimate = _shifted(this, estimate, shift_m)
    return replace(estimate, motion=replace(estimate.motion, length_variance=std_m**2, noise_variance=std_m**2))


def _shifted(this: FollowedFrame, estimate: Estimate, shift_m: float) -> Estimate:
    """The estimate at a shift along the car's path; the estimate itself if the features do not agree there."""
    shifted = _aligned_from(this, along_path(this.frame, shift_m) @ estimate.motion.this_T_key)
    if shifted is None or np.sum(shifted.motion.inliers) < this.cfg.min_inliers or _impossible(this, shifted):
        return estimate
    return shifted


def guesses(this: FollowedFrame) -> Iterator[tuple[Float32, Float32, float]]:
    """(N, 2) pixels where the search starts, (N, 2) pixels near which matches must lie, and the share that must agree.

    The first guess continues the last motion and accepts only matches near it: a road's texture repeats, and matches
    shifted by one repetition also agree on a motion. The second guess is the last pixels; NaN accepts any match.
    """
    frame, keyframe, last = this.frame, this.keyframe, this.last
    share = MIN_VISIBLE_SHARE if keyframe.landmarks.source == "depth" else MIN_INLIER_RATIO
    if (this_T_key := this.expected_this_T_key) is not None:
        predicted = project(frame.camera, transform(this_T_key, keyframe.landmarks.points_m)).astype(np.float32)
        yield np.where(np.isfinite(predicted), predicted, last.found_px), predicted, share
    yield last.found_px, np.full_like(last.found_px, np.nan), 2 * share


def _few_inside(px: Float32, shape: tuple[int, ...]) -> Float32:
    """(N, 2) pixels of which at most ``_MOST_MATCHED`` inside an image of that shape remain, NaN for the others."""
    inside = np.flatnonzero(((px >= 0) & (px <= np.array(shape[::-1]) - 1)).all(axis=1))
    few, chosen = np.full_like(px, np.nan), inside[:: -(-len(inside) // _MOST_MATCHED) or 1]
    few[chosen] = px[chosen]
    return few


def _impossible(this: FollowedFrame, estimate: Estimate) -> Reason | None:
    """Why a car cannot make the motion; None if it can. Without scale only the turn rate is checked."""
    motion = estimate.motion
    speed, turn_rate = np.linalg.norm(this.velocity(estimate.odom_T_ego).reshape(2, 3), axis=1)
    fast = motion.scaled and speed > this.cfg.max_speed_mps
    if fast or not turn_rate <= np.deg2rad(this.cfg.max_turn_rate_dps):
        return Reason("odometry", "impossible_motion")
    landmarks = this.keyframe.landmarks
    hidden_m2 = _DEPTH_JITTER_M**2 if landmarks.source == "depth" else 0.0
    least, most = this.limits_mps((motion.length_variance + hidden_m2) / this.seconds**2)
    if landmarks.metric and motion.scaled and not least <= speed <= most:
        return Reason("odometry", "impossible_acceleration", (float(speed), least, most))
    return None


def _localised(this: FollowedFrame, px: Float32) -> Estimate | None:
    """The motion estimated from the features' pixels, and the pose that follows."""
    camera, landmarks = this.frame.camera, this.keyframe.landmarks
    if landmarks.source != "depth":
        return localised_without_depth(this, px)
    motion = motion_from_points(camera, landmarks.points_m, px)
    if motion is None:
        return None
    return _aligned_from(this, motion.this_T_key)


def _aligned_from(this: FollowedFrame, start: Float) -> Estimate | None:
    """The motion with depth by features aligned where a start predicts them, and once more if they were not near."""
    px, predicted_px = aligned(this.keyframe, this.frame, start)
    estimate = _located(this, px, predicted_px, start)
    if estimate is None or _are_near(this, px, predicted_px):
        return estimate
    start = estimate.motion.this_T_key
    return _located(this, *aligned(this.keyframe, this.frame, start), start)


def _are_near(this: FollowedFrame, px: Float32, predicted_px: Float32) -> bool:
    """Whether (N, 2) aligned features, NaN not found, are near their predicted pixels."""
    off_px = np.linalg.norm(px - predicted_px, axis=1)
    off_px = off_px[np.isfinite(off_px)]
    return len(off_px) > 0 and bool(np.median(off_px) < scaled(_NEAR_PX, this.frame.grey.shape[0]))


def _located(this: FollowedFrame, px: Float32, predicted_px: Float32, start: Float) -> Estimate | None:
    """The motion with depth by aligned features, from a start that predicts them, and the pose that follows."""
    motion = motion_from_points(this.frame.camera, this.keyframe.landmarks.points_m, px, start)
    if motion is None:
        return None
    odom_T_ego, findable = this.pose(motion), int(np.sum(np.isfinite(predicted_px[:, 0])))
    return Estimate(px, motion, odom_T_ego, this.turned_pitch(odom_T_ego), findable)
