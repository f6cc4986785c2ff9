"""Errors of disparities compiled and by numpy: known answers, and the same bits of any numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from roadperc_stream.chain.kernels import stereo_plain as plain
from roadperc_stream.chain.kernels.stereo_plain import DisparityLimits

compiled = pytest.importorskip("roadperc_stream.chain.kernels.stereo_compiled")
BOTH = pytest.mark.parametrize("kernel", [plain, compiled], ids=["plain", "compiled"])
DEPTHS = st.one_of(
    st.integers(-2, 200).map(lambda number: number / 4),
    st.floats(width=32),
    st.sampled_from([np.nan, np.inf, 60.0]),
)
D1 = DisparityLimits(50.0, 60.0, 3.0, 0.05)
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
def test_both_ways_have_the_same_bits(data, shape, max_depth_m, bad_px, bad_share):
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


@BOTH
def test_views_are_taken_and_other_sizes_are_refused(kernel):
    depth_m = np.random.default_rng(0).uniform(1, 30, (8, 40)).astype(np.float32)[:, ::2]
    error_px, relative, counted, bad = kernel.disparity_errors(depth_m, depth_m, depth_m > 0, D1)
    assert (error_px.tolist(), relative.tolist(), counted, bad) == ([0.0] * 160, [0.0] * 160, 160, 0)
    with pytest.raises(ValueError, match="expected one size"):
        kernel.disparity_errors(depth_m, depth_m[1:], depth_m > 0, D1)
