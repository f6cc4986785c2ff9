"""The state of odometry between frames: the keyframe with its landmarks, and the last frame.

On a plane, 1 / depth is linear in the image. A fit to the pixels around a feature averages the noise of the depth, and
its slope determines how the patch is stretched when the camera moves. On a road at a grazing angle, windows without
that stretch match with a bias: steps are 1 to 2 % short.

Every motion is measured against the last keyframe, so a car that stands still keeps its keyframe and does not drift.
"""

from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from roadperc_stream.chain.stages.odometry.camera_pitch import CameraPitch
from roadperc_stream.chain.stages.odometry.depth_scale import DepthScale
from roadperc_stream.chain.stages.odometry.features import FRONTENDS, Features, TrackingFrame, spread
from roadperc_stream.chain.stages.odometry.motion import Motion
from roadperc_stream.chain.stages.odometry.speed import KnownSpeed
from roadperc_stream.config import OdometryConfig, scaled
from roadperc_stream.geometry import Float, Float32, Plane, intersect_plane, inverse, transform
from roadperc_stream.geometry.cameras import Camera, project, rays, unproject
from roadperc_stream.model import Image, Mask, read_only

_REACH_PX = 3
_MAX_DEPTH_M: Final = 60.0
"""Farthest used point: depth in logs ends at 65.535 m."""
KEYFRAME_SHARE: Final = 0.5
"""Share of the keyframe's points that are inliers, below which a frame becomes the next keyframe."""
KEYFRAME_FLOW_PX: Final = 60.0
"""Median shift of the points at 960 rows above which a frame becomes the next keyframe: the windows differ too much."""
_SAME_SURFACE = 0.15
"""Largest relative depth difference of pixels on the feature's surface."""
_MIN_PIXELS = 6
_HALF_PIXELS = np.array(((0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5)))
"""Offsets to the right, left, down and up that measure the stretch."""
_RIDGE = 1e-9
"""Keeps the normal equations of collinear pixels solvable: their slope across is then 0."""
LandmarkSource = Literal["depth", "plane", "carried"]
_ROAD_AHEAD_M: Final = (2.0, 20.0)
_ROAD_HALF_WIDTH_M = 3.0
"""The part of the road that is used without depth (ego frame)."""
_CARRIED_VARIANCE: Final = 0.02**2
"""Variance that the scale of known points gains with each keyframe, as a share."""


@dataclass(frozen=True)
class Landmarks:
    """(N,) features, their (N, 3) points in the camera's frame, and the (N, 2) slope of 1 / depth around each.

    The slope is in 1/m per pixel to the right and down. Unknown is NaN; ``metric`` is true if lengths are in metres.
    Points of the source ``plane`` with a slope lie on the road's plane, those without are triangulated. For the latter,
    ``scale_variance`` is the variance of their scale, as a share, and ``doubts`` the ratios of lengths by the road and
    by them in the last frames that contradicted them.
    """

    features: Features
    points_m: Float
    slope: Float
    source: LandmarkSource
    metric: bool
    scale_variance: float = 0.0
    doubts: tuple[float, ...] = ()

    @property
    def triangulated_m(self) -> Float:
        """(N, 3) the points that give a motion its length, NaN for the others."""
        return (
            np.where(np.isfinite(self.slope[:, :1]), np.nan, self.points_m) if self.source == "plane" else self.points_m
        )

    def __post_init__(self) -> None:
        read_only(self.points_m, np.float64, (len(self.features.px), 3), "points_m")
        read_only(self.slope, np.float64, (len(self.features.px), 2), "slope")


@dataclass(frozen=True)
class Keyframe:
    """An image, its landmarks, and its pose; ``movable`` (H, W) is not 0 on movable objects, None if unknown.

    ``depth_m`` is that of the whole image, for features that are detected later; None if unknown or not used.
    """

    camera: Camera
    grey: Image
    landmarks: Landmarks
    odom_T_camera: Float
    stamp_ns: int
    movable: Image | None = None
    depth_m: Float32 | None = None

    def __post_init__(self) -> None:
        if self.depth_m is not None:
            read_only(self.depth_m, np.float32, (None, None), "depth_m")
        read_only(self.odom_T_camera, np.float64, (4, 4), "odom_T_camera")
        if self.movable is not None:
            read_only(self.movable, np.uint8, self.camera.size, "movable")
        read_only(self.grey, np.uint8, self.camera.size, "grey")


