"""The camera's pitch against the road without depth: a running estimate, also from vanishing points.

Lane markings, kerbs and walls run along the road and meet at one point of its horizon. The line segment detector finds
them (Grompone von Gioi et al., "LSD: a Line Segment Detector", IPOL 2012). The crossing of a pair
with the largest length of agreeing segments is chosen and refined by least squares. In a bend, on a wet road or in a
yard the lines have no common point or a wrong one. Such a point is rejected.

A car moves along the road. The direction of its motion (the focus of expansion), the vanishing point of the lines and
the motion of the road's image all measure the pitch. One scalar Kalman filter fuses them. Between two frames the pitch
turns with the camera, and the slope of the road may change.
"""

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import cv2
import numpy as np

from roadperc_stream.chain.stages.odometry.motion import Motion, in_ego_axes, scatter
from roadperc_stream.config import OdometryConfig, scaled
from roadperc_stream.geometry import Camera, Float, Float32, inverse, rays
from roadperc_stream.model import Image, Mask

LINES_STD: Final = np.deg2rad(0.6)
"""Additional standard deviation of the pitch by lines: they follow the road, which bends and climbs."""
_STEEPEST: Final = np.deg2rad(8.0)
"""Search range of the point, radians from the mounting's horizon."""
LANES_STEEPEST: Final = np.deg2rad(20.0)
"""The same for lanes alone. Few other lines cross there, and a wrong field of view moves the point this far."""
_WIDEST: Final = 0.5
"""Search range of the point to either side of ego's x axis, as a tangent."""
_LEAST_LENGTH_PX: Final = 60.0
_AGREE_PX: Final = 3.0
"""Minimum length of a segment, and maximum distance of its end from the line to the point, at 960 rows."""
_LEAST_AGREE_PX: Final = 1.0
"""Lower limit of that distance: the accuracy of the detector."""
_LEAST_SLOPE: Final = 0.15
"""Rows per column below which a segment runs across the view; its crossings with other segments are not used."""
_MOST_SEGMENTS: Final = 40
_LEAST_SEGMENTS: Final = 6
_LEAST_SHARE: Final = 0.5
"""Minimum share of the segments' length that agrees."""
_REFINEMENTS: Final = 4
"""Number of refinements; each selects the segments again, because crossings of a marking's edges miss the point."""
_SINGULAR: Final = 1e6
_LEAST_SPREAD: Final = 0.5
"""Minimum range of the segments' directions, radians; nearly parallel segments determine no point."""
_BODY_STD: Final = np.deg2rad(0.3)
"""Standard deviation of the direction of motion against the road: the body moves on its springs."""
_MOST_DIRECTION_STD: Final = np.deg2rad(1.0)
"""Largest accepted standard deviation of the direction of motion."""
_TIGHTEST_PER_M: Final = 0.05
"""Largest accepted turn per metre, radians: beyond it the car leans and slips sideways."""
_SLOPE_STD_PER_ROOT_M: Final = np.deg2rad(0.15)
_TURN_STD_PER_ROOT_S: Final = np.deg2rad(0.06)
"""Standard deviations of the road's slope change after one metre, and of the tracked turn after one second. Their
squares grow with distance and time, independent of the frame rate."""
_UNSEEN_SPEED_MPS: Final = 15.0
"""Assumed speed of the car while nothing is tracked."""
_GATE: Final = 9.0
"""Squared standard deviations beyond which a measurement counts less (Huber)."""


@dataclass(frozen=True)
class CameraPitch:
    """The pitch of the camera against the road beyond its mounting, radians, nose down, and its variance.

    ``measured`` is true once the motion or the road's image has shown it. ``mounting`` is the mean of the measured
    pitch over the driven distance, radians, without slopes and springs. ``weight`` is the sum of its weights, metres
    per squared radian. ``levelled`` is the part of it in the pose.
    """

    offset: float
    variance: float
    measured: bool = False
    mounting: float = 0.0
    weight: float = 0.0
    levelled: float = 0.0


def pitch_by_lines(
    camera: Camera, ego_T_camera: Float, grey: Image, movable: Image | None
) -> tuple[float, float] | None:
    """The pitch of the camera beyond its mounting (radians, nose down) by vanishing point, and its variance.

    Only lines of the (H, W) image where ``movable`` (H, W) is 0 count. None if too few agree on a point near the
    horizon.
    """
    return pitch_of_segments(camera, ego_T_camera, _segments(camera, grey, movable), _LEAST_SEGMENTS)


