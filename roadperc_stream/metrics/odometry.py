"""Where the car is and how it moved, and how far that is off."""

import numpy as np
from scipy.spatial.transform import Rotation

from roadperc_stream.core.datatypes import Absent, Odometry, Sample, Truth
from roadperc_stream.core.geometry import Float, inverse, quaternion
from roadperc_stream.schemas.columns import Columns


def odometry_columns(odometry: Odometry | Absent) -> Columns:
    """Status, pose and step; a step that is only up to scale has no length."""
    if isinstance(odometry, Absent):
        return {}
    columns: Columns = {
        "odometry_status": odometry.status,
        "odometry_inliers": odometry.inliers,
        **_pose("odom", odometry.odom_T_ego),
    }
    if odometry.step is not None:
        columns["turn_deg"] = rotation_angle_deg(odometry.step)
        columns["step_m"] = None if odometry.up_to_scale else float(np.linalg.norm(odometry.step[:3, 3]))
    return columns


def true_pose_columns(truth: Truth) -> Columns:
    """The true odom_T_ego, so that whole trajectories are judged from the table alone."""
    return {} if truth.odom_T_ego is None else _pose("true", truth.odom_T_ego)


def _pose(prefix: str, odom_T_ego: Float) -> Columns:
    x, y, z = (float(value) for value in odom_T_ego[:3, 3])
    qx, qy, qz, qw = quaternion(odom_T_ego[:3, :3])
    places = {"x_m": x, "y_m": y, "z_m": z, "qx": qx, "qy": qy, "qz": qz, "qw": qw}
    return {f"{prefix}_{name}": value for name, value in places.items()}


def odometry_errors(odometry: Odometry | Absent, sample: Sample, previous: Sample | None) -> Columns:
    """What is left of the step when the true one is undone: its length and its angle."""
    if isinstance(odometry, Absent) or odometry.step is None or previous is None:
        return {}
    before, now = previous.truth.odom_T_ego, sample.truth.odom_T_ego
    if before is None or now is None or odometry.since_ns != previous.frame.stamp_ns:
        return {}
    left = inverse(inverse(before) @ now) @ odometry.step
    columns: Columns = {"turn_error_deg": rotation_angle_deg(left)}
    if not odometry.up_to_scale:
        columns["step_error_m"] = float(np.linalg.norm(left[:3, 3]))
    return columns


def rotation_angle_deg(transform: Float) -> float:
    """Angle of a (4, 4) transform's rotation, degrees; accurate for small angles."""
    return float(np.degrees(Rotation.from_matrix(transform[:3, :3]).magnitude()))
