"""One frame of visual odometry: find the keyframe's points again, tell the motion, keep or change the keyframe."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from roadperc_stream.chain.stages.odometry.epipolar import motion_from_rays
from roadperc_stream.chain.stages.odometry.features import FRONTENDS, scaled
from roadperc_stream.chain.stages.odometry.keyframes import Keyframe, carry, is_due, make_keyframe
from roadperc_stream.chain.stages.odometry.motion import Motion, motion_from_points, moved
from roadperc_stream.chain.stages.odometry.patches import aligned, promised_px
from roadperc_stream.chain.stages.odometry.views import View, make_view
from roadperc_stream.core.config import OdometryConfig
from roadperc_stream.core.datatypes import Absent, Image, Mask, Matches, Odometry, Surface, read_only
from roadperc_stream.core.geometry import Camera, Float, Float32, inverse, project, transform
from roadperc_stream.core.time import NS_PER_S

_FIRST_LENGTH = 1.0
"""Length of the first step where nothing tells its scale."""
_ASTRAY_PX = 20.0
"""Distance, at 960 rows, from where steady motion promises a feature beyond which something else was found."""


@dataclass(frozen=True)
class Fix:
    """The last frame whose pose is known, or at which the odometry began anew.

    ``velocity`` is (6,) metres and radians per second in the ego frame, None where no two frames told it. ``found_px``
    is (N, 2), where the keyframe's features were seen last. ``covariance`` is (6, 6), that of the pose against the
    keyframe in ego's axes, None where it cannot be told.
    """

    stamp_ns: int
    velocity: Float | None
    found_px: Float32
    covariance: Float | None

    def __post_init__(self) -> None:
        read_only(self.found_px, np.float32, (None, 2), "found_px")
        for name, array, shape in (("velocity", self.velocity, (6,)), ("covariance", self.covariance, (6, 6))):
            if array is not None:
                read_only(array, np.float64, shape, name)


@dataclass(frozen=True)
class OdometryState:
    """What the odometry remembers from one frame to the next."""

    odom_T_ego: Float = field(default_factory=lambda: np.eye(4))
    keyframe: Keyframe | None = None
    fix: Fix | None = None


@dataclass(frozen=True)
class _Sighting:
    """The (N, 2) pixels of the keyframe's features in a frame, and the motion and pose they tell."""

    px: Float32
    motion: Motion
    odom_T_ego: Float


def step(
    cfg: OdometryConfig,
    state: OdometryState,
    camera: Camera,
    ego_T_camera: Float,
    grey: Image | None,
    depth_m: Float32 | None,
    movable: Mask | None,
    road: Surface | None,
    rng: np.random.Generator,
    stamp_ns: int,
    unusable: str = "",
) -> tuple[OdometryState, Odometry | Absent]:
    """Follow the camera from the last frames to this one.

    The keyframe outlives frames that are missing: the first one found again continues from it, and no motion is lost.
    Where its points are not found again, the frame is lost and becomes the keyframe, at the last pose known.

    Args:
        cfg: thresholds.
        state: what the last frame left.
        camera: the camera of all images.
        ego_T_camera: its mounting.
        grey: (H, W) uint8; None: the frame is missing.
        depth_m: (H, W) metres as that camera sees them, NaN unknown; None: the motion comes from the image alone.
        movable: (H, W) pixels of vehicles and pedestrians, which are left out.
        road: the road in that camera's frame, which gives the scale where there is no depth; None: it is not known.
        rng: seeds OpenCV's random numbers.
        stamp_ns: the frame's time, later than the last frame's.
        unusable: why the frame's image gives no pixels, where it has one.

    Returns:
        The new state, and the pose; absent where there has been no image yet.
    """
    if grey is None:
        missed = bool(unusable or state.keyframe)
        return state, _lost(state.odom_T_ego, unusable or "no image") if missed else Absent("no image")
    cv2.setRNGSeed(int(rng.integers(2**31)))
    view = make_view(cfg, camera, ego_T_camera, grey, depth_m, movable, road, stamp_ns)
    if state.keyframe is None or state.fix is None:
        return _begun(cfg, state.odom_T_ego, view), Odometry("first", state.odom_T_ego)
    sighting = _look(cfg, state.odom_T_ego, state.keyframe, state.fix, view)
    if isinstance(sighting, Absent):
        return _begun(cfg, state.odom_T_ego, view), _lost(state.odom_T_ego, sighting.reason)
    return _continued(cfg, state.odom_T_ego, state.keyframe, state.fix, view, sighting)


