"""Refined disparities compiled and by numpy: a known answer, and the same bits of any images."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from roadperc_stream.chain.kernels import stereo_plain as plain

compiled = pytest.importorskip("roadperc_stream.chain.kernels.stereo_compiled")
BOTH = pytest.mark.parametrize("kernel", [plain, compiled], ids=["plain", "compiled"])
SHAPES = array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=14)
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


@given(st.data(), SHAPES, SIZES)
def test_both_ways_have_the_same_bits(data, shape, size):
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


@BOTH
def test_other_sizes_are_refused(kernel):
    image, disparities = np.zeros((3, 4), np.uint8), np.zeros((3, 4), np.int16)
    with pytest.raises(ValueError, match="expected one size"):
        kernel.refined_disparities(disparities, image[1:], image, 3)
    with pytest.raises(ValueError, match="expected one size"):
        kernel.refined_disparities(disparities, image, image[:, 1:], 3)
    with pytest.raises(ValueError, match="expected an odd number"):
        kernel.refined_disparities(disparities, image, image, 4)
