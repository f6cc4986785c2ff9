"""The length of a motion without depth: that of the road's image, fused with the one expected at the last known speed.

The pitch of the camera is estimated with it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from roadperc_stream.chain.stages.odometry.camera_pitch import CameraPitch, updated
from roadperc_stream.chain.stages.odometry.features import TrackingFrame
from roadperc_stream.chain.stages.odometry.keyframes import Keyframe
from roadperc_stream.chain.stages.odometry.motion import Motion, Scale
from roadperc_stream.chain.stages.odometry.road_image import RoadMotion, road_motion, road_view
from roadperc_stream.geometry import Float, inverse, rigid
from roadperc_stream.geometry.ground import tilted_ground
from roadperc_stream.geometry.planes import Plane, transform_plane

_PLANE_STD: Final = np.deg2rad(1.0)
"""Additional standard deviation of the pitch by the road's image: a road is crowned and patched."""
_ROAD_SHARE: Final = 0.01
"""Additional standard deviation of a length by the road, as a share, for the same reason."""
_LENGTH_PER_PITCH: Final = 5.0
"""Default share of a length per radian of pitch."""
_SIGMAS: Final = 3.0
_SEARCHED: Final = 0.3
"""Search range below and above the expected length, as its share."""
_CARRIED_SHARE: Final = 0.2
"""Largest standard deviation, as a share of the length, at which the last speed gives the scale."""
_CARRIED_M: Final = 0.02
"""The same in metres, for short lengths."""
_SURE_M: Final = 0.1
"""Largest standard deviation of a short expected length, metres, that counts as an expectation."""
_TIGHTEST_PER_M: Final = 0.15
"""Largest curvature of the road ahead."""
_HEIGHT_SHARE: Final = 0.045
"""Standard deviation of the camera height by the mounting, as a share; all lengths share it. Lengths were off by 1 and
6 % in two KITTI sequences, and by 8 % on a highway whose camera height is a guess."""
_LEAN_M: Final = 0.8
"""Standard deviation of a length in a bend, as a share, by its curvature per metre: the car leans to one side."""
_SQUAT_S2_PER_M: Final = 0.04
"""Standard deviation of a length while the car accelerates, as a share, by m/s2: the body pitches about half a degree
per m/s2, and its rise looks like the opposite pitch in the direction of motion."""
_SAME_DOUBT: Final = 0.05
"""Largest relative difference of successive doubts at which the road is right and the points are wrong."""
_DOUBTS: Final = 4
"""Number of such doubts: the shadow of a car ahead moves with it, so its image shows a short length in some frames."""


@dataclass(frozen=True)
class Expected:
    """The expected length in metres, with its variance."""

    length_m: float
    variance: float


def scaled_by_road(
    frame: TrackingFrame,
    keyframe: Keyframe,
    motion: Motion,
    pitch: CameraPitch,
    expected: Expected | None,
    possible_m: tuple[float, float],
    acceleration: Callable[[float, float], float],
    *,
    parallax_px: float,
) -> tuple[Motion, CameraPitch]:
    """The motion with the length that the road shows, else the expected length; and the updated pitch.

    The pitch counts if the road's plane is assumed from the mounting.
    ``expected`` is the length by triangulated points or at the last known speed, ``possible_m`` the shortest and the
    longest length that a car can drive, ``parallax_px`` the median shift of the features beyond that of the rotation.
    ``acceleration`` gives the size of the car's acceleration, m/s2, by the length and its variance.
    """
    length = float(np.linalg.norm(motion.this_T_key[:3, 3]))
    R, t = motion.this_T_key[:3, :3], motion.this_T_key[:3, 3] / length
    bend_per_m = _curvature(frame, R, expected)
    find = partial(_on_road, frame, keyframe, (R, t), pitch, bend_per_m, parallax_px=parallax_px)
    found = None
    if expected is not None:
        reach_m = _SEARCHED * expected.length_m + _SIGMAS * float(np.sqrt(expected.variance))
        near_m = max(expected.length_m - reach_m, possible_m[0]), min(expected.length_m + reach_m, possible_m[1])
        is_sure = expected.variance <= max(_CARRIED_SHARE * expected.length_m, _SURE_M) ** 2
        found = find(near_m, is_expected=is_sure)
    if found is None:
        found = find(possible_m, is_expected=False)
    if found is None:
        return _carried(motion, pitch, expected, bend_per_m), pitch
    before = pitch
    if _is_assumed(frame):
        pitch = updated(pitch, (pitch.offset + found.pitch, found.pitch_variance + _PLANE_STD**2))
        found = replace(found, length_m=found.length_m + found.metres_per_pitch * (pitch.offset - before.offset))
    if expected is not None and _contradict(found, expected):
        doubts = (*keyframe.landmarks.doubts, found.length_m / expected.length_m)[-_DOUBTS:]
        if len(doubts) < _DOUBTS or max(doubts) > (1.0 + _SAME_DOUBT) * min(doubts):
            return _doubted(_carried(motion, before, expected, bend_per_m), doubts), before
        expected = None
    length_m, noise = _fused(found, expected)
    shared = 0.0
    if _is_assumed(frame):
        shared = found.metres_per_pitch**2 * pitch.variance + _mounting_variance(length_m, bend_per_m)
        shared += (_SQUAT_S2_PER_M * acceleration(length_m, noise) * length_m) ** 2
    return _with_length(motion, "measured", length_m, noise, max(shared, found.variance)), pitch


