"""Disparities refined, doubled, hidden and wrong: known answers, and both ways to the same bits."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from roadperc_stream.chain.kernels import stereo_plain as plain
from roadperc_stream.chain.kernels.stereo_plain import DisparityLimits

compiled = pytest.importorskip("roadperc_stream.chain.kernels.stereo_compiled")
BOTH = pytest.mark.parametrize("kernel", [plain, compiled], ids=["plain", "compiled"])


PICTURES = array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=14)
SIZES = st.sampled_from([1, 3, 5, 7, 11])


def ramp(offset):
    """Greys that rise by 8 from column to column."""
    return np.tile((8 * np.arange(24) + offset).astype(np.uint8), (12, 1))


@BOTH
def test_where_the_slope_is_the_same_everywhere_a_difference_is_brightness(kernel):
    sixteenths = np.full((12, 24), 32, np.int16)
    sixteenths[3, 12] = -16
    found = kernel.refined_disparities(sixteenths, ramp(2), ramp(0), 5)
    assert np.isnan(found[3, 12])
    np.testing.assert_array_equal(found[8, 8:16], 2.0)


@BOTH
def test_texture_is_moved_to_where_it_fits(kernel):
    rng = np.random.default_rng(0)
    smooth = np.convolve(rng.uniform(0, 255, 80), np.hanning(9) / np.hanning(9).sum(), "same")
    columns = np.arange(60)
    right = np.tile(np.rint(smooth[columns + 5]).astype(np.uint8), (20, 1))
    left = np.tile(np.rint(np.interp(columns + 5 - 3.3, np.arange(80), smooth)).astype(np.uint8), (20, 1))
    found = kernel.refined_disparities(np.full((20, 60), 48, np.int16), left, right, 7)
    assert np.median(np.abs(found[:, 8:52] - 3.3)) < 0.03


@given(st.data(), PICTURES, SIZES)
def test_refined_disparities_have_the_same_bits(data, shape, size):
    left, right = (data.draw(arrays(np.uint8, shape)) for _ in range(2))
    sixteenths = data.draw(arrays(np.int16, shape, elements=st.integers(-16, 400)))
    ways = (way.refined_disparities(sixteenths, left, right, size) for way in (compiled, plain))
    np.testing.assert_array_equal(*ways, strict=True)


@pytest.mark.parametrize("size", [7, 99])
def test_both_ways_have_the_same_bits_at_the_largest_differences(size):
    rng = np.random.default_rng(size)
    left, right = (255 * rng.integers(0, 2, (120, 160)).astype(np.uint8) for _ in range(2))
    sixteenths = rng.integers(-16, 300, (120, 200)).astype(np.int16)[:, 40:]
    ways = (way.refined_disparities(sixteenths, left, right, size) for way in (compiled, plain))
    np.testing.assert_array_equal(*ways, strict=True)


def test_a_refinement_refuses_other_sizes():
    image, disparities = np.zeros((3, 4), np.uint8), np.zeros((3, 4), np.int16)
    for pair in ((image[1:], image), (image, image[:, 1:])):
        with pytest.raises(ValueError, match="expected one size"):
            compiled.refined_disparities(disparities, *pair, 3)
    with pytest.raises(ValueError, match="expected an odd number"):
        compiled.refined_disparities(disparities, image, image, 4)


NUMBERS = st.one_of(
    st.floats(0.0, 96.0, width=32), st.integers(0, 6).map(lambda n: n / 4), st.just(np.nan), st.floats(width=32)
)
HALVES = array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=9)


@BOTH
def test_between_pixels_of_one_thing_and_of_two(kernel):
    half = np.array([[1.0, 1.25, 4.0, np.nan]], np.float32)
    row = [2.0, 2.125, 2.375, 2.5, 8.0, 8.0, np.nan, np.nan]
    np.testing.assert_array_equal(kernel.doubled(half, 1.0), [row, row])
    np.testing.assert_array_equal(kernel.doubled(half.T, 1.0), np.transpose([row, row]))


@BOTH
def test_a_slope_is_interpolated_as_opencv_has_it(kernel):
    half = np.random.default_rng(0).uniform(10, 20, (31, 47)).astype(np.float32)
    expected = cv2.resize(2 * half, (94, 62), interpolation=cv2.INTER_LINEAR)
    np.testing.assert_allclose(kernel.doubled(half, 100.0), expected, rtol=3e-7)


@given(arrays(np.float32, HALVES, elements=NUMBERS), st.sampled_from([0.5, 1.0, 1e9]))
def test_doubled_disparities_have_the_same_bits(half, step_px):
    np.testing.assert_array_equal(compiled.doubled(half, step_px), plain.doubled(half, step_px), strict=True)


DISPARITIES = st.one_of(
    st.integers(-2, 40).map(lambda number: number / 4),
    st.floats(-1.0, 12.0, width=32),
    st.sampled_from([np.nan, np.inf]),
)


@given(arrays(np.float32, st.tuples(st.integers(0, 4), st.integers(0, 12)), elements=DISPARITIES), st.floats(0.0, 2.0))
def test_both_ways_see_the_same(disparity_px, occlusion_px):
    expected = plain.seen_by_both(disparity_px, occlusion_px)
    found = compiled.seen_by_both(disparity_px, occlusion_px)
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected)


DEPTHS = st.one_of(
    st.integers(-2, 200).map(lambda number: number / 4),
    st.floats(width=32),
    st.sampled_from([np.nan, np.inf, 60.0]),
)
SHAPES = array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=12)


@BOTH
def test_a_row_worked_out_by_hand(kernel):
    """f b = 50: 5 px at 10 m; 4, 2 and 10 px estimated, one unknown, one of nothing; what is far or hidden is left."""
    estimated_m = np.array([[12.5, 25.0, 5.0, np.nan, 0.0, 10.0, 10.0]], np.float32)
    true_m = np.array([[10.0, 10.0, 10.0, 10.0, 10.0, 60.0, 10.0]], np.float32)
    seen = np.array([[True] * 6 + [False]])
    error_px, relative, counted, bad = kernel.disparity_errors(
        estimated_m, true_m, seen, DisparityLimits(50.0, 60.0, 1.0, 0.5)
    )
    np.testing.assert_array_equal(error_px, np.float32([1, 3, 5]))
    np.testing.assert_array_equal(relative, np.float32([0.25, 1.5, 0.5]))
    assert (counted, bad) == (5, 2)


@given(st.data(), SHAPES, st.floats(0.0, 80.0, width=32), st.floats(0.0, 3.0, width=32), st.floats(0, 1, width=32))
def test_errors_have_the_same_bits(data, shape, max_depth_m, bad_px, bad_share):
    estimated_m, true_m = (data.draw(arrays(np.float32, shape, elements=DEPTHS)) for _ in range(2))
    seen = data.draw(arrays(np.bool_, shape))
    ways = (
        way.disparity_errors(estimated_m, true_m, seen, DisparityLimits(50.0, max_depth_m, bad_px, bad_share))
        for way in (plain, compiled)
    )
    (error_px, relative, *counts), (other_px, other_relative, *other_counts) = ways
    np.testing.assert_array_equal(error_px, other_px, strict=True)
    np.testing.assert_array_equal(relative, other_relative, strict=True)
    assert counts == other_counts


def test_views_are_taken_and_other_sizes_are_refused():
    depth_m = np.random.default_rng(0).uniform(1, 30, (8, 40)).astype(np.float32)[:, ::2]
    limits = DisparityLimits(50.0, 60.0, 3.0, 0.05)
    assert compiled.doubled(depth_m, 1.0).tobytes() == plain.doubled(depth_m, 1.0).tobytes()
    assert compiled.seen_by_both(depth_m, 1.0).tobytes() == plain.seen_by_both(depth_m, 1.0).tobytes()
    error_px, relative, counted, bad = compiled.disparity_errors(depth_m, depth_m, depth_m > 0, limits)
    assert (error_px.tolist(), relative.tolist(), counted, bad) == ([0.0] * 160, [0.0] * 160, 160, 0)
    with pytest.raises(ValueError, match="expected one size"):
        compiled.disparity_errors(depth_m, depth_m[1:], depth_m > 0, limits)
