"""Patches aligned and points projected: known answers, and the same bits by both forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from roadperc_stream.geometry.rotations import rotation_from_vector
from roadperc_stream.kernels import odometry_plain as plain
from roadperc_stream.kernels.odometry_plain import Projection, Weighting

compiled = pytest.importorskip("roadperc_stream.kernels.odometry_compiled")
BOTH = pytest.mark.parametrize("kernel", [plain, compiled], ids=["plain", "compiled"])
UNSTRETCHED = np.eye(2)
IMAGES = arrays(np.uint8, st.tuples(st.integers(1, 20), st.integers(1, 20)))
NUMBERS = st.floats(-30, 30) | st.floats()


def waves(height, width, shift=(0.0, 0.0), offset=0.0):
    """Grey levels that do not repeat within a patch, moved right and down by a shift."""
    rows, columns = np.mgrid[:height, :width].astype(float)
    x, y = columns - shift[0], rows - shift[1]
    levels = 100 + 50 * np.sin(0.7 * x + 0.2 * y) + 50 * np.cos(0.6 * y - 0.3 * x)
    return np.rint(levels + offset).astype(np.uint8)


def aligned(kernel, before, before_px, stretch, after, start, iterations=4):
    count = len(start)
    px = np.array(start, float)
    stretch = np.ascontiguousarray(np.broadcast_to(stretch, (count, 2, 2)))
    correlation = kernel.align_patches(before, np.array(before_px, float), stretch, after, px, iterations)
    return px, correlation


def assert_same_bits(expected, found):
    for a, b in zip(expected, found, strict=True):
        np.testing.assert_array_equal(a.view(np.int64)[~np.isnan(a)], b.view(np.int64)[~np.isnan(b)])
        np.testing.assert_array_equal(np.isnan(a), np.isnan(b))


@BOTH
@pytest.mark.parametrize("offset", [0, 40], ids=["same brightness", "brighter"])
def test_a_shift_is_found_to_a_fraction_of_a_pixel(kernel, offset):
    centres, after = np.array([(15.0, 15.0), (20.5, 17.25), (25.0, 24.0)]), waves(40, 40, (0.7, -0.4), offset)
    px, correlation = aligned(kernel, waves(40, 40), centres, UNSTRETCHED, after, centres, 8)
    np.testing.assert_allclose(px - centres, [(0.7, -0.4)] * 3, atol=0.03)
    assert (correlation > 0.999).all()


@BOTH
def test_a_stretched_picture_is_found(kernel):
    rows, columns = np.mgrid[:60, :60]
    half = waves(60, 60)[rows // 2 + 15, columns // 2 + 15]  # pixel (30 + 2 a, 30 + 2 b) shows (30 + a, 30 + b)
    px, correlation = aligned(kernel, waves(60, 60), [(30.0, 30.0)], 2 * UNSTRETCHED, half, [(30.0, 30.0)], 8)
    np.testing.assert_allclose(px, [(30.5, 30.5)], atol=0.6)
    assert correlation[0] > 0.98


@BOTH
def test_other_pictures_and_patches_without_texture_do_not_correlate(kernel):
    noise = np.random.default_rng(1).integers(0, 255, (40, 40), np.uint8)
    assert aligned(kernel, waves(40, 40), [(20.0, 20.0)], UNSTRETCHED, noise, [(20.0, 20.0)])[1][0] < 0.5
    flat = np.full((30, 30), 80, np.uint8)
    px, correlation = aligned(kernel, flat, [(15.0, 15.0)], UNSTRETCHED, flat, [(14.0, 15.5)])
    np.testing.assert_array_equal(px, [(14.0, 15.5)])
    assert correlation[0] == 0


@settings(max_examples=50)
@given(IMAGES, IMAGES, arrays(float, st.tuples(st.integers(0, 3), st.just(8)), elements=NUMBERS), st.integers(0, 4))
def test_any_patches_have_the_same_bits(before, after, numbers, iterations):
    asked = before, numbers[:, :2], numbers[:, 2:6].reshape(-1, 2, 2), after, numbers[:, 6:], iterations
    with np.errstate(all="ignore"):
        expected, found = (aligned(kernel, *asked) for kernel in (plain, compiled))
    assert_same_bits(expected, found)


@given(st.integers(0, 2**32 - 1))
def test_patches_inside_and_at_the_edges_of_an_image_have_the_same_bits(seed):
    rng = np.random.default_rng(seed)
    before, after = rng.integers(0, 256, (2, 40, 50), np.uint8)
    px, start = rng.uniform(-3, (53, 43), (2, 30, 2))
    px[::5], start[::3] = np.rint(px[::5]), np.rint(start[::3])
    stretch = UNSTRETCHED + rng.normal(0.0, rng.choice((0.0, 0.05, 0.8)), (30, 2, 2))
    assert_same_bits(*(aligned(kernel, before, px, stretch, after, start) for kernel in (plain, compiled)))


def test_arrays_of_other_sizes_are_refused():
    image, one, two = np.zeros((9, 9), np.uint8), np.zeros((1, 2)), np.zeros((2, 2))
    good = (image, two, np.zeros((2, 2, 2)), image, two.copy(), 4)
    compiled.align_patches(*good)
    bad = {0: np.zeros((0, 9), np.uint8), 1: one, 2: np.zeros((2, 2, 3)), 3: np.zeros((9, 0), np.uint8), 4: one}
    for at, array in bad.items():
        with pytest.raises(ValueError, match="expected equally many of each"):
            compiled.align_patches(*good[:at], array, *good[at + 1 :])
    good = [np.ones((2, 3)), np.ones((2, 2)), np.eye(4)]
    compiled.linearise(PROJECTION, SHARP, *good)
    for at, array in enumerate([np.ones((1, 3)), np.ones((2, 3)), np.eye(3)]):
        with pytest.raises(ValueError, match="expected equally many points"):
            compiled.linearise(PROJECTION, SHARP, *good[:at], array, *good[at + 1 :])


PROJECTION = Projection(500.0, 400.0, 320.0, 240.0)
SHARP = Weighting(std_px=0.5, depth_std_per_m=0.0, full=1e9, gate=1e9)
STANDING = np.eye(4)
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
def test_the_depths_error_counts_by_the_pixel_shift_that_it_causes(kernel):
    forward, weighting = moved((0.0, 0.0, -2.0, 0.0, 0.0, 0.0)), SHARP._replace(depth_std_per_m=0.01)
    off = linearised(kernel, [(3.0, 0.0, 10.0)], [(520.0, 240.0)], forward, weighting)[0][0]
    shift_px = abs(500 * 3.3 / 9.0 - 500 * 2.7 / 7.0) / 2  # for one standard deviation, a metre, to either side
    assert off == pytest.approx((520 - 320 - 500 * 3 / 8) / np.hypot(0.5, shift_px), rel=0.02)


@BOTH
def test_large_errors_have_less_weight_and_the_largest_none(kernel):
    points, px = [(0.0, 0.0, 5.0)] * 3, [(320.5, 240.0), (322.0, 240.0), (325.0, 240.0)]
    residual, J, agrees = linearised(kernel, points, px, weighting=SHARP._replace(full=1.0, gate=9.0))
    np.testing.assert_allclose(residual[::2], (1.0, 2.0, 0.0))
    np.testing.assert_allclose(J[::2, 0], (200.0, 100.0, 0.0))
    assert agrees.tolist() == [1, 1, 0]


@BOTH
def test_points_not_in_front_of_the_camera_do_not_count(kernel):
    points = [(0.0, 0.0, z) for z in (0.1, 0.0, -5.0)]
    assert not any(written.any() for written in linearised(kernel, points, [(320.0, 240.0)] * 3))


@given(ROWS, arrays(float, (4, 4), elements=NUMBERS), st.floats(0, 1), st.floats(0.1, 50), st.floats(0.1, 50))
def test_any_points_have_the_same_bits(rows, this_T_key, depth_std_per_m, full, gate):
    points_m, px = rows[:, :3].copy(), rows[:, 3:].copy()
    weighting = Weighting(0.5, depth_std_per_m, full, gate)
    with np.errstate(all="ignore"):
        expected, found = (linearised(kernel, points_m, px, this_T_key, weighting) for kernel in (plain, compiled))
    np.testing.assert_array_equal(expected[2], found[2])
    assert_same_bits(expected[:2], found[:2])