def _curvature(frame: TrackingFrame, R: Float, expected: Expected | None) -> float:
    """Curvature of the car's path, 1/m, positive to the left; 0 without an expected length."""
    turned = frame.ego_T_camera[:3, :3] @ R.T @ frame.ego_T_camera[:3, :3].T
    if expected is None or expected.length_m <= 0:
        return 0.0
    per_m = float(np.arctan2(turned[1, 0], turned[0, 0])) / expected.length_m
    return float(np.clip(per_m, -_TIGHTEST_PER_M, _TIGHTEST_PER_M))


def _mounting_variance(length_m: float, bend_per_m: float) -> float:
    """Variance of a length by the mounting: its height, and the car's lean in a bend."""
    return length_m**2 * (_HEIGHT_SHARE**2 + (_LEAN_M * bend_per_m) ** 2)


def _on_road(
    frame: TrackingFrame,
    keyframe: Keyframe,
    turn: tuple[Float, Float],
    pitch: CameraPitch,
    bend_per_m: float,
    tried_m: tuple[float, float],
    *,
    is_expected: bool,
    parallax_px: float,
) -> RoadMotion | None:
    if frame.road is None:
        return None
    plane = frame.road.plane
    if _is_assumed(frame):
        plane = transform_plane(inverse(frame.ego_T_camera), tilted_ground(frame.ego_T_camera, pitch.offset))
    # The camera moves along the road: it was as high above it at the keyframe.
    key_plane = Plane.of(turn[0].T @ plane.n, plane.offset_m)
    view = road_view(frame.camera, frame.ego_T_camera, key_plane, keyframe.grey, keyframe.movable, bend_per_m)
    if view is None:
        return None
    return road_motion(view, frame.grey, frame.movable, turn, tried_m, is_expected=is_expected, parallax_px=parallax_px)


def _is_assumed(frame: TrackingFrame) -> bool:
    return frame.road is not None and frame.road.source == "assumed"


def _noise(found: RoadMotion) -> float:
    return found.variance + (_ROAD_SHARE * found.length_m) ** 2


def _contradict(found: RoadMotion, expected: Expected) -> bool:
    """Whether a length by the road and the expected length differ beyond their deviations."""
    return (expected.length_m - found.length_m) ** 2 > _SIGMAS**2 * (_noise(found) + expected.variance)


def _fused(found: RoadMotion, expected: Expected | None) -> tuple[float, float]:
    """Length and variance, fused from the road and the expected length."""
    noise = _noise(found)
    if expected is None:
        return found.length_m, noise
    gain = noise / (noise + expected.variance)
    return found.length_m + gain * (expected.length_m - found.length_m), (1.0 - gain) * noise


def _doubted(carried: Motion, doubts: tuple[float, ...]) -> Motion:
    """The motion with the expected length that a length by the road contradicts; ``doubts`` are ratios of the two.

    Its standard deviation grows by a third of their difference. Single wrong matches change nothing, and several in a
    row with the same ratio are believed.
    """
    off_m = (doubts[-1] - 1.0) * float(np.linalg.norm(carried.this_T_key[:3, 3]))
    return replace(carried, doubts=doubts, length_variance=carried.length_variance + (off_m / _SIGMAS) ** 2)


def _carried(motion: Motion, pitch: CameraPitch, expected: Expected | None, bend_per_m: float) -> Motion:
    if expected is None or expected.variance > max(_CARRIED_SHARE * expected.length_m, _CARRIED_M) ** 2:
        return replace(motion, scaled=False, scale="none")
    by_pitch = (_LENGTH_PER_PITCH * expected.length_m) ** 2 * pitch.variance
    shared = by_pitch + _mounting_variance(expected.length_m, bend_per_m)
    return _with_length(motion, "points" if motion.scaled else "carried", expected.length_m, expected.variance, shared)


def _with_length(motion: Motion, scale: Scale, length_m: float, noise: float, shared: float) -> Motion:
    """The motion scaled to a length, with its triangulated points."""
    factor = length_m / float(np.linalg.norm(motion.this_T_key[:3, 3]))
    R, t = motion.this_T_key[:3, :3], motion.this_T_key[:3, 3]
    influence = None if motion.influence is None else motion.influence * ([factor] * 3 + [1.0] * 3)
    return replace(
        motion,
        this_T_key=rigid(R, factor * t),
        points_m=factor * motion.points_m,
        influence=influence,
        scaled=True,
        length_variance=noise + shared,
        scale=scale,
        noise_variance=noise,
    )
