"""Disparities refined, doubled, hidden and wrong: known answers, and the same bits by both forms."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.kernels.stereo_plain import DisparityLimits
from tests.kernels.forms import SEEDS, SHAPES, assert_same_bits, both, wild


def ramp(offset):
    """Greys that rise by 8 from column to column."""
    return np.tile((8 * np.arange(24) + offset).astype(np.uint8), (12, 1))


@both("stereo")
def test_with_one_slope_everywhere_a_difference_is_brightness(kernel):
    sixteenths = np.full((12, 24), 32, np.int16)
    sixteenths[3, 12] = -16
    found = kernel.refined_disparities(sixteenths, ramp(2), ramp(0), 5)
    assert np.isnan(found[3, 12])
    np.testing.assert_array_equal(found[8, 8:16], 2.0)


@both("stereo")
def test_refinement_moves_a_texture_to_its_place(kernel):
    rng = np.random.default_rng(0)
    smooth = np.convolve(rng.uniform(0, 255, 80), np.hanning(9) / np.hanning(9).sum(), "same")
    columns = np.arange(60)
    right = np.tile(np.rint(smooth[columns + 5]).astype(np.uint8), (20, 1))
    left = np.tile(np.rint(np.interp(columns + 5 - 3.3, np.arange(80), smooth)).astype(np.uint8), (20, 1))
    found = kernel.refined_disparities(np.full((20, 60), 48, np.int16), left, right, 7)
    assert np.median(np.abs(found[:, 8:52] - 3.3)) < 0.03


@both("stereo")
def test_doubled_disparities_within_one_object_and_between_two(kernel):
    half = np.array([[1.0, 1.25, 4.0, np.nan]], np.float32)
    row = [2.0, 2.125, 2.375, 2.5, 8.0, 8.0, np.nan, np.nan]
    np.testing.assert_array_equal(kernel.doubled(half, 1.0), [row, row])
    np.testing.assert_array_equal(kernel.doubled(half.T, 1.0), np.transpose([row, row]))


@both("stereo")
def test_doubling_interpolates_as_opencv(kernel):
    half = np.random.default_rng(0).uniform(10, 20, (31, 47)).astype(np.float32)
    expected = cv2.resize(2 * half, (94, 62), interpolation=cv2.INTER_LINEAR)
    np.testing.assert_allclose(kernel.doubled(half, 100.0), expected, rtol=3e-7)


@both("stereo")
def test_errors_of_a_row_by_hand(kernel):
    """f b = 50: 5 px at 10 m; 4, 2 and 10 px estimated, two unknown; a far and a hidden pixel do not count."""
    estimated_m = np.array([[12.5, 25.0, 5.0, np.nan, 0.0, 10.0, 10.0]], np.float32)
    true_m = np.array([[10.0, 10.0, 10.0, 10.0, 10.0, 60.0, 10.0]], np.float32)
    limits, seen = DisparityLimits(50.0, 60.0, 1.0, 0.5), np.array([[True] * 6 + [False]])
    error_px, relative, counted, bad = kernel.disparity_errors(estimated_m, true_m, seen, limits)
    np.testing.assert_array_equal(error_px, np.float32([1, 3, 5]))
    np.testing.assert_array_equal(relative, np.float32([0.25, 1.5, 0.5]))
    assert (counted, bad) == (5, 2)


@given(SEEDS, SHAPES, st.sampled_from([1, 3, 5, 7, 11]))
def test_refined_disparities_have_the_same_bits(seed, shape, size):
    rng = np.random.default_rng(seed)
    left, right = rng.integers(0, 256, (2, *shape), np.uint8)
    assert_same_bits("stereo", "refined_disparities", rng.integers(-16, 400, shape, np.int16), left, right, size)


@pytest.mark.parametrize("size", [7, 99])
def test_refined_disparities_have_the_same_bits_at_the_largest_differences(size):
    rng = np.random.default_rng(size)
    left, right = (255 * rng.integers(0, 2, (120, 160)).astype(np.uint8) for _ in range(2))
    sixteenths = rng.integers(-16, 300, (120, 200), np.int16)[:, 40:]
    assert_same_bits("stereo", "refined_disparities", sixteenths, left, right, size)


@given(SEEDS, SHAPES, st.floats(0.0, 80.0, width=32), st.floats(0.0, 3.0, width=32), st.floats(0, 1, width=32))
def test_doubled_seen_and_wrong_disparities_have_the_same_bits(seed, shape, max_depth_m, bad_px, bad_share):
    rng = np.random.default_rng(seed)
    height, width = shape
    views = [wild(rng, (height, 2 * width), largest)[:, ::2] for largest in (96.0, 12.0, 90.0, 90.0)]
    assert_same_bits("stereo", "doubled", views[0], rng.choice((0.5, 1.0, 1e9)))
    assert_same_bits("stereo", "seen_by_both", views[1], bad_px)
    limits = DisparityLimits(50.0, max_depth_m, bad_px, bad_share)
    assert_same_bits("stereo", "disparity_errors", *views[2:], rng.random(shape) < 0.7, limits)