def pitch_of_segments(
    camera: Camera, ego_T_camera: Float, segments: Float, fewest: int, steepest: float = _STEEPEST
) -> tuple[float, float] | None:
    """The pitch and its variance as in ``pitch_by_lines``, by (N, 4) segments x1, y1, x2, y2.

    None if fewer than ``fewest`` segments agree, or if the pitch is above ``steepest``, radians.
    """
    if len(segments) < fewest:
        return None
    points = _crossings(segments)
    elevation, ahead = _elevations(camera, ego_T_camera, points)
    points = points[ahead & (np.abs(elevation) < steepest)]
    if not len(points):
        return None
    lengths = np.linalg.norm(segments[:, 2:] - segments[:, :2], axis=1)
    agree = np.array([_agreeing(camera, segments, point) for point in points])
    point = points[int(np.argmax(agree @ lengths))]
    for _ in range(_REFINEMENTS):
        chosen = _agreeing(camera, segments, point)
        if np.sum(chosen) < fewest or lengths[chosen].sum() < _LEAST_SHARE * lengths.sum():
            return None
        fitted = _meeting(segments[chosen], lengths[chosen])
        if fitted is None:
            return None
        point, variance_px = fitted
    elevation, ahead = _elevations(camera, ego_T_camera, point[None])
    if not ahead[0] or abs(elevation[0]) > steepest:
        return None
    return float(elevation[0]), variance_px / camera.fy**2 + float(LINES_STD) ** 2


def _segments(camera: Camera, grey: Image, movable: Image | None) -> Float:
    """(N, 4) x1, y1, x2, y2 of the longest segments that do not run across the view."""
    found = cv2.createLineSegmentDetector().detect(grey)[0]
    if found is None:
        return np.empty((0, 4))
    segments = np.asarray(found, float).reshape(-1, 4)
    along = segments[:, 2:] - segments[:, :2]
    lengths = np.linalg.norm(along, axis=1)
    upright = np.abs(along[:, 0]) < _LEAST_SLOPE * np.abs(along[:, 1])
    flat = np.abs(along[:, 1]) < _LEAST_SLOPE * np.abs(along[:, 0])
    kept = (lengths > scaled(_LEAST_LENGTH_PX, camera.height)) & ~upright & ~flat
    if movable is not None:
        columns, rows = np.clip(np.rint(segments[:, :2] + along / 2).astype(int), 0, np.array(grey.shape[::-1]) - 1).T
        kept &= movable[rows, columns] == 0
    longest = np.argsort(-lengths[kept], kind="stable")[:_MOST_SEGMENTS]
    return np.asarray(segments[kept][longest])


def _homogeneous(segments: Float) -> Float:
    """(N, 3) lines a x + b y + c = 0 with a and b of unit length."""
    ones = np.ones((len(segments), 1))
    lines = np.cross(np.hstack((segments[:, :2], ones)), np.hstack((segments[:, 2:], ones)))
    return np.asarray(lines / np.linalg.norm(lines[:, :2], axis=1, keepdims=True))


def _crossings(segments: Float) -> Float:
    """(M, 2) pixels where pairs of segments cross."""
    lines = _homogeneous(segments)
    i, j = np.array(list(combinations(range(len(lines)), 2))).T
    crossing = np.cross(lines[i], lines[j])
    crossing = crossing[np.abs(crossing[:, 2]) > 1e-3]
    return np.asarray(crossing[:, :2] / crossing[:, 2:])


def _elevations(camera: Camera, ego_T_camera: Float, points: Float) -> tuple[Float, Mask]:
    """(M,) elevations of pixels' rays above ego's x-y plane, radians, and (M,) whether each points ahead."""
    directions = rays(camera, points) @ ego_T_camera[:3, :3].T
    ahead = (directions[:, 0] > 0) & (np.abs(directions[:, 1]) < _WIDEST * directions[:, 0])
    return np.arctan2(directions[:, 2], np.hypot(directions[:, 0], directions[:, 1])), np.asarray(ahead)


def _agreeing(camera: Camera, segments: Float, point: Float) -> Mask:
    """(N,) segments whose ends lie near the line from their middle to a point."""
    middle, half = (segments[:, :2] + segments[:, 2:]) / 2, (segments[:, 2:] - segments[:, :2]) / 2
    towards = point - middle
    off = np.abs(half[:, 0] * towards[:, 1] - half[:, 1] * towards[:, 0]) / np.linalg.norm(towards, axis=1)
    return np.asarray(off < max(scaled(_AGREE_PX, camera.height), _LEAST_AGREE_PX))


