"""One frame of visual odometry: match the keyframe's features, estimate the motion, keep or change the keyframe."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from roadperc_stream.chain.stages.odometry import camera_pitch
from roadperc_stream.chain.stages.odometry.camera_pitch import LINES_STD, CameraPitch, pitch_by_lines
from roadperc_stream.chain.stages.odometry.features import FRONTENDS, TrackingFrame, tracking_frame
from roadperc_stream.chain.stages.odometry.keyframes import (
    Keyframe,
    LastFrame,
    OdometryState,
    carry,
    is_due,
    make_keyframe,
)
from roadperc_stream.chain.stages.odometry.localisation import Estimate, localised, predicted_px
from roadperc_stream.chain.stages.odometry.motion import in_ego_axes, moved, step_covariance
from roadperc_stream.chain.stages.odometry.road_scale import Scale
from roadperc_stream.config import OdometryConfig, scaled
from roadperc_stream.geometry import Float, Float32, inverse, project, transform
from roadperc_stream.geometry.rotations import rotation_vector
from roadperc_stream.model import Absent, Matches, Odometry, Reason, Surface
from roadperc_stream.model.scene import Scene
from roadperc_stream.system.time import NS_PER_S

_SCALE_REASONS: Final[dict[Scale | None, Reason]] = {
    "carried": Reason("odometry", "scale_carried"),
    "none": Reason("odometry", "scale_unknown"),
}
_ASTRAY_PX = 20.0
"""Distance, at 960 rows, from the pixel that steady motion predicts beyond which something else was found."""
MIN_INLIER_RATIO: Final = 0.25
"""Share of the points in sight that must agree on a steady motion, twice that on an unforeseen one."""


def step(
    cfg: OdometryConfig,
    state: OdometryState,
    scene: Scene,
    road: Surface | None,
    rng: np.random.Generator,
) -> tuple[OdometryState, Odometry | Absent]:
    """Follow the camera from the last frames to this one.

    The keyframe outlives frames that are missing: the first one found again continues from it, and no motion is lost.
    Where its points are not found again, the frame is lost and becomes the keyframe, at the last pose known.

    Args:
        cfg: thresholds.
        state: what the last frame left.
        scene: the frame, later than the last one; without a grey image it is missing, without dense depth the motion
            comes from the image alone; pixels of vehicles and pedestrians are left out.
        road: the road in the front camera's frame, which gives the scale where there is no depth; None: it is not
            known.
        rng: seeds OpenCV's random numbers.

    Returns:
        The new state, and the pose; absent where there has been no image yet.
    """
    if scene.grey is None:
        why = Reason("odometry", "image_unusable" if scene.image_unusable else "no_image")
        missed = scene.image_unusable or state.keyframe is not None
        return state, _lost(state.odom_T_ego, why) if missed else Absent(why)
    cv2.setRNGSeed(int(rng.integers(2**31)))
    frame = tracking_frame(cfg, scene, scene.grey, road)
    state = replace(state, pitch=_with_lines(camera_pitch.begun(cfg) if state.pitch is None else state.pitch, frame))
    if state.keyframe is None or state.last is None:
        return _begun(cfg, state, frame), Odometry("first", state.odom_T_ego)
    estimate = _estimated(cfg, state, state.keyframe, state.last, frame)
    if isinstance(estimate, Absent):
        unsure = replace(state, pitch=_pitch_after_loss(cfg, state, state.keyframe, state.last, frame))
        return _begun(cfg, unsure, frame), _lost(state.odom_T_ego, estimate.reason)
    return _continued(cfg, state.odom_T_ego, state.keyframe, state.last, frame, estimate)


def _lost(odom_T_ego: Float, reason: Reason) -> Odometry:
    return Odometry("lost", odom_T_ego, reason=reason)


def _with_lines(pitch: CameraPitch, frame: TrackingFrame) -> CameraPitch:
    """The pitch after the road's lines, where it is less sure than they are and no depth shows the road.

    They shorten the start of a drive; nobody believes them without one, for a yard and a bend have lines too.
    """
    road_is_measured = frame.depth_m is not None or (frame.road is not None and frame.road.source != "assumed")
    if road_is_measured or pitch.variance < LINES_STD**2:
        return pitch
    lines = pitch_by_lines(frame.camera, frame.ego_T_camera, frame.grey, frame.movable)
    return replace(camera_pitch.updated(pitch, lines), measured=pitch.measured)


def _pitch_after_loss(
    cfg: OdometryConfig, state: OdometryState, keyframe: Keyframe, last: LastFrame, frame: TrackingFrame
) -> CameraPitch:
    """The pitch after frames between which nothing was found again; of another camera the mounting's."""
    if state.pitch is None or frame.camera != keyframe.camera:
        return camera_pitch.begun(cfg)
    return camera_pitch.after_loss(cfg, state.pitch, (frame.stamp_ns - last.stamp_ns) / NS_PER_S)


