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
_SLOPE_PER_M: Final = np.deg2rad(0.15)
_TURN_STD: Final = np.deg2rad(0.02)
"""Standard deviations of the road's change of slope per metre, and of a tracked turn."""
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


def predicted(cfg: OdometryConfig, pitch: CameraPitch, last_T_this: Float) -> CameraPitch:
    """The pitch after a step, at first by how the camera turned."""
    length_m = float(np.linalg.norm(last_T_this[:3, 3]))
    turned = float(np.arctan2(-last_T_this[2, 0], last_T_this[0, 0]))
    grown = pitch.variance + _TURN_STD**2 + (_SLOPE_PER_M * length_m) ** 2
    most = begun(cfg).variance
    if cfg.pitch_std_deg == 0 or grown > most:
        return replace(pitch, variance=most)
    return replace(pitch, offset=pitch.offset + turned, variance=grown)


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
    variance = float(scatter(influence, key_px, width)[2, 2]) / length**2
    if turned > _TIGHTEST_PER_M * length or not 0 < variance < _MOST_DIRECTION_STD**2:
        return None
    return float(np.arctan2(driven[2], np.hypot(driven[0], driven[1]))), variance + _BODY_STD**2
