"""Metrics of the car's pose and step."""

from typing import Final

import numpy as np

from roadperc_stream.geometry import Float, inverse
from roadperc_stream.geometry.rotations import quaternion, rotation_angle, rotation_vector
from roadperc_stream.model import Absent, EarlierTruth, Odometry, Sample, Truth
from roadperc_stream.schemas.columns.errors import OdometryErrorColumns, TruePoseColumns
from roadperc_stream.schemas.columns.estimates import OdometryColumns

_POSE: Final = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


def odometry_columns(odometry: Odometry | Absent) -> OdometryColumns:
    """The columns of status, pose and step; a step up to scale has no length."""
    if isinstance(odometry, Absent):
        return OdometryColumns()
    step, covariance = odometry.step, odometry.covariance
    metric_step = None if odometry.up_to_scale else step
    turn_std = None if step is None else _std_along(rotation_vector(step[:3, :3]), covariance, 3)
    return OdometryColumns(
        odometry_status=odometry.status,
        odometry_inliers=odometry.inliers,
        step_m=None if metric_step is None else _length_m(metric_step),
        # The covariance is in the axes of the frame that the step leads to.
        step_std_m=None if metric_step is None else _std_along(inverse(metric_step)[:3, 3], covariance, 0),
        turn_deg=None if step is None else rotation_angle_deg(step),
        turn_std_deg=None if turn_std is None else float(np.degrees(turn_std)),
        **(_pose("odom", odometry.odom_T_ego) if odometry.has_length else {}),
    )


def true_pose_columns(truth: Truth) -> TruePoseColumns:
    """The true odom_T_ego, for the evaluation of trajectories from the table."""
    if truth.odom_T_ego is None:
        return TruePoseColumns()
    return TruePoseColumns(**_pose("true", truth.odom_T_ego))


def _pose(prefix: str, odom_T_ego: Float) -> dict[str, float]:
    """The columns ``PREFIX_x_m`` to ``PREFIX_qw``: position and unit quaternion of a (4, 4) transform."""
    values = (*(float(value) for value in odom_T_ego[:3, 3]), *quaternion(odom_T_ego[:3, :3]))
    return dict(zip((f"{prefix}_{name}" for name in _POSE), values, strict=True))


def odometry_errors(odometry: Odometry | Absent, sample: Sample, previous: EarlierTruth | None) -> OdometryErrorColumns:
    """Length and angle of the step's error, and of the true step."""
    if isinstance(odometry, Absent) or odometry.step is None or previous is None:
        return OdometryErrorColumns()
    before, now = previous.odom_T_ego, sample.truth.odom_T_ego
    if before is None or now is None or odometry.since_ns != previous.stamp_ns:
        return OdometryErrorColumns()
    true_step = inverse(before) @ now
    remainder = inverse(true_step) @ odometry.step
    return OdometryErrorColumns(
        step_error_m=None if odometry.up_to_scale else _length_m(remainder),
        turn_error_deg=rotation_angle_deg(remainder),
        true_step_m=_length_m(true_step),
        true_turn_deg=rotation_angle_deg(true_step),
    )


def _std_along(direction: Float, covariance: tuple[float, ...], first: int) -> float | None:
    """Standard deviation along a (3,) direction, of three of the six components from ``first`` on.

    A direction without a length has the largest deviation. None if the covariance is unknown.
    """
    if not covariance:
        return None
    part = np.reshape(covariance, (6, 6))[first : first + 3, first : first + 3]
    length = float(np.linalg.norm(direction))
    if length == 0:
        return float(np.sqrt(np.linalg.eigvalsh(part)[-1]))
    return float(np.sqrt(direction @ part @ direction)) / length


def _length_m(transform: Float) -> float:
    return float(np.linalg.norm(transform[:3, 3]))


def rotation_angle_deg(transform: Float) -> float:
    """Angle of a (4, 4) transform's rotation, degrees; accurate for small angles."""
    return float(np.degrees(rotation_angle(transform[:3, :3])))
