"""Reprojection compiled and by numpy: known residuals, derivatives by differences, the same bits of any number."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from roadperc_stream.chain.kernels import odometry_plain
from roadperc_stream.chain.kernels.odometry_plain import Projection, Weighting
from roadperc_stream.geometry.rotations import rotation_from_vector

reprojection_compiled = pytest.importorskip("roadperc_stream.chain.kernels.odometry_compiled")
BOTH = pytest.mark.parametrize("kernel", [odometry_plain, reprojection_compiled], ids=["plain", "compiled"])
PROJECTION = Projection(500.0, 400.0, 320.0, 240.0)
SHARP = Weighting(std_px=0.5, depth_std_per_m=0.0, full=1e9, gate=1e9)
STANDING = np.eye(4)
NUMBERS = st.floats(-30, 30) | st.floats()
ROWS = arrays(float, st.tuples(st.integers(0, 4), st.just(5)), elements=NUMBERS)


def linearised(kernel, points_m, px, this_T_key=STANDING, weighting=SHARP):
    return kernel.linearise(PROJECTION, weighting, np.array(points_m, float), np.array(px, float), this_T_key)


def moved(small):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_vector(np.array(small[3:])), small[:3]
    return T


@BOTH
def test_residuals_are_in_standard_deviations(kernel):
    residual, _, agrees = linearised(kernel, [(1.0, 2.0, 10.0)], [(371.0, 319.0)])
    np.testing.assert_allclose(residual, (2.0, -2.0))
    assert agrees.tolist() == [1]


@BOTH
def test_derivatives_are_those_of_differences(kernel):
    points = np.random.default_rng(3).uniform((-4.0, -2.0, 4.0), (4.0, 2.0, 20.0), (50, 3))
    px, T = np.zeros((50, 2)), moved((0.1, 0.2, 0.5, 0.02, -0.03, 0.01))
    J = linearised(kernel, points, px, T)[1]
    for k, small in enumerate(1e-6 * np.eye(6)):
        after, before = (linearised(kernel, points, px, moved(sign * small) @ T)[0] for sign in (1, -1))
        np.testing.assert_allclose(-(after - before) / 2e-6, J[:, k], rtol=1e-5, atol=1e-4)


@BOTH
def test_an_error_of_the_depth_counts_as_far_as_it_shifts_the_pixel(kernel):
    forward, weighting = moved((0.0, 0.0, -2.0, 0.0, 0.0, 0.0)), SHARP._replace(depth_std_per_m=0.01)
    off = linearised(kernel, [(3.0, 0.0, 10.0)], [(520.0, 240.0)], forward, weighting)[0][0]
    shift_px = abs(500 * 3.3 / 9.0 - 500 * 2.7 / 7.0) / 2  # a metre, the depth's standard deviation, nearer and farther
    assert off == pytest.approx((520 - 320 - 500 * 3 / 8) / np.hypot(0.5, shift_px), rel=0.02)


@BOTH
def test_what_is_far_off_weighs_less_and_then_nothing(kernel):
    points, px = [(0.0, 0.0, 5.0)] * 3, [(320.5, 240.0), (322.0, 240.0), (325.0, 240.0)]
    residual, J, agrees = linearised(kernel, points, px, weighting=SHARP._replace(full=1.0, gate=9.0))
    np.testing.assert_allclose(residual[::2], (1.0, 2.0, 0.0))
    np.testing.assert_allclose(J[::2, 0], (200.0, 100.0, 0.0))
    assert agrees.tolist() == [1, 1, 0]


@BOTH
@pytest.mark.parametrize("z", [0.1, 0.0, -5.0])
def test_points_not_in_front_of_the_camera_do_not_count(kernel, z):
    residual, J, agrees = linearised(kernel, [(0.0, 0.0, z)], [(320.0, 240.0)])
    for written in (residual, J, agrees):
        assert not written.any()


@given(ROWS, arrays(float, (4, 4), elements=NUMBERS), st.floats(0, 1), st.floats(0.1, 50), st.floats(0.1, 50))
def test_any_points_have_the_same_bits(rows, this_T_key, depth_std_per_m, full, gate):
    points_m, px = rows[:, :3].copy(), rows[:, 3:].copy()
    weighting = Weighting(0.5, depth_std_per_m, full, gate)
    with np.errstate(all="ignore"):
        plain, compiled = (
            linearised(kernel, points_m, px, this_T_key, weighting)
            for kernel in (odometry_plain, reprojection_compiled)
        )
    np.testing.assert_array_equal(plain[2], compiled[2])
    for a, b in zip(plain[:2], compiled[:2], strict=True):
        np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
        np.testing.assert_array_equal(a.view(np.int64)[~np.isnan(a)], b.view(np.int64)[~np.isnan(b)])


@BOTH
def test_sizes_that_do_not_belong_together_are_refused(kernel):
    good = [np.ones((2, 3)), np.ones((2, 2)), np.eye(4)]
    kernel.linearise(PROJECTION, SHARP, *good)
    for at, array in enumerate([np.ones((1, 3)), np.ones((2, 3)), np.eye(3)]):
        with pytest.raises(ValueError, match="expected one number of points"):
            kernel.linearise(PROJECTION, SHARP, *good[:at], array, *good[at + 1 :])
