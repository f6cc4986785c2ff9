"""How far down the camera looks against the road, where no depth shows it: a running estimate with its variance.

A car moves along the road, so the direction of its motion (the focus of expansion of the tracked points), the vanishing
point of the road's lines and the plane by which the road's picture moves all show the pitch. Each is a measurement of
one scalar Kalman filter; between two frames the pitch turns as the camera does, and the road's own slope may change.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from roadperc_stream.chain.stages.odometry.motion import Motion
from roadperc_stream.chain.stages.odometry.uncertainty import in_ego_axes, scatter
from roadperc_stream.core.config import OdometryConfig
from roadperc_stream.core.geometry import Float, Float32, inverse

_BODY_STD: Final = np.deg2rad(0.3)
"""Standard deviation of the direction of motion against the road: the body heaves on its springs."""
_MOST_DIRECTION_STD: Final = np.deg2rad(1.0)
"""Uncertainty of the direction of motion beyond which it is refused."""
_TIGHTEST_PER_M: Final = 0.05
"""Turn per metre, radians, beyond which the direction of motion is refused: the car leans, and slips sideways."""
_SLOPE_STD_PER_ROOT_M: Final = np.deg2rad(0.15)
_TURN_STD_PER_ROOT_S: Final = np.deg2rad(0.06)
"""Standard deviations of the road's change of slope after a metre, and of the tracked turn after a second; their
squares grow with way and time, whatever the frame rate."""
_UNSEEN_SPEED_MPS: Final = 15.0
"""How fast the car is taken to drive while nothing is tracked."""
_GATE: Final = 9.0
"""Squared standard deviations beyond which a measurement counts less, as Huber has it."""


@dataclass(frozen=True)
class CameraPitch:
    """By how much more than the mounting says the camera looks down on the road, radians, and its variance.

    ``measured`` says that the motion or the road's picture has shown it.
    """

    offset: float
    variance: float
    measured: bool = False


def begun(cfg: OdometryConfig) -> CameraPitch:
    """What is known by the mounting alone."""
    return CameraPitch(0.0, float(np.deg2rad(cfg.pitch_std_deg)) ** 2)


def predicted(cfg: OdometryConfig, pitch: CameraPitch, last_T_this: Float, seconds: float) -> CameraPitch:
    """The pitch after a step, at first by how the camera turned; the mounting's, once that is as sure."""
    length_m = float(np.linalg.norm(last_T_this[:3, 3]))
    turned = float(np.arctan2(-last_T_this[2, 0], last_T_this[0, 0]))
    return _grown(cfg, replace(pitch, offset=pitch.offset + turned), length_m, seconds)


def after_loss(cfg: OdometryConfig, pitch: CameraPitch, seconds: float) -> CameraPitch:
    """The pitch after a time in which nobody knows how the car moved."""
    return _grown(cfg, pitch, _UNSEEN_SPEED_MPS * seconds, seconds)


def _grown(cfg: OdometryConfig, pitch: CameraPitch, length_m: float, seconds: float) -> CameraPitch:
    variance = pitch.variance + _SLOPE_STD_PER_ROOT_M**2 * length_m + _TURN_STD_PER_ROOT_S**2 * seconds
    mounting = begun(cfg)
    return replace(pitch, variance=variance) if variance < mounting.variance else mounting


def updated(pitch: CameraPitch, measured: tuple[float, float] | None) -> CameraPitch:
    """The pitch after a measurement and its variance; one far off counts less, none changes nothing."""
    if measured is None or pitch.variance == 0:
        return pitch
    value, variance = measured
    off = value - pitch.offset
    excess = off**2 / (pitch.variance + variance) / _GATE
    variance *= max(excess, 1.0)
    gain = pitch.variance / (pitch.variance + variance)
    return CameraPitch(pitch.offset + gain * off, (1.0 - gain) * pitch.variance, measured=True)


def expansion(motion: Motion, ego_T_camera: Float, key_px: Float32, width: int) -> tuple[float, float] | None:
    """The pitch by the direction of motion, and its variance.

    Args:
        motion: from the keyframe.
        ego_T_camera: the mounting.
        key_px: (N, 2) the keyframe's features.
        width: of its image.

    Returns:
        The elevation of the motion in ego's axes, radians, which is how far down the camera looks; None where the
        direction is not sure, or the car turns tightly.
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