def _meeting(segments: Float, lengths: Float) -> tuple[Float, float] | None:
    """The (2,) point nearest to all lines, weighted by length, and the variance of its row, pixels squared."""
    lines = _homogeneous(segments)
    spread = np.ptp(np.arctan2(*(lines[:, k] * np.sign(lines[:, 1]) for k in (0, 1))))
    N = (lines[:, :2] * lengths[:, None]).T @ lines[:, :2]
    if spread < _LEAST_SPREAD or np.linalg.cond(N) > _SINGULAR:
        return None
    point = np.asarray(np.linalg.solve(N, -(lines[:, :2] * lengths[:, None]).T @ lines[:, 2]), np.float64)
    off = lines[:, :2] @ point + lines[:, 2]
    covariance = np.linalg.inv(N) * float(lengths @ off**2) / max(len(lines) - 2, 1)
    return point, float(covariance[1, 1])


def begun(cfg: OdometryConfig) -> CameraPitch:
    """The initial pitch, by the mounting alone."""
    return CameraPitch(0.0, float(np.deg2rad(cfg.pitch_std_deg)) ** 2)


def predicted(cfg: OdometryConfig, pitch: CameraPitch, last_T_this: Float, seconds: float) -> CameraPitch:
    """The pitch after a step, turned with the camera; reset once it is no more certain than the mounting."""
    length_m = float(np.linalg.norm(last_T_this[:3, 3]))
    turned = float(np.arctan2(-last_T_this[2, 0], last_T_this[0, 0]))
    return _grown(cfg, replace(pitch, offset=pitch.offset + turned), length_m, seconds)


def after_loss(cfg: OdometryConfig, pitch: CameraPitch, seconds: float) -> CameraPitch:
    """The pitch after a time of unknown motion."""
    return _grown(cfg, pitch, _UNSEEN_SPEED_MPS * seconds, seconds)


def _grown(cfg: OdometryConfig, pitch: CameraPitch, length_m: float, seconds: float) -> CameraPitch:
    variance = pitch.variance + _SLOPE_STD_PER_ROOT_M**2 * length_m + _TURN_STD_PER_ROOT_S**2 * seconds
    if variance >= begun(cfg).variance:
        pitch, variance = replace(pitch, offset=0.0, measured=False), begun(cfg).variance
    return replace(pitch, variance=variance)


def updated(pitch: CameraPitch, measured: tuple[float, float] | None) -> CameraPitch:
    """The pitch after a measurement with its variance; an outlier counts less. None leaves the pitch unchanged."""
    if measured is None or pitch.variance == 0:
        return pitch
    value, variance = measured
    off = value - pitch.offset
    excess = off**2 / (pitch.variance + variance) / _GATE
    variance *= max(excess, 1.0)
    gain = pitch.variance / (pitch.variance + variance)
    return replace(pitch, offset=pitch.offset + gain * off, variance=(1.0 - gain) * pitch.variance, measured=True)


def averaged(pitch: CameraPitch, length_m: float) -> CameraPitch:
    """The pitch with the mean of its mounting after a further step, metres."""
    if not pitch.measured or pitch.variance == 0 or length_m == 0:
        return pitch
    added = length_m / pitch.variance
    share = added / (pitch.weight + added)
    mounting = pitch.mounting + share * (pitch.offset - pitch.mounting)
    return replace(pitch, mounting=mounting, weight=pitch.weight + added)


def expansion(motion: Motion, ego_T_camera: Float, key_px: Float32, width: int) -> tuple[float, float] | None:
    """The pitch by the direction of motion from the keyframe, radians, and its variance.

    It is the elevation of the motion in the ego frame's axes. ``key_px`` are the (N, 2) features of the keyframe, in an
    image ``width`` pixels wide. None if the direction is uncertain or the car turns tightly.
    """
    this_T_key = ego_T_camera @ motion.this_T_key @ inverse(ego_T_camera)
    driven = this_T_key[:3, 3] * np.sign(this_T_key[0, 3])
    length = float(np.linalg.norm(driven))
    influence = in_ego_axes(ego_T_camera, motion.influence)
    if influence is None or length == 0:
        return None
    turned = float(np.arccos(np.clip((np.trace(this_T_key[:3, :3]) - 1) / 2, -1, 1)))
    covariance = scatter(influence, key_px, width)
    variance = 0.0 if covariance is None else float(covariance[2, 2]) / length**2
    if turned > _TIGHTEST_PER_M * length or not 0 < variance < _MOST_DIRECTION_STD**2:
        return None
    return float(np.arctan2(driven[2], np.hypot(driven[0], driven[1]))), variance + _BODY_STD**2
