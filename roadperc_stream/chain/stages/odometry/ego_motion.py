"""One frame of visual odometry: match the keyframe's features, estimate the motion, keep or change the keyframe.

The motion since the keyframe comes from its depth, else from the image alone.
"""

from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from roadperc_stream.chain.stages.odometry import brightness, camera_pitch, keyframes, own_car
from roadperc_stream.chain.stages.odometry.camera_pitch import LINES_STD, CameraPitch, pitch_by_lines
from roadperc_stream.chain.stages.odometry.epipolar import standing_still
from roadperc_stream.chain.stages.odometry.features import TrackingFrame, tracking_frame
from roadperc_stream.chain.stages.odometry.followed import Estimate, FollowedFrame
from roadperc_stream.chain.stages.odometry.keyframes import Keyframe, LastFrame, OdometryState, make_keyframe
from roadperc_stream.chain.stages.odometry.motion import (
    Motion,
    in_ego_axes,
    step_covariance,
)
from roadperc_stream.chain.stages.odometry.search import estimated, estimated_by_orb
from roadperc_stream.chain.stages.odometry.speed import KnownSpeed
from roadperc_stream.config import OdometryConfig
from roadperc_stream.geometry import Float, Float32, adjoint, inverse, rigid
from roadperc_stream.geometry.rotations import rotation_from_vector
from roadperc_stream.model import Absent, Matches, Odometry, Reason, Surface
from roadperc_stream.model.frame import Frame

_SCALE_REASONS: Final[dict[str | None, Reason]] = {
    "points": Reason("odometry", "scale_by_points"),
    "carried": Reason("odometry", "scale_carried"),
    "none": Reason("odometry", "scale_unknown"),
}


def step(
    cfg: OdometryConfig,
    state: OdometryState,
    frame: Frame,
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
    if frame.grey is None or brightness.shows_nothing(frame.grey):
        return state, _without_image(state, frame)
    cv2.setRNGSeed(int(rng.integers(2**31)))
    state, tracked = _without_own_car(state, tracking_frame(cfg, frame, frame.grey, road))
    after, out = _followed(cfg, state, tracked)
    return replace(after, band_correlations=state.band_correlations), out


def _followed(cfg: OdometryConfig, state: OdometryState, tracked: TrackingFrame) -> tuple[OdometryState, Odometry]:
    """The state after a frame with an image, and its pose."""
    pitch = _with_lines(camera_pitch.begun(cfg) if state.pitch is None else state.pitch, tracked)
    if state.keyframe is None or state.last is None:
        return _begun(cfg, state, state.odom_T_ego, pitch, tracked), Odometry("first", state.odom_T_ego)
    reference = state.keyframe, state.last, state.odom_T_ego
    this = FollowedFrame(cfg, tracked, *reference, pitch, state.speed, state.depth_scale)
    same_camera = tracked.camera == state.keyframe.camera
    equal = _equalised(this)
    estimate = estimated(equal)
    if isinstance(estimate, Absent) and cfg.features == "klt" and same_camera:
        this, estimate = estimated_by_orb(equal, estimate)
    if not isinstance(estimate, Absent):
        return _continued(this, estimate) if estimate.motion.scaled else _bridged(this, state, estimate)
    lost = Odometry("lost", state.odom_T_ego, reason=estimate.reason)
    if estimate.reason.code == "impossible_acceleration":
        return state, lost
    new_camera = replace(camera_pitch.begun(cfg), levelled=pitch.levelled)
    pitch = camera_pitch.after_loss(cfg, pitch, this.seconds) if same_camera else new_camera
    return _begun(cfg, state, state.odom_T_ego, pitch, tracked), lost


def _without_image(state: OdometryState, frame: Frame) -> Odometry | Absent:
    """The result of a frame whose image is missing, cannot be decoded or shows nothing."""
    missing = frame.grey is None and not frame.image_unusable
    why = Reason("odometry", "no_image" if missing else "image_unusable" if frame.grey is None else "image_uniform")
    return Absent(why) if missing and state.keyframe is None else Odometry("lost", state.odom_T_ego, reason=why)


def _without_own_car(state: OdometryState, frame: TrackingFrame) -> tuple[OdometryState, TrackingFrame]:
    """The state and the frame in which the own car counts as movable.

    With depth, or without a keyframe of this camera, nothing is marked.
    """
    keyframe, shape = state.keyframe, frame.grey.shape
    if keyframe is None or keyframe.camera != frame.camera or frame.depth_m is not None:
        return replace(state, band_correlations=()), frame
    correlations = own_car.band_correlations(keyframe.grey, frame.grey, state.band_correlations)
    first = own_car.first_row(correlations, shape[0])
    keyframe = replace(keyframe, movable=own_car.without_own_car(keyframe.movable, first, shape))
    frame = replace(frame, movable=own_car.without_own_car(frame.movable, first, shape))
    return replace(state, keyframe=keyframe, band_correlations=correlations), frame


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
    cfg: OdometryConfig, state: OdometryState, odom_T_ego: Float, pitch: CameraPitch, frame: TrackingFrame
) -> OdometryState:
    """The state with this frame as keyframe, at the last known pose. ``state`` is that of the last frame."""
    keyframe = make_keyframe(cfg, frame, odom_T_ego @ frame.ego_T_camera)
    px = keyframe.landmarks.features.px
    last = LastFrame(frame.stamp_ns, None, px, np.zeros((len(px), 6)))
    return OdometryState(odom_T_ego, keyframe, last, pitch, state.speed, depth_scale=state.depth_scale)


