"""Points of depth pixels: known answers, and the compiled bits against numpy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.core.kernels import ray_points_plain

compiled = pytest.importorskip("roadperc_stream.core.kernels.ray_points_compiled")
BOTH = pytest.mark.parametrize("kernel", [ray_points_plain, compiled], ids=["plain", "compiled"])


def points(kernel, depth, column, row, start):
    found = np.full((3, *depth.shape), 7.0, np.float32)
    kernel.points_along_rays(depth, column, row, start, found)
    return found


@BOTH
def test_a_point_lies_at_its_depth_along_the_ray(kernel):
    column, row = np.array([[1, 2], [0, 0], [0, 0]], np.float32), np.array([[0], [3], [1]], np.float32)
    found = points(kernel, np.array([[2.0, np.nan]], np.float32), column, row, np.array([0, 1, -1], np.float32))
    np.testing.assert_array_equal(found[:, 0, 0], [2, 7, 1])
    assert np.isnan(found[:, 0, 1]).all()


@given(st.integers(0, 2**32 - 1), st.integers(0, 9), st.integers(0, 40), st.integers(1, 3))
def test_compiled_points_have_the_same_bits(seed, height, width, step):
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0, 80, (height, width * step)).astype(np.float32)[:, ::step]
    for wild in (np.nan, np.inf, -np.inf, 3e38):
        depth[rng.random(depth.shape) < 0.04] = wild
    column, row, start = (rng.normal(size=size).astype(np.float32) for size in ((3, width), (3, height), 3))
    expected, found = (points(kernel, depth, column, row, start) for kernel in (ray_points_plain, compiled))
    np.testing.assert_array_equal(found, expected)


@BOTH
def test_what_does_not_fit_is_refused(kernel):
    depth, column, row, start = (np.zeros(size, np.float32) for size in ((2, 4), (3, 4), (3, 2), 3))
    for wrong in (
        (depth, column[:, 1:].copy(), row, start),
        (depth, column, row[:2], start),
        (depth, column, row, start[:2]),
    ):
        with pytest.raises(ValueError, match="of 2x4 depths"):
            points(kernel, *wrong)
