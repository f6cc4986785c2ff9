"""The place of each cell's median: known answers, and the compiled ones against numpy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.kernels import surface_plain

compiled = pytest.importorskip("roadperc_stream.chain.kernels.surface_compiled")
BOTH = pytest.mark.parametrize("kernel", [surface_plain, compiled], ids=["plain", "compiled"])


def cells(*numbers):
    return np.array(numbers, np.int32)


def values(*numbers):
    return np.array(numbers, np.float32)


@BOTH
def test_the_middle_one_and_the_lower_of_two(kernel):
    places, counts = kernel.median_places(cells(3, 0, 3, 3, 0), values(5.0, 2.0, -1.0, 0.5, 1.0), 5)
    np.testing.assert_array_equal(places, [4, 3])
    np.testing.assert_array_equal(counts, [2, 3])


@BOTH
def test_of_equal_values_the_first_is_the_smaller(kernel):
    places, _ = kernel.median_places(cells(0, 0, 0, 0), values(0.0, -0.0, 0.0, -0.0), 1)
    np.testing.assert_array_equal(places, [1])


@given(st.integers(0, 2**32 - 1), st.integers(0, 200), st.integers(1, 12), st.integers(1, 100))
def test_compiled_places_are_the_same(seed, number, count, levels):
    rng = np.random.default_rng(seed)
    cell = rng.integers(0, count, number).astype(np.int32)
    heights = (rng.integers(-levels, levels, number) / 7).astype(np.float32)
    heights[rng.random(number) < 0.05] = np.inf
    expected, found = (kernel.median_places(cell, heights, count) for kernel in (surface_plain, compiled))
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_array_equal(one, other)
    assert expected[1].sum() == number


@BOTH
def test_what_does_not_fit_is_refused(kernel):
    for wrong in (cells(0, 1), cells(0, 1, 2), cells(-1, 0, 1)):
        with pytest.raises(ValueError, match="3 values in"):
            kernel.median_places(wrong, values(1, 2, 3), 2)
