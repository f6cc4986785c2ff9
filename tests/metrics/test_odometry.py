"""Poses in the table, and errors of steps against the truth."""

from dataclasses import replace

import numpy as np
import pytest

from roadperc_stream.geometry import rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.metrics import frame_metrics
from roadperc_stream.model import Odometry, Truth
from tests.metrics.frames import CFG, sample_and_result


def moved(x_m, y_m, yaw_deg=0.0):
    return rigid(rotation_from_rpy(0.0, 0.0, np.radians(yaw_deg)), np.array([x_m, y_m, 0.0]))


def row_of(step, true_step, **odometry):
    """The row of the second frame; the true pose of the first one is (10, 20), turned by 90 degrees."""
    before, result = sample_and_result()
    start = moved(10.0, 20.0, 90.0)
    before = replace(before, truth=Truth(odom_T_ego=start))
    now = replace(before, index=1, truth=Truth(odom_T_ego=start @ true_step))
    found = Odometry("tracked", step, step=step, since_ns=before.frame.stamp_ns, **odometry)
    return frame_metrics(CFG, "id", now, replace(result, odometry=found), before.as_earlier)


@pytest.mark.parametrize(
    ("step", "true_step", "errors", "true"),
    [
        (moved(13.0, 4.0), moved(10.0, 0.0), (5.0, 0.0), (10.0, 0.0)),
        (moved(1.0, 0.0, 3.0), moved(3.0, 4.0, 1.0), (np.hypot(2.0, 4.0), 2.0), (5.0, 1.0)),
    ],
)
def test_the_errors_of_a_step_and_the_true_step(step, true_step, errors, true):
    row = row_of(step, true_step)
    assert (row.step_error_m, row.turn_error_deg) == pytest.approx(errors, abs=1e-6)
    assert (row.true_step_m, row.true_turn_deg) == pytest.approx(true, abs=1e-6)


def test_the_true_step_has_no_error_and_the_true_pose_is_in_the_row():
    row = row_of(moved(1.0, 0.0), moved(1.0, 0.0))
    assert (row.step_error_m, row.turn_error_deg) == (pytest.approx(0.0, abs=1e-9), pytest.approx(0.0, abs=1e-6))
    assert (row.true_x_m, row.true_y_m, row.true_z_m) == (pytest.approx(10.0), pytest.approx(21.0), 0.0)
    half = np.sqrt(0.5)
    assert (row.true_qx, row.true_qy, row.true_qz, row.true_qw) == pytest.approx((0.0, 0.0, half, half))
    assert (row.odom_x_m, row.odom_qw) == (1.0, 1.0)


def test_without_scale_there_is_no_length_error_and_without_truth_no_error():
    row = row_of(moved(2.0, 0.0), moved(1.0, 0.0), up_to_scale=True)
    assert (row.step_error_m, row.turn_error_deg) == (None, pytest.approx(0.0, abs=1e-6))
    row = frame_metrics(CFG, "id", *sample_and_result())
    assert (row.true_x_m, row.true_qw, row.step_error_m, row.true_step_m) == (None, None, None, None)


def test_deviations_of_step_and_turn_are_along_the_motion():
    """The covariance is in the axes of the later frame: after a quarter turn its y is the reversed old x."""
    stds = np.array([0.01, 0.02, 0.03, 0.001, 0.002, 0.003])
    covariance = tuple(np.diag(stds**2).ravel())
    ahead = row_of(moved(2.0, 0.0, 0.1), moved(2.0, 0.0), covariance=covariance)
    assert ahead.step_std_m == pytest.approx(0.01, rel=1e-3)
    assert ahead.turn_std_deg == pytest.approx(np.degrees(0.003))
    turned = row_of(moved(2.0, 0.0, 90.0), moved(2.0, 0.0), covariance=covariance)
    assert turned.step_std_m == pytest.approx(0.02)


def test_a_step_of_unknown_covariance_or_scale_has_no_deviation():
    row = row_of(moved(2.0, 0.0, 1.0), moved(1.0, 0.0))
    assert (row.step_m, row.step_std_m, row.turn_std_deg) == (2.0, None, None)
    covariance = tuple(np.eye(6).ravel())
    row = row_of(moved(2.0, 0.0, 1.0), moved(1.0, 0.0), covariance=covariance, up_to_scale=True)
    assert (row.step_std_m, row.turn_std_deg) == (None, pytest.approx(np.degrees(1.0)))
    assert row_of(moved(0.0, 0.0), moved(0.0, 0.0), covariance=covariance).step_std_m == 1.0
