"""Points of a strip of road: known answers, and the compiled bits against numpy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.core.kernels import strip_points_plain
from roadperc_stream.core.kernels.ray_points import Rays
from roadperc_stream.core.kernels.strip_points import Strip

compiled = pytest.importorskip("roadperc_stream.core.kernels.strip_points_compiled")
BOTH = pytest.mark.parametrize("kernel", [strip_points_plain, compiled], ids=["plain", "compiled"])
STRIP = Strip(3.0, 2.0, 0.5, 8)
CLIMBING = np.array([-0.5, 0.25, 0.5], np.float32)
"""The plane z = 0.5 + x / 2 - y / 4."""


@BOTH
def test_points_on_the_strip_are_given_with_their_cells(kernel):
    x, y, z = [0.0, 2.9, 1.2, 3.0, 1.0, -0.1, 1.0], [0.0, 1.9, -2.0, 0.0, -1.9, 0.0, 0.0], np.ones(7)
    rays = Rays(np.array([x, y, z], np.float32), np.zeros((3, 1), np.float32), np.zeros(3, np.float32))
    among = np.array([[1, 1, 1, 1, 1, 1, 0]], np.uint8)
    points, cells = kernel.points_on_strip(STRIP, np.ones((1, 7), np.float32), rays, CLIMBING, among)
    np.testing.assert_allclose(points, [[0, 2.9, 1], [0, 1.9, -1.9], [0.5, -0.475, -0.475]], atol=1e-6)
    np.testing.assert_array_equal(cells, [4, 5 * 8 + 7, 2 * 8])


@given(st.integers(0, 2**32 - 1), st.integers(0, 9), st.integers(0, 30))
def test_compiled_points_have_the_same_bits(seed, height, width):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0, 4, (height, 2 * width)).astype(np.float32)[:, ::2]
    for wild in (np.nan, np.inf, 3e38):
        depth[rng.random(depth.shape) < 0.04] = wild
    rays = Rays(*(rng.uniform(-1, 1, shape).astype(np.float32) for shape in ((3, width), (3, height), 3)))
    among = rng.integers(0, 2, (height, 2 * width)).astype(np.uint8)[:, ::2]
    expected, found = (
        kernel.points_on_strip(STRIP, depth, rays, CLIMBING, among) for kernel in (strip_points_plain, compiled)
    )
    for ours, theirs in zip(found, expected, strict=True):
        assert (ours.shape, ours.dtype, ours.tobytes()) == (theirs.shape, theirs.dtype, theirs.tobytes())


@BOTH
def test_what_does_not_fit_is_refused(kernel):
    depth, marks = np.ones((2, 3), np.float32), np.ones((2, 3), np.uint8)
    rays = Rays(*(np.zeros(shape, np.float32) for shape in ((3, 3), (3, 2), 3)))
    for wrong in ((depth[1:], marks[1:]), (depth, marks[1:])):
        with pytest.raises(ValueError, match="other sizes"):
            kernel.points_on_strip(STRIP, wrong[0], rays, CLIMBING, wrong[1])