def _lost(odom_T_ego: Float, reason: str) -> Odometry:
    return Odometry("lost", odom_T_ego, reason=reason)


def _begun(cfg: OdometryConfig, odom_T_ego: Float, view: View) -> OdometryState:
    """A frame as keyframe, at a pose that is given."""
    keyframe = make_keyframe(cfg, view, odom_T_ego @ view.ego_T_camera)
    return OdometryState(odom_T_ego, keyframe, Fix(view.stamp_ns, None, keyframe.places.features.px, np.zeros((6, 6))))


def _continued(
    cfg: OdometryConfig, odom_T_last: Float, keyframe: Keyframe, fix: Fix, view: View, sighting: _Sighting
) -> tuple[OdometryState, Odometry]:
    """The state and pose after a frame whose motion is known."""
    motion = sighting.motion
    metric = keyframe.places.metric and motion.scaled
    last_T_this = inverse(odom_T_last) @ sighting.odom_T_ego
    covariance = _in_ego_axes(view.ego_T_camera, motion.covariance)
    out = Odometry(
        "tracked",
        sighting.odom_T_ego,
        last_T_this,
        int(np.sum(motion.inliers)),
        not metric,
        _row_by_row(covariance, fix.covariance),
        fix.stamp_ns,
        matches=_matches(keyframe, view, sighting),
    )
    if not motion.scaled:
        keyframe = replace(keyframe, places=replace(keyframe.places, points_m=motion.points_m, metric=metric))
    found_px = np.where(np.isfinite(sighting.px), sighting.px, fix.found_px)
    if is_due(cfg, keyframe, view, sighting.px, motion.inliers):
        carried = carry(keyframe.places, motion, sighting.px)
        keyframe = make_keyframe(cfg, view, sighting.odom_T_ego @ view.ego_T_camera, carried)
        found_px, covariance = keyframe.places.features.px, np.zeros((6, 6))
    velocity = _velocity(last_T_this, (view.stamp_ns - fix.stamp_ns) / NS_PER_S)
    return OdometryState(sighting.odom_T_ego, keyframe, Fix(view.stamp_ns, velocity, found_px, covariance)), out


def _matches(keyframe: Keyframe, view: View, sighting: _Sighting) -> Matches:
    """What was found again, in pixels of the whole images."""
    found = np.isfinite(sighting.px).all(axis=1)
    key_px = view.whole(keyframe.places.features.px[found])
    return Matches(key_px, view.whole(sighting.px[found]), sighting.motion.inliers[found])


def _look(cfg: OdometryConfig, odom_T_last: Float, keyframe: Keyframe, fix: Fix, view: View) -> _Sighting | Absent:
    """The first motion that can be believed, or why there is none."""
    if view.camera != keyframe.camera:
        return Absent("the camera is another one than before")
    refused = "too few points agree on a motion"
    for guess_px, near_px, ratio in _guesses(cfg, odom_T_last, keyframe, fix, view):
        px = FRONTENDS[cfg.features].match(cfg, keyframe.grey, keyframe.places.features, guess_px, view.grey)
        astray = np.linalg.norm(px - near_px, axis=1) > scaled(_ASTRAY_PX, view.grey.shape[0])
        px[astray | view.on_movable(px)] = np.nan
        sighting = _placed(cfg, keyframe, fix, view, px)
        if sighting is None:
            continue
        if np.sum(sighting.motion.inliers) < max(ratio * _findable(keyframe, view, sighting), cfg.min_inliers):
            continue
        if _possible(cfg, keyframe, fix, view, sighting, inverse(odom_T_last) @ sighting.odom_T_ego):
            return sighting
        refused = "the points agree on a motion that the car cannot make"
    return Absent(refused)


