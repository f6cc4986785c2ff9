"""Cells that an image shows to be drivable: known answers, and the compiled marks against numpy's."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.kernels import occupancy_plain
from roadperc_stream.chain.kernels.occupancy_plain import Middles
from roadperc_stream.chain.kernels.odometry_plain import Projection
from roadperc_stream.geometry import inverse, level_mounting

compiled = pytest.importorskip("roadperc_stream.chain.kernels.occupancy_compiled")
BOTH = pytest.mark.parametrize("kernel", [occupancy_plain, compiled], ids=["plain", "compiled"])
PROJECTION = Projection(10.0, 10.0, 7.5, 2.0)
SIZE = 12, 16
CAMERA_T_EGO = inverse(level_mounting(1.0))
X, Y = np.array([-1.0, 2.0, 4.0]), np.array([0.0, 1.0])
"""Seen at row 7 and 4.5, rounded to 4, and columns 7.5, rounded to 8, and 2.5 or 5: the first lies behind."""
FLAT = np.zeros((2, 3))


def marked(kernel, drivable, depth=None, tolerance=0.1, slack_m=0.2, z=FLAT):
    return kernel.mark_visible(PROJECTION, CAMERA_T_EGO, Middles(X, Y, z), drivable, depth, (tolerance, slack_m))


@BOTH
def test_cells_are_visible_where_their_pixels_are_drivable(kernel):
    drivable = np.zeros(SIZE, np.uint8)
    drivable[6:9, 7:10] = 1
    np.testing.assert_array_equal(marked(kernel, drivable), [[0, 1, 0], [0, 0, 0]])
    np.testing.assert_array_equal(marked(kernel, np.ones(SIZE, np.uint8)), [[0, 1, 1], [0, 1, 1]])


@BOTH
def test_the_road_is_hidden_by_what_is_nearer_and_where_nothing_is_known(kernel):
    depth = np.full(SIZE, 2.0, np.float32)
    depth[4] = np.nan
    np.testing.assert_array_equal(marked(kernel, np.ones(SIZE, np.uint8), depth), [[0, 1, 0], [0, 1, 0]])
    depth[7] = 1.59  # 2 m less a tenth and 0.2 m
    np.testing.assert_array_equal(marked(kernel, np.ones(SIZE, np.uint8), depth), np.zeros((2, 3)))


@BOTH
def test_single_pixels_do_not_count(kernel):
    hole, dot = np.ones(SIZE, np.uint8), np.zeros(SIZE, np.uint8)
    hole[7, 8], dot[7, 8] = 0, 1
    assert marked(kernel, hole)[0, 1]
    assert not marked(kernel, dot)[0, 1]


@given(st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from([(1, 1), (1, 9), (9, 1), SIZE]))
def test_compiled_marks_are_the_same(seed, has_depth, size):
    rng = np.random.default_rng(seed)
    drivable, depth = rng.integers(0, 2, size).astype(np.uint8), rng.uniform(1, 5, size).astype(np.float32)
    depth[rng.random(size) < 0.2] = np.nan
    z = rng.normal(0.0, 1.0, FLAT.shape)
    z[rng.random(z.shape) < 0.1] = np.nan
    found = [marked(k, drivable, depth if has_depth else None, z=z) for k in (occupancy_plain, compiled)]
    np.testing.assert_array_equal(*found)


@BOTH
@given(st.integers(0, 2**32 - 1))
def test_most_of_nine_pixels_are_their_median(kernel, seed):
    drivable = np.random.default_rng(seed).integers(0, 2, SIZE).astype(np.uint8)
    x, y = 10.0 / np.arange(1.0, 10.0), (7.5 - np.arange(16.0)) / 10
    visible, expected = np.empty((16, 9), np.uint8), cv2.medianBlur(drivable, 3)
    for column in range(9):  # row 3 + column of the image: each cell in its own column of it
        at = x[column : column + 1]
        middles = Middles(at, y * at, np.zeros((16, 1)))
        visible[:, column : column + 1] = kernel.mark_visible(
            PROJECTION, CAMERA_T_EGO, middles, drivable, None, (0.0, 0.0)
        )
    np.testing.assert_array_equal(visible, expected[3:12].T)


@BOTH
def test_what_does_not_fit_is_refused(kernel):
    drivable, depth = np.ones(SIZE, np.uint8), np.ones(SIZE, np.float32)
    with pytest.raises(ValueError, match="cells"):
        marked(kernel, drivable, depth[1:])
    with pytest.raises(ValueError, match="cells"):
        marked(kernel, drivable, depth, z=np.zeros((3, 2)))
