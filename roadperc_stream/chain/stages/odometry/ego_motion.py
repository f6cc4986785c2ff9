"""One frame of visual odometry: match the keyframe's features, estimate the motion, keep or change the keyframe.

The motion since the keyframe comes from its depth, else from the image alone.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from roadperc_stream.chain.stages.odometry import brightness, camera_pitch, keyframes
from roadperc_stream.chain.stages.odometry.alignment import aligned, predicted_px
from roadperc_stream.chain.stages.odometry.camera_pitch import LINES_STD, CameraPitch, pitch_by_lines
from roadperc_stream.chain.stages.odometry.epipolar import motion_from_rays, standing_still
from roadperc_stream.chain.stages.odometry.features import FRONTENDS, TrackingFrame, tracking_frame
from roadperc_stream.chain.stages.odometry.keyframes import Keyframe, LastFrame, OdometryState, make_keyframe
from roadperc_stream.chain.stages.odometry.motion import Motion, in_ego_axes, motion_from_points, moved, standing_motion, step_covariance
from roadperc_stream.chain.stages.odometry.rivals import along_path, best_shift
from roadperc_stream.chain.stages.odometry.road_scale import Expected, scaled_by_road
from roadperc_stream.chain.stages.odometry.speed import KnownSpeed
from roadperc_stream.config import OdometryConfig, scaled
from roadperc_stream.geometry import Float, Float32, inverse, project, rigid, transform
from roadperc_stream.geometry.rotations import rotation_from_vector, rotation_vector
from roadperc_stream.model import Absent, Matches, Odometry, Reason, Surface
from roadperc_stream.model.scene import Scene
from roadperc_stream.system.time import NS_PER_S

_SCALE_REASONS: Final[dict[str | None, Reason]] = {
    "points": Reason("odometry", "scale_by_points"),
    "carried": Reason("odometry", "scale_carried"),
    "none": Reason("odometry", "scale_unknown"),
}
_ASTRAY_PX = 20.0
"""Largest distance, at 960 rows, from the pixel that steady motion predicts; farther matches are wrong."""
MIN_INLIER_RATIO: Final = 0.25
"""Minimum share of the visible points that agree on a steady motion; twice that for an unexpected one."""
_FIRST_LENGTH = 1.0
"""Length of the first step in a log without a metric scale: the unit of its path."""
_POINTS_SHARE: Final = 0.02
"""Standard deviation of a length by triangulated points, as a share."""
_ROAD_SHARE: Final = 0.03
"""Standard deviation of a length by the road, as a share: the search for it extends beyond the possible lengths."""
_DEPTH_JITTER_M: Final = 0.07
"""Standard deviation of the difference of two steps by depth with 30 % noise; their covariances do not show it."""
_SIGMAS: Final = 3.0


@dataclass(frozen=True)
class FollowedFrame:
    """A frame with its references: the keyframe, and the pose and pitch at the last frame."""

    cfg: OdometryConfig
    frame: TrackingFrame
    keyframe: Keyframe
    last: LastFrame
    odom_T_last: Float
    pitch: CameraPitch
    speed: KnownSpeed | None = None

    @property
    def middle_ns(self) -> int:
        """The middle of the time since the last frame, at which the car has its mean speed."""
        return (self.last.stamp_ns + self.frame.stamp_ns) // 2

    @property
    def seconds(self) -> float:
        """Since the last frame."""
        return (self.frame.stamp_ns - self.last.stamp_ns) / NS_PER_S

    def pose(self, motion: Motion) -> Float:
        """odom_T_ego after a motion from the keyframe."""
        return self.keyframe.odom_T_camera @ inverse(motion.this_T_key) @ inverse(self.frame.ego_T_camera)

    def velocity(self, odom_T_ego: Float) -> Float:
        """(6,) metres and radians per second since the last frame."""
        last_T_this = inverse(self.odom_T_last) @ odom_T_ego
        return np.concatenate((last_T_this[:3, 3], rotation_vector(last_T_this[:3, :3]))) / self.seconds

    @property
    def expected_this_T_key(self) -> Float | None:
        """(4, 4) motion since the keyframe if the last motion continues; None without a last one."""
        if self.last.velocity is None:
            return None
        odom_T_camera = self.odom_T_last @ moved(self.last.velocity * self.seconds) @ self.frame.ego_T_camera
        return inverse(odom_T_camera) @ self.keyframe.odom_T_camera

    @property
    def metric_speed(self) -> KnownSpeed | None:
        """The last known speed in metres per second."""
        return self.speed if self.speed is not None and self.speed.metric else None

    def limits_mps(self, variance: float = 0.0) -> tuple[float, float]:
        """Least and greatest speed of a car since the last frame; ``variance`` is that of the speed to compare."""
        if (speed := self.metric_speed) is None:
            return 0.0, self.cfg.max_speed_mps
        least, most = speed.limits_mps((self.middle_ns - speed.stamp_ns) / NS_PER_S, variance)
        return least, min(most, self.cfg.max_speed_mps)

    def turned_pitch(self, odom_T_ego: Float) -> CameraPitch:
        """The pitch, turned with the camera since the last frame."""
        return camera_pitch.predicted(self.cfg, self.pitch, inverse(self.odom_T_last) @ odom_T_ego, self.seconds)


@dataclass(frozen=True)
class Estimate:
    """The (N, 2) pixels of the keyframe's features in a frame, and the motion, pose and pitch estimated from them.

    ``by_orb`` is true if optical flow failed and ORB features were matched.
    """

    px: Float32
    motion: Motion
    odom_T_ego: Float
    pitch: CameraPitch
    by_orb: bool = False


def step(
    cfg: OdometryConfig,
    state: OdometryState,
    scene: Scene,
    road: Surface | None,
    rng: np.random.Generator,
) -> tuple[OdometryState, Odometry | Absent]:
    """Follow the camera from the last frames to this one.

    The keyframe is kept during frames without a usable image: the next frame continues from it, and no motion is lost.
    It is also kept if a car cannot brake or accelerate as the images show: they repeat, or the match is wrong.
    If its points are not found again, the frame is lost and becomes the keyframe, at the last known pose. Without
    dense depth the motion comes from the image and its scale from ``road`` (in the front camera's frame). Pixels of
    vehicles and pedestrians are left out. ``rng`` seeds OpenCV's random numbers.

    Returns:
        The new state, and the pose; absent before the first image.
    """
    if scene.grey is None or brightness.shows_nothing(scene.grey):
        return state, _without_image(state, scene)
    cv2.setRNGSeed(int(rng.integers(2**31)))
    frame = tracking_frame(cfg, scene, scene.grey, road)
    pitch = _with_lines(camera_pitch.begun(cfg) if state.pitch is None else state.pitch, frame)
    if state.keyframe is None or state.last is None:
        return _begun(cfg, state.odom_T_ego, pitch, frame), Odometry("first", state.odom_T_ego)
    this = FollowedFrame(cfg, frame, state.keyframe, state.last, state.odom_T_ego, pitch, state.speed)
    same_camera = frame.camera == state.keyframe.camera
    equal = _equalised(this)
    estimate = _estimated(equal)
    if isinstance(estimate, Absent) and cfg.features == "klt" and same_camera:
        this, estimate = _estimated_by_orb(equal, estimate)
    if not isinstance(estimate, Absent):
        return _continued(this, estimate) if estimate.motion.scaled else _bridged(this, state, estimate)
    lost = Odometry("lost", state.odom_T_ego, reason=estimate.reason)
    if estimate.reason.code == "impossible_acceleration":
        return state, lost
    new_camera = replace(camera_pitch.begun(cfg), levelled=pitch.levelled)
    pitch = camera_pitch.after_loss(cfg, pitch, this.seconds) if same_camera else new_camera
    return _begun(cfg, state.odom_T_ego, pitch, frame, state.speed), lost


def _without_image(state: OdometryState, scene: Scene) -> Odometry | Absent:
    """The result of a frame whose image is missing, cannot be decoded or shows nothing."""
    missing = scene.grey is None and not scene.image_unusable
    why = Reason("odometry", "no_image" if missing else "image_unusable" if scene.grey is None else "image_uniform")
    return Absent(why) if missing and state.keyframe is None else Odometry("lost", state.odom_T_ego, reason=why)


def _equalised(this: FollowedFrame) -> FollowedFrame:
    """The frame and its keyframe with one exposure."""
    key_grey, grey = brightness.equalised(this.keyframe.grey, this.frame.grey)
    return replace(this, keyframe=replace(this.keyframe, grey=key_grey), frame=replace(this.frame, grey=grey))


def _with_lines(pitch: CameraPitch, frame: TrackingFrame) -> CameraPitch:
    """The pitch updated by the road's lines, if it is less certain than they are and no depth shows the road.

    Lines speed up the start. They are not sufficient alone: a yard or a bend shows lines, too.
    """
    road_is_measured = frame.depth_m is not None or (frame.road is not None and frame.road.source != "assumed")
    if road_is_measured or pitch.variance < LINES_STD**2:
        return pitch
    lines = pitch_by_lines(frame.camera, frame.ego_T_camera, frame.grey, frame.movable)
    return replace(camera_pitch.updated(pitch, lines), measured=pitch.measured)


def _begun(
    cfg: OdometryConfig, odom_T_ego: Float, pitch: CameraPitch, frame: TrackingFrame, speed: KnownSpeed | None = None
) -> OdometryState:
    """The state with this frame as keyframe, at the last known pose."""
    keyframe = make_keyframe(cfg, frame, odom_T_ego @ frame.ego_T_camera)
    px = keyframe.landmarks.features.px
    last = LastFrame(frame.stamp_ns, None, px, np.zeros((len(px), 6)))
    return OdometryState(odom_T_ego, keyframe, last, pitch, speed)


def _bridged(this: FollowedFrame, state: OdometryState, estimate: Estimate) -> tuple[OdometryState, Odometry]:
    """The state and result of a frame whose step has no scale: it turns, and its pose is unknown.

    The next step begins at the last known pose again, so no distance is lost until the keyframe must be replaced.
    """
    frame, last = this.frame, this.last
    odom_T_ego = rigid(estimate.odom_T_ego[:3, :3], this.odom_T_last[:3, 3])
    out = Odometry(
        "tracked",
        odom_T_ego,
        inverse(this.odom_T_last) @ odom_T_ego,
        int(np.sum(estimate.motion.inliers)),
        up_to_scale=True,
        since_ns=last.stamp_ns,
        reason=_reason_of(estimate),
        matches=_matches(this.keyframe, frame, estimate),
        has_length=False,
    )
    if _is_due(this, estimate):
        return _begun(this.cfg, odom_T_ego, estimate.pitch, frame, state.speed), out
    return replace(state, last=replace(last, found_px=_last_px(last, estimate))), out


def _continued(this: FollowedFrame, estimate: Estimate) -> tuple[OdometryState, Odometry]:
    """The state and pose after a tracked frame."""
    cfg, frame, keyframe, last, motion = this.cfg, this.frame, this.keyframe, this.last, estimate.motion
    metric = keyframe.landmarks.metric
    last_T_this = inverse(this.odom_T_last) @ estimate.odom_T_ego
    influence = in_ego_axes(frame.ego_T_camera, motion.influence)
    velocity = this.velocity(estimate.odom_T_ego)
    odom_T_ego, keyframe, pitch = _levelled(estimate, keyframe, float(np.linalg.norm(last_T_this[:3, 3])))
    out = Odometry(
        "tracked",
        odom_T_ego,
        last_T_this,
        int(np.sum(motion.inliers)),
        not metric,
        _covariance(this, motion, influence, last_T_this),
        last.stamp_ns,
        _reason_of(estimate),
        _matches(keyframe, frame, estimate),
    )
    if keyframe.landmarks.source != "depth":
        keyframe = replace(keyframe, landmarks=keyframes.with_points(keyframe.landmarks, motion))
    found_px = _last_px(last, estimate)
    length_variance = motion.length_variance if motion.scale is None else motion.noise_variance
    if motion.still is not None:
        influence = np.zeros((len(found_px), 6))
    if _is_due(this, estimate):
        by_road = motion.scale == "measured" and this.keyframe.stamp_ns == last.stamp_ns
        carried = None if by_road else keyframes.carry(frame.camera, keyframe.landmarks, motion, estimate.px)
        keyframe = make_keyframe(cfg, frame, odom_T_ego @ frame.ego_T_camera, carried)
        found_px = keyframe.landmarks.features.px
        influence, length_variance = np.zeros((len(found_px), 6)), 0.0
    speed = this.speed
    if motion.scale in (None, "measured"):
        mps = float(np.linalg.norm(velocity[:3]))
        speed = KnownSpeed(mps, motion.noise_variance / this.seconds**2, this.middle_ns, metric)
    begins = last.velocity is None and motion.still is not None
    now = LastFrame(frame.stamp_ns, None if begins else velocity, found_px, influence, length_variance)
    return OdometryState(odom_T_ego, keyframe, now, pitch, speed), out


def _covariance(this: FollowedFrame, motion: Motion, influence: Float | None, last_T_this: Float) -> tuple[float, ...]:
    """Covariance of the step, row by row; empty if it is unknown."""
    if motion.still is not None:
        ego_T_camera = this.frame.ego_T_camera
        along_rows = in_ego_axes(ego_T_camera, motion.still)
        return tuple(np.ravel(in_ego_axes(ego_T_camera, np.transpose(along_rows))).tolist())
    key_px, width = this.keyframe.landmarks.features.px, this.frame.camera.width
    length_variance = motion.length_variance + this.last.length_variance
    return step_covariance(key_px, width, influence, this.last.influence, last_T_this, length_variance)


def _last_px(last: LastFrame, estimate: Estimate) -> Float32:
    """(N, 2) last pixels of the keyframe's features."""
    return np.where(np.isfinite(estimate.px), estimate.px, last.found_px)


def _is_due(this: FollowedFrame, estimate: Estimate) -> bool:
    """Whether the frame must become the next keyframe, also where a car without depth has just come to a stand."""
    motion, landmarks = estimate.motion, this.keyframe.landmarks
    if estimate.by_orb or keyframes.is_due(this.cfg, this.keyframe, this.frame, estimate.px, motion.inliers):
        return True
    if landmarks.source == "depth" or not motion.this_T_key[:3, 3].any():
        return False
    return standing_still(this.frame.camera, this.last.found_px, estimate.px) is not None


def _levelled(estimate: Estimate, keyframe: Keyframe, length_m: float) -> tuple[Float, Keyframe, CameraPitch]:
    """The pose and the keyframe, turned about ego's origin to the pitch of the mounting, and the pitch."""
    pitch = camera_pitch.averaged(estimate.pitch, length_m)
    if pitch.weight == 0:
        return estimate.odom_T_ego, keyframe, pitch
    R, at = estimate.odom_T_ego[:3, :3], estimate.odom_T_ego[:3, 3]
    # The inverse of the pose would double its rounding error in every frame.
    turn = rotation_from_vector(R @ np.array([0.0, pitch.mounting - pitch.levelled, 0.0]))
    level = rigid(turn, at - turn @ at)
    keyframe = replace(keyframe, odom_T_camera=level @ keyframe.odom_T_camera)
    return level @ estimate.odom_T_ego, keyframe, replace(pitch, levelled=pitch.mounting)


def _reason_of(estimate: Estimate) -> Reason | None:
    """Why a tracked frame has another matching or another scale than usual."""
    scale = _SCALE_REASONS.get(estimate.motion.scale)
    if not estimate.by_orb:
        return scale
    return Reason("odometry", "matched_by_orb" if scale is None else "matched_by_orb_and", cause=scale)


def _matches(keyframe: Keyframe, frame: TrackingFrame, estimate: Estimate) -> Matches:
    """The matched features, in pixels of the whole images."""
    found = np.isfinite(estimate.px).all(axis=1)
    key_px = frame.whole(keyframe.landmarks.features.px[found])
    return Matches(key_px, frame.whole(estimate.px[found]), estimate.motion.inliers[found])


def _estimated(this: FollowedFrame) -> Estimate | Absent:
    """The first plausible motion; absent with a reason if no motion is plausible."""
    cfg, frame, keyframe = this.cfg, this.frame, this.keyframe
    if frame.camera != keyframe.camera:
        return Absent(Reason("odometry", "camera_changed"))
    rejected = Reason("odometry", "too_few_inliers")
    for guess_px, near_px, ratio in guesses(this):
        px = FRONTENDS[cfg.features].match(cfg, keyframe.grey, keyframe.landmarks.features, guess_px, frame.grey)
        astray = np.linalg.norm(px - near_px, axis=1) > scaled(_ASTRAY_PX, frame.grey.shape[0])
        px[astray | frame.on_movable(px)] = np.nan
        estimate = _localised(this, px)
        if estimate is None:
            continue
        if np.sum(estimate.motion.inliers) < max(ratio * _findable(keyframe, frame, estimate), cfg.min_inliers):
            continue
        impossible = _impossible(this, estimate)
        if impossible is None:
            return _verified(this, estimate, expected=bool(np.isfinite(near_px).any()))
        rejected = impossible
    return Absent(rejected)


def _estimated_by_orb(this: FollowedFrame, failed: Absent) -> tuple[FollowedFrame, Estimate | Absent]:
    """The motion by ORB features of the keyframe; the failure of optical flow if it is not plausible."""
    cfg = this.cfg.model_copy(update={"features": "orb"})
    keyframe, last = keyframes.detected_again(cfg, this.keyframe, this.last, this.frame)
    wide = replace(this, keyframe=keyframe, last=last)
    estimate = _estimated(replace(wide, cfg=cfg))
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
    points_m, motion = this.keyframe.landmarks.points_m, estimate.motion
    start, px = along_path(this.frame, shift_m) @ motion.this_T_key, estimate.px
    for _ in range(2):
        px = aligned(this.keyframe, this.frame, start)
        found = motion_from_points(this.frame.camera, points_m, px, start)
        if found is None:
            return estimate
        motion, start = found, found.this_T_key
    if np.sum(motion.inliers) < this.cfg.min_inliers:
        return estimate
    odom_T_ego = this.pose(motion)
    moved_estimate = Estimate(px, motion, odom_T_ego, this.turned_pitch(odom_T_ego))
    return estimate if _impossible(this, moved_estimate) else moved_estimate


def guesses(this: FollowedFrame) -> Iterator[tuple[Float32, Float32, float]]:
    """(N, 2) pixels where the search starts, (N, 2) pixels near which matches must lie, and the share that must agree.

    The first guess continues the last motion and accepts only matches near it: a road's texture repeats, and matches
    shifted by one repetition also agree on a motion. The second guess is the last pixels; NaN accepts any match.
    """
    frame, keyframe, last = this.frame, this.keyframe, this.last
    if (this_T_key := this.expected_this_T_key) is not None:
        predicted = project(frame.camera, transform(this_T_key, keyframe.landmarks.points_m)).astype(np.float32)
        yield np.where(np.isfinite(predicted), predicted, last.found_px), predicted, MIN_INLIER_RATIO
    yield last.found_px, np.full_like(last.found_px, np.nan), 2 * MIN_INLIER_RATIO


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


def _findable(keyframe: Keyframe, frame: TrackingFrame, estimate: Estimate) -> int:
    """Number of features that the motion predicts in the image if all points are known, else of those found."""
    if keyframe.landmarks.source != "depth":
        return int(np.sum(np.isfinite(estimate.px[:, 0])))
    return int(np.sum(np.isfinite(predicted_px(keyframe, frame, estimate.motion.this_T_key)[:, 0])))


def _localised(this: FollowedFrame, px: Float32) -> Estimate | None:
    """The motion estimated from the features' pixels, and the pose that follows."""
    camera, landmarks = this.frame.camera, this.keyframe.landmarks
    if landmarks.source != "depth":
        return _localised_without_depth(this, px)
    motion = motion_from_points(camera, landmarks.points_m, px)
    if motion is not None:
        px = aligned(this.keyframe, this.frame, motion.this_T_key)
        motion = motion_from_points(camera, landmarks.points_m, px, motion.this_T_key)
    if motion is None:
        return None
    odom_T_ego = this.pose(motion)
    return Estimate(px, motion, odom_T_ego, this.turned_pitch(odom_T_ego))


def _localised_without_depth(this: FollowedFrame, px: Float32) -> Estimate | None:
    """The estimate without depth: the length comes from the road, from triangulated points or from the last speed."""
    frame, landmarks = this.frame, this.keyframe.landmarks
    key_px, points_m = landmarks.features.px, landmarks.triangulated_m
    unit = min(this.speed.mps * this.seconds if this.speed else _FIRST_LENGTH, this.cfg.max_speed_mps * this.seconds)
    motion = motion_from_rays(frame.camera, key_px, px, points_m, unit or _FIRST_LENGTH, this.expected_this_T_key)
    if motion is None or not motion.scaled:
        motion = _by_points(this, points_m, px) or motion
    if motion is None:
        return None
    pitch = this.turned_pitch(this.pose(motion))
    if not motion.this_T_key[:3, 3].any():
        motion = standing_motion(frame.camera, landmarks.points_m, key_px, px, motion)
        return Estimate(px, motion, this.pose(motion), pitch)
    direction = camera_pitch.expansion(motion, frame.ego_T_camera, key_px, frame.camera.width)
    pitch = camera_pitch.updated(pitch, direction)
    if landmarks.source == "plane":
        motion, pitch = scaled_by_road(frame, this.keyframe, motion, pitch, *_expected_length(this, motion))
    elif not motion.scaled:
        motion = _in_units(this, motion)
    return Estimate(px, motion, this.pose(motion), pitch)


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
    driven_m = float(np.linalg.norm((this.odom_T_last @ this.frame.ego_T_camera - this.keyframe.odom_T_camera)[:3, 3]))
    least, most = (limit * seconds for limit in this.limits_mps((_ROAD_SHARE * speed.mps) ** 2 if speed else 0.0))
    reach_m = _SIGMAS * float(np.sqrt(last.length_variance))
    tried_m = max(driven_m + (least or -most) - reach_m, 0.0), driven_m + most + reach_m
    if motion.scaled:
        length_m = float(np.linalg.norm(motion.this_T_key[:3, 3]))
        share = this.keyframe.landmarks.scale_variance + _POINTS_SHARE**2
        return Expected(length_m, motion.length_variance + share * length_m**2), tried_m
    if speed is None:
        return None, tried_m
    variance = speed.variance_after((this.middle_ns - speed.stamp_ns) / NS_PER_S)
    return Expected(driven_m + speed.mps * seconds, last.length_variance + variance * seconds**2), tried_m
