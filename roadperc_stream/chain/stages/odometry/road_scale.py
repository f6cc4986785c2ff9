"""A motion without depth: the length that the tracked points leave open, by the road and by the speed so far."""

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from roadperc_stream.chain.stages.odometry.camera_pitch import CameraPitch, updated
from roadperc_stream.chain.stages.odometry.features import TrackingFrame
from roadperc_stream.chain.stages.odometry.motion import Motion
from roadperc_stream.chain.stages.odometry.road_alignment import RoadMotion, road_motion, road_view
from roadperc_stream.geometry import Float, Plane, inverse, rigid, transform_plane
from roadperc_stream.geometry.ground import tilted_ground
from roadperc_stream.model import Image

Scale = Literal["measured", "carried", "none"]
_PLANE_STD: Final = np.deg2rad(1.0)
"""Standard deviation of the pitch by the road's picture beyond its grain: a road is crowned and patched."""
_ROAD_SHARE: Final = 0.01
"""Standard deviation of a length by the road, as a share, for the same reason."""
_LENGTH_PER_PITCH: Final = 5.0
"""Share of a length per radian of pitch, where the road does not say."""
_ACCELERATION: Final = 2.0
"""Metres per second squared: standard deviation of how the speed changes from frame to frame."""
_SIGMAS: Final = 3.0
_SEARCHED: Final = 0.3
"""Share of the length that is expected, by which it is searched below and above."""
_CARRIED_SHARE: Final = 0.2
"""Standard deviation, as a share of the length, up to which the speed so far gives the scale."""


@dataclass(frozen=True)
class Expected:
    """A length in metres that the speed so far promises, with its variance."""

    length_m: float
    variance: float


@dataclass(frozen=True)
class ScaledMotion:
    """A motion with its length, the pitch after it, the part of the length's variance that later ones do not share."""

    motion: Motion
    pitch: CameraPitch
    scale: Scale
    noise_variance: float


def expected_length(
    driven_m: float, driven_variance: float, speed_mps: float, speed_variance: float, seconds: float
) -> Expected:
    """The distance from the keyframe after some seconds.

    Args:
        driven_m: that of the last frame.
        driven_variance: square metres.
        speed_mps: then.
        speed_variance: square metres per second squared.
        seconds: since then.
    """
    speed_variance += (_ACCELERATION * seconds) ** 2
    return Expected(driven_m + speed_mps * seconds, driven_variance + speed_variance * seconds**2)


def scaled_by_road(
    frame: TrackingFrame,
    key_grey: Image,
    motion: Motion,
    pitch: CameraPitch,
    expected: Expected | None,
    longest_m: float,
) -> ScaledMotion:
    """A motion with the length that the road shows, or else the one that is expected.

    Args:
        frame: this frame; its road is that of the mounting, or measured.
        key_grey: the keyframe's image.
        motion: turn and direction.
        pitch: of the camera, if the road is that of the mounting.
        expected: the length by the speed so far; None: not known.
        longest_m: by the fastest motion since the keyframe.
    """
    length = float(np.linalg.norm(motion.this_T_key[:3, 3]))
    R, t = motion.this_T_key[:3, :3], motion.this_T_key[:3, 3] / length
    tried_m = (0.0, longest_m) if expected is None else _around(expected, longest_m)
    found = _on_road(frame, key_grey, (R, t), pitch, tried_m)
    if found is None:
        return _carried(motion, pitch, expected)
    if _is_assumed(frame):
        sharper = updated(pitch, (pitch.offset + found.pitch, found.pitch_variance + _PLANE_STD**2))
        found = replace(found, length_m=found.length_m + found.metres_per_pitch * (sharper.offset - pitch.offset))
        pitch = sharper
    length_m, noise = _fused(found, expected)
    shared = found.metres_per_pitch**2 * pitch.variance if _is_assumed(frame) else 0.0
    return ScaledMotion(_with_length(motion, length_m, noise + shared), pitch, "measured", noise)


def _on_road(
    frame: TrackingFrame, key_grey: Image, turn: tuple[Float, Float], pitch: CameraPitch, tried_m: tuple[float, float]
) -> RoadMotion | None:
    if frame.road is None:
        return None
    plane = frame.road.plane
    if _is_assumed(frame):
        plane = transform_plane(inverse(frame.ego_T_camera), tilted_ground(frame.ego_T_camera, pitch.offset))
    # The camera moves along the road: it was as high above it at the keyframe.
    key_plane = Plane.of(turn[0].T @ plane.n, plane.offset_m)
    view = road_view(frame.camera, frame.ego_T_camera, key_plane, key_grey)
    if view is None:
        return None
    return road_motion(view, frame.grey, frame.movable, turn, tried_m)


def _is_assumed(frame: TrackingFrame) -> bool:
    return frame.road is not None and frame.road.source == "assumed"


def _around(expected: Expected, longest_m: float) -> tuple[float, float]:
    reach_m = _SEARCHED * expected.length_m + _SIGMAS * float(np.sqrt(expected.variance))
    return max(expected.length_m - reach_m, 0.0), min(expected.length_m + reach_m, longest_m)


def _fused(found: RoadMotion, expected: Expected | None) -> tuple[float, float]:
    """Length and variance by the road and by what was expected, which does not count where they contradict."""
    noise = found.variance + (_ROAD_SHARE * found.length_m) ** 2
    if expected is None:
        return found.length_m, noise
    off = expected.length_m - found.length_m
    if off**2 > _SIGMAS**2 * (noise + expected.variance):
        return found.length_m, noise
    gain = noise / (noise + expected.variance)
    return found.length_m + gain * off, (1.0 - gain) * noise


def _carried(motion: Motion, pitch: CameraPitch, expected: Expected | None) -> ScaledMotion:
    if expected is None or expected.variance > (_CARRIED_SHARE * expected.length_m) ** 2:
        return ScaledMotion(replace(motion, scaled=False), pitch, "none", 0.0)
    shared = (_LENGTH_PER_PITCH * expected.length_m) ** 2 * pitch.variance
    with_length = _with_length(motion, expected.length_m, expected.variance + shared)
    return ScaledMotion(with_length, pitch, "carried", expected.variance)


def _with_length(motion: Motion, length_m: float, variance: float) -> Motion:
    """A motion as long as that; what it triangulated is as far away as that makes it."""
    factor = length_m / float(np.linalg.norm(motion.this_T_key[:3, 3]))
    R, t = motion.this_T_key[:3, :3], motion.this_T_key[:3, 3]
    influence = None if motion.influence is None else motion.influence * ([factor] * 3 + [1.0] * 3)
    return replace(
        motion,
        this_T_key=rigid(R, factor * t),
        points_m=factor * motion.points_m,
        influence=influence,
        scaled=True,
        length_variance=variance,
    )