def _bridged(this: FollowedFrame, state: OdometryState, estimate: Estimate) -> tuple[OdometryState, Odometry]:
    """The state and result of a frame whose step has no scale: it turns, and its pose is unknown.

    The next step begins at the last known pose again, so no distance is lost until the keyframe must be replaced.
    """
    frame, last = this.frame, this.last
    odom_T_ego = rigid(estimate.odom_T_ego[:3, :3], this.odom_T_last[:3, 3])
    last_T_this = inverse(this.odom_T_last) @ odom_T_ego
    out = Odometry(
        "tracked",
        odom_T_ego,
        last_T_this,
        int(np.sum(estimate.motion.inliers)),
        True,
        _covariance(this, estimate.motion, in_ego_axes(frame.ego_T_camera, estimate.motion.influence), last_T_this),
        last.stamp_ns,
        reason=_reason_of(estimate),
        matches=_matches(this.keyframe, frame, estimate),
        has_length=False,
    )
    if _is_due(this, estimate):
        return _begun(this.cfg, state, odom_T_ego, estimate.pitch, frame), out
    pitch = camera_pitch.predicted(this.cfg, estimate.pitch, inverse(last_T_this), this.seconds)  # at the last frame
    return replace(state, last=replace(last, found_px=_last_px(last, estimate)), pitch=pitch), out


def _continued(this: FollowedFrame, estimate: Estimate) -> tuple[OdometryState, Odometry]:
    """The state and pose after a tracked frame."""
    cfg, frame, keyframe, last, motion = this.cfg, this.frame, this.keyframe, this.last, estimate.motion
    metric = keyframe.landmarks.metric
    last_T_this = inverse(this.odom_T_last) @ estimate.odom_T_ego
    if keyframe.landmarks.source == "depth":
        depth_scale = this.depth_scale.after(frame, keyframe.landmarks.features.px, motion)
        this = replace(this, depth_scale=depth_scale)
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
    speed, per_s = this.speed, float(np.linalg.norm(velocity[:3]))
    if motion.scale in (None, "measured"):
        speed = KnownSpeed(per_s, motion.noise_variance / this.seconds**2, this.middle_ns, metric, this.middle_ns)
    elif motion.scale == "points" and not motion.doubts and speed is not None:
        speed = speed.by_points(per_s, motion.noise_variance / this.seconds**2, this.middle_ns)
    begins = last.velocity is None and motion.still is not None
    now = LastFrame(frame.stamp_ns, None if begins else velocity, found_px, influence, length_variance)
    return OdometryState(odom_T_ego, keyframe, now, pitch, speed, depth_scale=this.depth_scale), out


def _covariance(this: FollowedFrame, motion: Motion, influence: Float | None, last_T_this: Float) -> tuple[float, ...]:
    """Covariance of the step, row by row; empty if it is unknown."""
    if motion.still is not None:
        in_ego = adjoint(this.frame.ego_T_camera)
        return tuple((in_ego @ motion.still @ in_ego.T).ravel().tolist())
    key_px, width = this.keyframe.landmarks.features.px, this.frame.camera.width
    length_variance = motion.length_variance + this.last.length_variance
    if this.keyframe.landmarks.source == "depth":
        length_variance += this.depth_scale.variance * float(np.sum(last_T_this[:3, 3] ** 2))
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