def _begun(cfg: OdometryConfig, state: OdometryState, frame: TrackingFrame) -> OdometryState:
    """A frame as keyframe, at the last pose known."""
    keyframe = make_keyframe(cfg, frame, state.odom_T_ego @ frame.ego_T_camera)
    px = keyframe.landmarks.features.px
    return replace(state, keyframe=keyframe, last=LastFrame(frame.stamp_ns, None, px, np.zeros((len(px), 6))))


def _continued(
    cfg: OdometryConfig,
    odom_T_last: Float,
    keyframe: Keyframe,
    last: LastFrame,
    frame: TrackingFrame,
    estimate: Estimate,
) -> tuple[OdometryState, Odometry]:
    """The state and pose after a frame whose motion is known."""
    motion = estimate.motion
    metric = keyframe.landmarks.metric and motion.scaled
    seconds = (frame.stamp_ns - last.stamp_ns) / NS_PER_S
    last_T_this = inverse(odom_T_last) @ estimate.odom_T_ego
    influence = in_ego_axes(frame.ego_T_camera, motion.influence)
    key_px = keyframe.landmarks.features.px
    out = Odometry(
        "tracked",
        estimate.odom_T_ego,
        last_T_this,
        int(np.sum(motion.inliers)),
        not metric,
        step_covariance(
            key_px,
            frame.camera.width,
            influence,
            last.influence,
            last_T_this,
            motion.length_variance + last.length_variance,
        ),
        last.stamp_ns,
        _SCALE_REASONS.get(estimate.scale),
        _matches(keyframe, frame, estimate),
    )
    if not motion.scaled and estimate.scale is None:
        keyframe = replace(keyframe, landmarks=replace(keyframe.landmarks, points_m=motion.points_m, metric=metric))
    found_px, length_variance = np.where(np.isfinite(estimate.px), estimate.px, last.found_px), motion.length_variance
    if estimate.scale is not None:
        length_variance = estimate.noise_variance
    if is_due(cfg, keyframe, frame, estimate.px, motion.inliers):
        carried = carry(keyframe.landmarks, motion, estimate.px)
        keyframe = make_keyframe(cfg, frame, estimate.odom_T_ego @ frame.ego_T_camera, carried)
        found_px = keyframe.landmarks.features.px
        influence, length_variance = np.zeros((len(found_px), 6)), 0.0
    now = LastFrame(
        frame.stamp_ns,
        _velocity(last_T_this, seconds),
        found_px,
        influence,
        length_variance,
        estimate.noise_variance / seconds**2 if metric and estimate.scale is not None else None,
    )
    return OdometryState(estimate.odom_T_ego, keyframe, now, estimate.pitch), out


def _matches(keyframe: Keyframe, frame: TrackingFrame, estimate: Estimate) -> Matches:
    """What was found again, in pixels of the whole images."""
    found = np.isfinite(estimate.px).all(axis=1)
    key_px = frame.whole(keyframe.landmarks.features.px[found])
    return Matches(key_px, frame.whole(estimate.px[found]), estimate.motion.inliers[found])


