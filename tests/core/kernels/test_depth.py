"""Depths compiled and by numpy: known answers, and the same bits of any number."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from roadperc_stream.core.kernels import depth_plain

depth_compiled = pytest.importorskip("roadperc_stream.core.kernels.depth_compiled")
BOTH = pytest.mark.parametrize("depth", [depth_plain, depth_compiled], ids=["plain", "compiled"])
HALVES = (np.arange(1 << 17, dtype=np.float64) / 2000).astype(np.float32)
"""What lies between two millimetres, or next to it."""


def metres(depth, depth_mm):
    depth_m = np.zeros(depth_mm.shape, np.float32)
    depth.metres_of_mm(depth_mm, depth_m)
    return depth_m


def millimetres(depth, depth_m):
    depth_mm = np.full(depth_m.shape, 7, np.uint16)
    depth.mm_of_metres(depth_m, depth_mm)
    return depth_mm


@BOTH
def test_known_metres(depth):
    found = metres(depth, np.array([[0, 1, 1234, 65535]], np.uint16))
    np.testing.assert_allclose(found, [[np.nan, 0.001, 1.234, 65.535]], rtol=2e-7)


@BOTH
def test_known_millimetres(depth):
    far = np.array([[65.535, 65.5351, 3e38, np.inf], [np.nan, 0, -0.0, -np.inf], [1e-45, 0.0005, 0.0015, 0.0025]])
    expected = [[65535, 65535, 65535, 65535], [0, 0, 0, 0], [1, 1, 2, 2]]
    np.testing.assert_array_equal(millimetres(depth, far.astype(np.float32)), expected)


def test_metres_of_every_millimetre_have_the_same_bits():
    depth_mm = np.arange(1 << 16, dtype=np.uint16).reshape(256, -1)
    plain, compiled = metres(depth_plain, depth_mm), metres(depth_compiled, depth_mm)
    assert plain.tobytes() == compiled.tobytes()


@example(np.stack([HALVES, np.nextafter(HALVES, 0), np.nextafter(HALVES, 99)]))
@given(arrays(np.float32, st.tuples(st.integers(0, 4), st.integers(0, 40)), elements=st.floats(width=32)))
def test_millimetres_of_any_number_are_the_same(depth_m):
    np.testing.assert_array_equal(millimetres(depth_compiled, depth_m), millimetres(depth_plain, depth_m))


@BOTH
@pytest.mark.parametrize("shape", [(2, 2), (3, 3), (1, 6), (0, 3)])
def test_another_size_is_refused(depth, shape):
    with pytest.raises(ValueError, match="expected one size"):
        depth.metres_of_mm(np.zeros((2, 3), np.uint16), np.zeros(shape, np.float32))
    with pytest.raises(ValueError, match="expected one size"):
        depth.mm_of_metres(np.zeros((2, 3), np.float32), np.zeros(shape, np.uint16))
