"""Doubled disparities compiled and by numpy: known answers, OpenCV's interpolation, the same bits."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from roadperc_stream.chain.kernels import stereo_plain as plain

compiled = pytest.importorskip("roadperc_stream.chain.kernels.stereo_compiled")
BOTH = pytest.mark.parametrize("kernel", [plain, compiled], ids=["plain", "compiled"])
NUMBERS = st.one_of(
    st.floats(0.0, 96.0, width=32), st.integers(0, 6).map(lambda n: n / 4), st.just(np.nan), st.floats(width=32)
)
SHAPES = array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=9)


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


@given(arrays(np.float32, SHAPES, elements=NUMBERS), st.sampled_from([0.5, 1.0, 1e9]))
def test_both_ways_have_the_same_bits(half, step_px):
    np.testing.assert_array_equal(compiled.doubled(half, step_px), plain.doubled(half, step_px), strict=True)


def test_a_view_is_doubled_too():
    half = np.random.default_rng(0).uniform(1, 2, (8, 40)).astype(np.float32)[:, ::2]
    assert compiled.doubled(half, 1.0).tobytes() == plain.doubled(half, 1.0).tobytes()