@dataclass(frozen=True)
class LastFrame:
    """The last frame whose pose is known, or at which odometry restarted.

    ``velocity`` is (6,) metres and radians per second in the ego frame, None before the second frame. ``found_px`` are
    the (N, 2) last pixels of the keyframe's features. ``influence`` (N, 6) is the pull of each feature on the pose
    against the keyframe, in ego's axes, None if unknown. ``length_variance`` is the additional variance of the distance
    from the keyframe, in square metres.
    """

    stamp_ns: int
    velocity: Float | None
    found_px: Float32
    influence: Float | None
    length_variance: float = 0.0

    def __post_init__(self) -> None:
        read_only(self.found_px, np.float32, (None, 2), "found_px")
        if self.velocity is not None:
            read_only(self.velocity, np.float64, (6,), "velocity")
        if self.influence is not None:
            read_only(self.influence, np.float64, (len(self.found_px), 6), "influence")


@dataclass(frozen=True)
class OdometryState:
    """The state of odometry between frames; ``band_correlations`` are those of ``own_car``."""

    odom_T_ego: Float = field(default_factory=lambda: np.eye(4))
    keyframe: Keyframe | None = None
    last: LastFrame | None = None
    pitch: CameraPitch | None = None
    speed: KnownSpeed | None = None
    band_correlations: tuple[float, ...] = ()
    depth_scale: DepthScale = field(default_factory=DepthScale)

    def __post_init__(self) -> None:
        read_only(self.odom_T_ego, np.float64, (4, 4), "odom_T_ego")
        if self.keyframe is not None and self.last is not None:
            read_only(self.last.found_px, np.float32, self.keyframe.landmarks.features.px.shape, "found_px")