def _guesses(
    cfg: OdometryConfig, odom_T_last: Float, keyframe: Keyframe, fix: Fix, view: View
) -> Iterator[tuple[Float32, Float32, float]]:
    """(N, 2) pixels where to look for features, (N, 2) near which they must be found, and the share that must agree.

    First where they are if the car moved on as it did, and only near there: a road's texture repeats itself, and its
    next repetition is a consistent motion too. Then, if need be, around where they were seen last; NaN: anywhere.
    """
    if fix.velocity is not None:
        seconds = (view.stamp_ns - fix.stamp_ns) / NS_PER_S
        odom_T_camera = odom_T_last @ moved(fix.velocity * seconds) @ view.ego_T_camera
        camera_T_key = inverse(odom_T_camera) @ keyframe.odom_T_camera
        promised = project(view.camera, transform(camera_T_key, keyframe.places.points_m)).astype(np.float32)
        yield np.where(np.isfinite(promised), promised, fix.found_px), promised, cfg.min_inlier_ratio
    yield fix.found_px, np.full_like(fix.found_px, np.nan), min(2 * cfg.min_inlier_ratio, 1.0)


def _placed(cfg: OdometryConfig, keyframe: Keyframe, fix: Fix, view: View, px: Float32) -> _Sighting | None:
    """The motion that the features' pixels tell, and the pose that follows."""
    places = keyframe.places
    if places.source == "depth":
        motion = motion_from_points(cfg, view.camera, places.points_m, px)
        if motion is not None:
            px = aligned(keyframe, view, motion.this_T_key)
            motion = motion_from_points(cfg, view.camera, places.points_m, px, motion.this_T_key)
    else:
        length = _FIRST_LENGTH
        if fix.velocity is not None:
            length = float(np.linalg.norm(fix.velocity[:3])) * (view.stamp_ns - keyframe.stamp_ns) / NS_PER_S
        motion = motion_from_rays(cfg, view.camera, places.features.px, px, places.points_m, length)
    if motion is None:
        return None
    return _Sighting(px, motion, keyframe.odom_T_camera @ inverse(motion.this_T_key) @ inverse(view.ego_T_camera))


def _possible(
    cfg: OdometryConfig, keyframe: Keyframe, fix: Fix, view: View, sighting: _Sighting, last_T_this: Float
) -> bool:
    """Whether a car can make the motion; a length without scale tells no speed."""
    velocity = _velocity(last_T_this, (view.stamp_ns - fix.stamp_ns) / NS_PER_S)
    speed, turn_rate = np.linalg.norm(velocity.reshape(2, 3), axis=1)
    fast = keyframe.places.metric and sighting.motion.scaled and speed > cfg.max_speed_mps
    return not fast and bool(turn_rate <= np.deg2rad(cfg.max_turn_rate_dps))


def _findable(keyframe: Keyframe, view: View, sighting: _Sighting) -> int:
    """How many features the motion sees in the image, where all their points are known; else how many were found."""
    if keyframe.places.source != "depth":
        return int(np.sum(np.isfinite(sighting.px[:, 0])))
    return int(np.sum(np.isfinite(promised_px(keyframe, view, sighting.motion.this_T_key)[:, 0])))


def _velocity(last_T_this: Float, seconds: float) -> Float:
    """(6,) metres and radians per second."""
    turned = Rotation.from_matrix(last_T_this[:3, :3]).as_rotvec()
    return np.concatenate((last_T_this[:3, 3], turned)) / seconds


def _in_ego_axes(ego_T_camera: Float, covariance: Float | None) -> Float | None:
    """(6, 6) covariance of a small motion of the camera as that of the ego frame fixed to it, by the adjoint."""
    if covariance is None:
        return None
    R, lever = ego_T_camera[:3, :3], ego_T_camera[:3, 3]
    adjoint = np.zeros((6, 6))
    adjoint[:3, :3] = adjoint[3:, 3:] = R
    adjoint[:3, 3:] = np.cross(lever, R, axisb=0, axisc=0)
    return np.asarray(adjoint @ covariance @ adjoint.T)


def _row_by_row(this: Float | None, last: Float | None) -> tuple[float, ...]:
    """Covariance of the step between two poses measured against one keyframe; empty where one cannot be told."""
    return () if this is None or last is None else tuple((this + last).ravel().tolist())
