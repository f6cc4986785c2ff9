"""One frame of visual odometry: match the keyframe's features, estimate the motion, keep or change the keyframe."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from roadperc_stream.chain.stages.odometry.epipolar import motion_from_rays
from roadperc_stream.chain.stages.odometry.features import FRONTENDS
from roadperc_stream.chain.stages.odometry.keyframes import Keyframe, carry, is_due, make_keyframe
from roadperc_stream.chain.stages.odometry.motion import Motion, motion_from_points, moved
from roadperc_stream.chain.stages.odometry.patch_alignment import aligned, predicted_px
from roadperc_stream.chain.stages.odometry.tracking_frame import TrackingFrame, tracking_frame
from roadperc_stream.chain.stages.odometry.uncertainty import in_ego_axes, step_covariance
from roadperc_stream.core.config import OdometryConfig, scaled
from roadperc_stream.core.datatypes import Absent, Matches, Odometry, Reason, Surface, read_only
from roadperc_stream.core.geometry import Float, Float32, inverse, project, transform
from roadperc_stream.core.scene import Scene
from roadperc_stream.core.time import NS_PER_S

_FIRST_LENGTH = 1.0
"""Length of the first step where its scale is not known."""
_ASTRAY_PX = 20.0
"""Distance, at 960 rows, from the pixel that steady motion predicts beyond which something else was found."""


@dataclass(frozen=True)
class LastFrame:
    """The last frame whose pose is known, or at which the odometry began anew.

    ``velocity`` is (6,) metres and radians per second in the ego frame, None before there are two frames. ``found_px``
    is (N, 2), where the keyframe's features were found last. ``influence`` is (N, 6), how far each of them
    pulls the pose against the keyframe, in ego's axes, None where that is not known; ``length_variance`` is that of the
    distance from the keyframe, in square metres, beyond what they show.
    """

    stamp_ns: int
    velocity: Float | None
    found_px: Float32
    influence: Float | None
    length_variance: float = 0.0

    def __post_init__(self) -> None:
        read_only(self.found_px, np.float32, (None, 2), "found_px")
        for name, array, shape in (("velocity", self.velocity, (6,)), ("influence", self.influence, (None, 6))):
            if array is not None:
                read_only(array, np.float64, shape, name)


@dataclass(frozen=True)
class OdometryState:
    """What the odometry remembers from one frame to the next."""

    odom_T_ego: Float = field(default_factory=lambda: np.eye(4))
    keyframe: Keyframe | None = None
    last: LastFrame | None = None


@dataclass(frozen=True)
class _Estimate:
    """The (N, 2) pixels of the keyframe's features in a frame, and the motion and pose estimated from them."""

    px: Float32
    motion: Motion
    odom_T_ego: Float


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
    if state.keyframe is None or state.last is None:
        return _begun(cfg, state.odom_T_ego, frame), Odometry("first", state.odom_T_ego)
    estimate = _estimated(cfg, state.odom_T_ego, state.keyframe, state.last, frame)
    if isinstance(estimate, Absent):
        return _begun(cfg, state.odom_T_ego, frame), _lost(state.odom_T_ego, estimate.reason)
    return _continued(cfg, state.odom_T_ego, state.keyframe, state.last, frame, estimate)


def counted_from_here(state: OdometryState) -> OdometryState:
    """The state with odom where ego is now."""
    if state.keyframe is None:
        return replace(state, odom_T_ego=np.eye(4))
    here_T_camera = inverse(state.odom_T_ego) @ state.keyframe.odom_T_camera
    return replace(state, odom_T_ego=np.eye(4), keyframe=replace(state.keyframe, odom_T_camera=here_T_camera))


def _lost(odom_T_ego: Float, reason: Reason) -> Odometry:
    return Odometry("lost", odom_T_ego, reason=reason)


def _begun(cfg: OdometryConfig, odom_T_ego: Float, frame: TrackingFrame) -> OdometryState:
    """A frame as keyframe, at a pose that is given."""
    keyframe = make_keyframe(cfg, frame, odom_T_ego @ frame.ego_T_camera)
    px = keyframe.landmarks.features.px
    return OdometryState(odom_T_ego, keyframe, LastFrame(frame.stamp_ns, None, px, np.zeros((len(px), 6))))


def _continued(
    cfg: OdometryConfig,
    odom_T_last: Float,
    keyframe: Keyframe,
    last: LastFrame,
    frame: TrackingFrame,
    estimate: _Estimate,
) -> tuple[OdometryState, Odometry]:
    """The state and pose after a frame whose motion is known."""
    motion = estimate.motion
    metric = keyframe.landmarks.metric and motion.scaled
    last_T_this = inverse(odom_T_last) @ estimate.odom_T_ego
    influence, length_variance = in_ego_axes(frame.ego_T_camera, motion.influence), motion.length_variance
    key_px = keyframe.landmarks.features.px
    out = Odometry(
        "tracked",
        estimate.odom_T_ego,
        last_T_this,
        int(np.sum(motion.inliers)),
        not metric,
        step_covariance(
            key_px, frame.camera.width, influence, last.influence, last_T_this, length_variance + last.length_variance
        ),
        last.stamp_ns,
        matches=_matches(keyframe, frame, estimate),
    )
    if not motion.scaled:
        keyframe = replace(keyframe, landmarks=replace(keyframe.landmarks, points_m=motion.points_m, metric=metric))
    found_px = np.where(np.isfinite(estimate.px), estimate.px, last.found_px)
    if is_due(cfg, keyframe, frame, estimate.px, motion.inliers):
        carried = carry(keyframe.landmarks, motion, estimate.px)
        keyframe = make_keyframe(cfg, frame, estimate.odom_T_ego @ frame.ego_T_camera, carried)
        found_px = keyframe.landmarks.features.px
        influence, length_variance = np.zeros((len(found_px), 6)), 0.0
    velocity = _velocity(last_T_this, (frame.stamp_ns - last.stamp_ns) / NS_PER_S)
    now = LastFrame(frame.stamp_ns, velocity, found_px, influence, length_variance)
    return OdometryState(estimate.odom_T_ego, keyframe, now), out


