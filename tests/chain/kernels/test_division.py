"""Regions where the depth jumps: the compiled union-find against OpenCV's and numpy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.kernels import objects_plain

JUMPS = np.array((0.02, 0.04, 0.08), np.float32)


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 12), st.floats(0, 1), st.integers(1, 3))
def test_compiled_regions_are_the_same(seed, height, width, share, ways):
    compiled = pytest.importorskip("roadperc_stream.chain.kernels.objects_compiled")
    rng = np.random.default_rng(seed)
    of_class = (rng.random((height, width)) < share).astype(np.uint8)
    depths = np.append(np.arange(0.0, 0.2, 0.013), np.nan).astype(np.float32)
    log_depth = rng.choice(depths, (height, width))
    asked = log_depth, of_class, JUMPS[:ways]
    for found, expected in zip(compiled.divided(*asked), objects_plain.divided(*asked), strict=True):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)


def test_regions_of_a_staircase():
    log_depth = np.float32([[0.0, 0.01, 0.04, 1.0, 1.07, 9.0]])
    for kernel in (objects_plain, pytest.importorskip("roadperc_stream.chain.kernels.objects_compiled")):
        labels, names, ways, bounds, pixels = kernel.divided(log_depth, np.uint8([[1, 1, 1, 1, 1, 0]]), JUMPS)
        assert labels.tolist() == [[1, 1, 2, 3, 4, 0]]
        assert names.tolist() == [[0, 1, 2, 3, 4], [0, 5, 5, 0, 0], [0, 0, 0, 6, 6]]
        assert (ways.tolist(), pixels.tolist()) == ([0, 0, 0, 0, 1, 2], [2, 1, 1, 1, 3, 2])
        assert bounds[[0, 2]].tolist() == [[0, 2, 3, 4, 0, 3], [2, 3, 4, 5, 3, 5]]


@pytest.mark.parametrize("way", ["plain", "compiled"])
def test_what_does_not_fit_is_refused(way):
    kernel = pytest.importorskip(f"roadperc_stream.chain.kernels.objects_{way}")
    for depths, pixels, jumps in (((2, 3), (3, 2), 3), ((0, 3), (0, 3), 3), ((2, 3), (2, 3), 0)):
        with pytest.raises(ValueError, match=f"{jumps} jumps"):
            kernel.divided(np.zeros(depths, np.float32), np.zeros(pixels, np.uint8), JUMPS[:jumps])