def local_planes_from_depth(depth_m: Float32, px: Float, shrink: int) -> tuple[Float, Float]:
    """Inverse depths and their slopes, by least squares over surrounding pixels of the same surface.

    ``depth_m`` is (H, W) metres, NaN unknown; ``px`` are (N, 2) features in an image ``shrink`` times smaller.

    Returns:
        (N,) inverse depths at the features in 1/m, and (N, 2) their change per pixel of the smaller image to the right
        and down; NaN unknown.
    """
    rows, columns = depth_m.shape
    full = px * shrink + (shrink - 1) / 2
    centre = np.floor(px + 0.5).astype(int) * shrink
    dv, du = (d.ravel() for d in np.mgrid[-_REACH_PX : _REACH_PX + 1, -_REACH_PX : _REACH_PX + 1])
    u, v = np.clip(centre[:, :1] + du, 0, columns - 1), np.clip(centre[:, 1:] + dv, 0, rows - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        rho = 1.0 / depth_m[v, u].astype(float)
        middle = rho[:, len(du) // 2, None]
        same = np.abs(rho - middle) < _SAME_SURFACE * middle
    A = np.stack((np.ones_like(rho), u - full[:, :1], v - full[:, 1:]), axis=-1) * same[..., None]
    At = A.transpose(0, 2, 1)
    fit = np.linalg.solve(At @ A + _RIDGE * np.eye(3), At @ np.where(same, rho, 0.0)[..., None])[..., 0]
    fit[np.sum(same, axis=1) < _MIN_PIXELS] = np.nan
    return fit[:, 0], fit[:, 1:] * shrink


def slope_of_plane(camera: Camera, plane: Plane) -> Float:
    """(2,) change of 1 / depth per pixel to the right and down, the same all over a plane in the camera's frame."""
    nx, ny, _ = plane.normal
    return np.array((nx / camera.fx, ny / camera.fy)) / -plane.offset_m


def stretch(camera: Camera, px: Float, depth_m: Float, slope: Float, this_T_key: Float) -> Float:
    """(N, 2, 2) derivative of the pixel in this frame by the pixel around a feature of the keyframe.

    The features are at (N, 2) pixels with (N,) depths and (N, 2) slopes as ``local_planes_from_depth`` returns them.
    """
    points = rays(camera, px + _HALF_PIXELS[:, None]) / (1.0 / depth_m + _HALF_PIXELS @ slope.T)[..., None]
    right, left, below, above = project(camera, transform(this_T_key, points))
    return np.stack((right - left, below - above), axis=-1)


def _by_depth(cfg: OdometryConfig, frame: TrackingFrame) -> Landmarks | None:
    """Features with known depth; None without depth, or if they are too few."""
    if frame.depth_m is None:
        return None
    with np.errstate(invalid="ignore"):
        near = frame.depth_m[:: frame.shrink, :: frame.shrink] < np.float32(_MAX_DEPTH_M)
    features = _detected(cfg, frame, near.view(np.uint8))
    inverse_depth, slope = local_planes_from_depth(frame.depth_m, features.px.astype(float), frame.shrink)
    known = inverse_depth > 1.0 / _MAX_DEPTH_M
    if int(np.sum(known)) < 2 * cfg.min_inliers:
        return None
    features = features.take(known)
    points_m = unproject(frame.camera, features.px.astype(float), 1.0 / inverse_depth[known])
    return Landmarks(features, points_m, slope[known], "depth", metric=True)


def _carried_on(cfg: OdometryConfig, frame: TrackingFrame, carried: Landmarks | None) -> Landmarks:
    """The landmarks tracked into the frame, and new features between them.

    New ones on the road in front of the car lie on its plane, the points of all others are unknown.
    """
    features, strength = _candidates(cfg, frame, np.ones(frame.grey.shape, np.uint8))
    points_m, slope = _on_road(frame, features.px.astype(float))
    if carried is not None:
        # Optical flow needs no descriptors of features that ORB has matched.
        width, before = features.descriptors.shape[1], carried.features
        features = Features(before.px, before.descriptors[:, :width]).joined(features)
        points_m, slope = (np.concatenate(pair) for pair in ((carried.points_m, points_m), (carried.slope, slope)))
        strength = np.concatenate((np.full(len(carried.points_m), np.inf, np.float32), strength))
    chosen = spread(features.px, strength, frame.grey.shape)
    source: LandmarkSource = "carried" if frame.road is None else "plane"
    metric = frame.road is not None or (carried is not None and carried.metric)
    kept = Landmarks(features.take(chosen), points_m[chosen], slope[chosen], source, metric)
    return kept if carried is None else replace(kept, scale_variance=carried.scale_variance, doubts=carried.doubts)


def _on_road(frame: TrackingFrame, px: Float) -> tuple[Float, Float]:
    """(N, 3) points and (N, 2) slopes of (N, 2) pixels on the road in front of the car, NaN for the others."""
    points_m, slope = np.full((len(px), 3), np.nan), np.full((len(px), 2), np.nan)
    if frame.road is None:
        return points_m, slope
    on_plane = intersect_plane(frame.camera, px, frame.road.plane)
    x, y, _ = transform(frame.ego_T_camera, on_plane).T
    near, far = _ROAD_AHEAD_M
    ahead = (x > near) & (x < far) & (np.abs(y) < _ROAD_HALF_WIDTH_M)
    points_m[ahead] = on_plane[ahead]
    slope[ahead] = slope_of_plane(frame.camera, frame.road.plane)
    return points_m, slope


def _detected(cfg: OdometryConfig, frame: TrackingFrame, allowed: Image) -> Features:
    features, strength = _candidates(cfg, frame, allowed)
    return features.take(spread(features.px, strength, frame.grey.shape))


def _candidates(cfg: OdometryConfig, frame: TrackingFrame, allowed: Image) -> tuple[Features, Float32]:
    if frame.movable is not None:
        allowed = allowed & (frame.movable == 0)
    return FRONTENDS[cfg.features].detect(frame.grey, allowed)


def make_keyframe(
    cfg: OdometryConfig, frame: TrackingFrame, odom_T_camera: Float, carried: Landmarks | None = None
) -> Keyframe:
    """The frame as the keyframe of the next ones: its points come from depth, else it keeps those tracked into it.

    The latter are ``carried``.
    """
    landmarks = _by_depth(cfg, frame) or _carried_on(cfg, frame, carried)
    depth_m = frame.depth_m if landmarks.source == "depth" and cfg.features == "klt" else None
    return Keyframe(frame.camera, frame.grey, landmarks, odom_T_camera, frame.stamp_ns, frame.movable, depth_m)


def detected_again(
    cfg: OdometryConfig, keyframe: Keyframe, last: LastFrame, frame: TrackingFrame
) -> tuple[Keyframe, LastFrame]:
    """The keyframe with the features of another configuration, for a later frame that its own ones do not match.

    With depth the last velocity is left out: across a wide baseline, steady motion predicts the pixels too poorly. The
    influence of the features on the last pose is known only if the keyframe is the last frame.
    """
    then = replace(
        frame, grey=keyframe.grey, movable=keyframe.movable, depth_m=keyframe.depth_m, stamp_ns=keyframe.stamp_ns
    )
    keyframe = make_keyframe(cfg, then, keyframe.odom_T_camera)
    px = keyframe.landmarks.features.px
    influence = np.zeros((len(px), 6)) if last.stamp_ns == keyframe.stamp_ns else None
    velocity = None if keyframe.landmarks.source == "depth" else last.velocity
    return keyframe, replace(last, found_px=px, influence=influence, velocity=velocity)


def is_due(cfg: OdometryConfig, keyframe: Keyframe, frame: TrackingFrame, px: Float32, inliers: Mask) -> bool:
    """Whether the frame must become the next keyframe: few points are left, or they have moved far.

    A frame without depth replaces a keyframe with depth only when few points are left. The keyframe's features are at
    (N, 2) pixels in the frame; (N,) ``inliers`` agree on the motion.
    """
    share = float(np.sum(inliers)) / max(len(px), 1)
    if keyframe.landmarks.source == "depth" and frame.depth_m is None:
        return share < KEYFRAME_SHARE / 2 or int(np.sum(inliers)) < 2 * cfg.min_inliers
    shift = float(np.median(np.linalg.norm(px[inliers] - keyframe.landmarks.features.px[inliers], axis=1)))
    return share < KEYFRAME_SHARE or shift > scaled(KEYFRAME_FLOW_PX, frame.grey.shape[0])


def with_points(landmarks: Landmarks, motion: Motion) -> Landmarks:
    """The landmarks with the points that a motion has triangulated, and the variance of their scale."""
    known = np.isfinite(motion.points_m[:, 2:])
    variance = landmarks.scale_variance
    if motion.scale is not None and not motion.doubts:
        now = motion.noise_variance / float(np.sum(motion.this_T_key[:3, 3] ** 2))
        variance = min(variance, now) if np.isfinite(landmarks.triangulated_m[:, 2]).any() else now
    return replace(
        landmarks,
        points_m=np.where(known, motion.points_m, landmarks.points_m),
        slope=np.where(known, np.nan, landmarks.slope),
        scale_variance=variance,
        doubts=() if motion.scale == "measured" else motion.doubts or landmarks.doubts,
    )


def carry(camera: Camera, landmarks: Landmarks, motion: Motion, px: Float32) -> Landmarks:
    """The landmarks that agree on a motion, at their (N, 2) pixels in its frame, with their points in its camera.

    Each point keeps its depth and moves to the ray of its pixel.
    """
    kept = motion.inliers & (np.isfinite(motion.points_m[:, 2]) | (landmarks.source != "plane"))
    features = replace(landmarks.features.take(kept), px=px[kept])
    depth_m = transform(motion.this_T_key, motion.points_m[kept])[:, 2]
    points_m = unproject(camera, features.px.astype(float), np.where(depth_m > 0, depth_m, np.nan))
    variance = landmarks.scale_variance + _CARRIED_VARIANCE
    slope = np.full((len(points_m), 2), np.nan)
    return Landmarks(features, points_m, slope, "carried", landmarks.metric, variance, landmarks.doubts)


def counted_from_here(state: OdometryState) -> OdometryState:
    """The state with the origin of odom at the current ego frame."""
    here_T_odom, keyframe = inverse(state.odom_T_ego), state.keyframe
    if keyframe is not None:
        keyframe = replace(keyframe, odom_T_camera=here_T_odom @ keyframe.odom_T_camera)
    pitch = None if state.pitch is None else replace(state.pitch, levelled=0.0)
    return replace(state, odom_T_ego=np.eye(4), keyframe=keyframe, pitch=pitch)
