"""Regions divided at depth jumps: a known answer, and the same bits by both forms."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.kernels.forms import SEEDS, assert_same_bits, both

JUMPS = np.array((0.02, 0.04, 0.08), np.float32)


@both("objects")
def test_regions_of_a_staircase(kernel):
    log_depth = np.float32([[0.0, 0.01, 0.04, 1.0, 1.07, 9.0]])
    labels, names, ways, bounds, pixels = kernel.divided(log_depth, np.uint8([[1, 1, 1, 1, 1, 0]]), JUMPS)
    assert labels.tolist() == [[1, 1, 2, 3, 4, 0]]
    assert names.tolist() == [[0, 1, 2, 3, 4], [0, 5, 5, 0, 0], [0, 0, 0, 6, 6]]
    assert (ways.tolist(), pixels.tolist()) == ([0, 0, 0, 0, 1, 2], [2, 1, 1, 1, 3, 2])
    assert bounds[[0, 2]].tolist() == [[0, 2, 3, 4, 0, 3], [2, 3, 4, 5, 3, 5]]


@given(SEEDS, st.integers(1, 12), st.integers(1, 12), st.floats(0, 1), st.integers(1, 3))
def test_both_forms_divide_alike(seed, height, width, share, ways):
    rng = np.random.default_rng(seed)
    of_class = (rng.random((height, width)) < share).astype(np.uint8)
    depths = np.append(np.arange(0.0, 0.2, 0.013), np.nan).astype(np.float32)
    assert_same_bits("objects", "divided", rng.choice(depths, (height, width)), of_class, JUMPS[:ways])