def _estimated(
    cfg: OdometryConfig, state: OdometryState, keyframe: Keyframe, last: LastFrame, frame: TrackingFrame
) -> Estimate | Absent:
    """The first plausible motion, or why there is none."""
    if frame.camera != keyframe.camera:
        return Absent(Reason("odometry", "camera_changed"))
    odom_T_last, rejected = state.odom_T_ego, Reason("odometry", "too_few_inliers")
    for guess_px, near_px, ratio in _guesses(odom_T_last, keyframe, last, frame):
        px = FRONTENDS[cfg.features].match(cfg, keyframe.grey, keyframe.landmarks.features, guess_px, frame.grey)
        astray = np.linalg.norm(px - near_px, axis=1) > scaled(_ASTRAY_PX, frame.grey.shape[0])
        px[astray | frame.on_movable(px)] = np.nan
        estimate = localised(cfg, state, keyframe, last, frame, px)
        if estimate is None:
            continue
        if np.sum(estimate.motion.inliers) < max(ratio * _findable(keyframe, frame, estimate), cfg.min_inliers):
            continue
        if _possible(cfg, keyframe, last, frame, estimate, inverse(odom_T_last) @ estimate.odom_T_ego):
            return estimate
        rejected = Reason("odometry", "impossible_motion")
    return Absent(rejected)


def _guesses(
    odom_T_last: Float, keyframe: Keyframe, last: LastFrame, frame: TrackingFrame
) -> Iterator[tuple[Float32, Float32, float]]:
    """(N, 2) pixels where features are searched, (N, 2) near which they must be found, and the share that must agree.

    First where they are if the car moved on as it did, and only near there: a road's texture repeats itself, and its
    next repetition is a consistent motion too. Then, if need be, around where they were found last; NaN: anywhere.
    """
    if last.velocity is not None:
        seconds = (frame.stamp_ns - last.stamp_ns) / NS_PER_S
        odom_T_camera = odom_T_last @ moved(last.velocity * seconds) @ frame.ego_T_camera
        camera_T_key = inverse(odom_T_camera) @ keyframe.odom_T_camera
        predicted = project(frame.camera, transform(camera_T_key, keyframe.landmarks.points_m)).astype(np.float32)
        yield np.where(np.isfinite(predicted), predicted, last.found_px), predicted, MIN_INLIER_RATIO
    yield last.found_px, np.full_like(last.found_px, np.nan), 2 * MIN_INLIER_RATIO


def _possible(
    cfg: OdometryConfig,
    keyframe: Keyframe,
    last: LastFrame,
    frame: TrackingFrame,
    estimate: Estimate,
    last_T_this: Float,
) -> bool:
    """Whether a car can make the motion; without scale its speed is not known."""
    velocity = _velocity(last_T_this, (frame.stamp_ns - last.stamp_ns) / NS_PER_S)
    speed, turn_rate = np.linalg.norm(velocity.reshape(2, 3), axis=1)
    fast = keyframe.landmarks.metric and estimate.motion.scaled and speed > cfg.max_speed_mps
    return not fast and bool(turn_rate <= np.deg2rad(cfg.max_turn_rate_dps))


def _findable(keyframe: Keyframe, frame: TrackingFrame, estimate: Estimate) -> int:
    """How many features the motion predicts in the image, where all points are known; else how many were found."""
    if keyframe.landmarks.source != "depth":
        return int(np.sum(np.isfinite(estimate.px[:, 0])))
    return int(np.sum(np.isfinite(predicted_px(keyframe, frame, estimate.motion.this_T_key)[:, 0])))


def _velocity(last_T_this: Float, seconds: float) -> Float:
    """(6,) metres and radians per second."""
    turned = rotation_vector(last_T_this[:3, :3])
    return np.concatenate((last_T_this[:3, 3], turned)) / seconds