def _matches(keyframe: Keyframe, frame: TrackingFrame, estimate: _Estimate) -> Matches:
    """What was found again, in pixels of the whole images."""
    found = np.isfinite(estimate.px).all(axis=1)
    key_px = frame.whole(keyframe.landmarks.features.px[found])
    return Matches(key_px, frame.whole(estimate.px[found]), estimate.motion.inliers[found])


def _estimated(
    cfg: OdometryConfig, odom_T_last: Float, keyframe: Keyframe, last: LastFrame, frame: TrackingFrame
) -> _Estimate | Absent:
    """The first plausible motion, or why there is none."""
    if frame.camera != keyframe.camera:
        return Absent(Reason("odometry", "camera_changed"))
    rejected = Reason("odometry", "too_few_inliers")
    for guess_px, near_px, ratio in _guesses(cfg, odom_T_last, keyframe, last, frame):
        px = FRONTENDS[cfg.features].match(cfg, keyframe.grey, keyframe.landmarks.features, guess_px, frame.grey)
        astray = np.linalg.norm(px - near_px, axis=1) > scaled(_ASTRAY_PX, frame.grey.shape[0])
        px[astray | frame.on_movable(px)] = np.nan
        estimate = _localised(cfg, keyframe, last, frame, px)
        if estimate is None:
            continue
        if np.sum(estimate.motion.inliers) < max(ratio * _findable(keyframe, frame, estimate), cfg.min_inliers):
            continue
        if _possible(cfg, keyframe, last, frame, estimate, inverse(odom_T_last) @ estimate.odom_T_ego):
            return estimate
        rejected = Reason("odometry", "impossible_motion")
    return Absent(rejected)


def _guesses(
    cfg: OdometryConfig, odom_T_last: Float, keyframe: Keyframe, last: LastFrame, frame: TrackingFrame
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
        yield np.where(np.isfinite(predicted), predicted, last.found_px), predicted, cfg.min_inlier_ratio
    yield last.found_px, np.full_like(last.found_px, np.nan), min(2 * cfg.min_inlier_ratio, 1.0)


def _localised(
    cfg: OdometryConfig, keyframe: Keyframe, last: LastFrame, frame: TrackingFrame, px: Float32
) -> _Estimate | None:
    """The motion estimated from the features' pixels, and the pose that follows."""
    landmarks = keyframe.landmarks
    if landmarks.source == "depth":
        motion = motion_from_points(cfg, frame.camera, landmarks.points_m, px)
        if motion is not None:
            px = aligned(keyframe, frame, motion.this_T_key)
            motion = motion_from_points(cfg, frame.camera, landmarks.points_m, px, motion.this_T_key)
    else:
        length = _FIRST_LENGTH
        if last.velocity is not None:
            length = float(np.linalg.norm(last.velocity[:3])) * (frame.stamp_ns - keyframe.stamp_ns) / NS_PER_S
        motion = motion_from_rays(cfg, frame.camera, landmarks.features.px, px, landmarks.points_m, length)
    if motion is None:
        return None
    return _Estimate(px, motion, keyframe.odom_T_camera @ inverse(motion.this_T_key) @ inverse(frame.ego_T_camera))


def _possible(
    cfg: OdometryConfig,
    keyframe: Keyframe,
    last: LastFrame,
    frame: TrackingFrame,
    estimate: _Estimate,
    last_T_this: Float,
) -> bool:
    """Whether a car can make the motion; without scale its speed is not known."""
    velocity = _velocity(last_T_this, (frame.stamp_ns - last.stamp_ns) / NS_PER_S)
    speed, turn_rate = np.linalg.norm(velocity.reshape(2, 3), axis=1)
    fast = keyframe.landmarks.metric and estimate.motion.scaled and speed > cfg.max_speed_mps
    return not fast and bool(turn_rate <= np.deg2rad(cfg.max_turn_rate_dps))


def _findable(keyframe: Keyframe, frame: TrackingFrame, estimate: _Estimate) -> int:
    """How many features the motion predicts in the image, where all points are known; else how many were found."""
    if keyframe.landmarks.source != "depth":
        return int(np.sum(np.isfinite(estimate.px[:, 0])))
    return int(np.sum(np.isfinite(predicted_px(keyframe, frame, estimate.motion.this_T_key)[:, 0])))


def _velocity(last_T_this: Float, seconds: float) -> Float:
    """(6,) metres and radians per second."""
    turned = Rotation.from_matrix(last_T_this[:3, :3]).as_rotvec()
    return np.concatenate((last_T_this[:3, 3], turned)) / seconds
