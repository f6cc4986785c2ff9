"""Points counted in cells, and the visible cells: known answers, and the same bits by both forms."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.geometry import inverse, mounting
from roadperc_stream.kernels import occupancy_plain as plain
from roadperc_stream.kernels.occupancy_plain import Cells, KnownPixels, Middles, Rays
from roadperc_stream.kernels.odometry_plain import Projection

compiled = pytest.importorskip("roadperc_stream.kernels.occupancy_compiled")
BOTH = pytest.mark.parametrize("kernel", [plain, compiled], ids=["plain", "compiled"])
CELLS = Cells(0.0, -2.0, 0.5, 0.25, 2.0)
SHAPE = 8, 6
LEVEL = np.zeros(3, np.float32)
OBSTACLE_TAGS = np.zeros(256, np.uint8)
OBSTACLE_TAGS[[7, 255]] = 1


def counted(kernel, depth, rays, abd, height, drivable, tags):
    free, occupied = np.zeros(SHAPE, np.int64), np.zeros(SHAPE, np.int64)
    kernel.count_points(CELLS, KnownPixels(depth, height, drivable, tags, OBSTACLE_TAGS), rays, abd, free, occupied)
    return free, occupied


def one_row(x, y, z=0.0):
    """Depths of 1 m, and rays to such points."""
    column = np.zeros((3, len(x)), np.float32)
    column[0], column[1], column[2] = x, y, z
    return np.ones((1, len(x)), np.float32), Rays(column, np.zeros((3, 1), np.float32), LEVEL)


def row(*numbers, kind=np.float32):
    return np.array([numbers], kind)


@BOTH
def test_points_lie_in_their_cells(kernel):
    points = one_row((0.1, 0.1, 2.9, 3.0, 0.1, -0.1, 1.2), (-2.0, -1.8, 1.9, 0.0, -2.1, 0.0, 0.0))
    free, occupied = counted(kernel, *points, LEVEL, None, np.ones((1, 7), np.uint8), np.zeros((1, 7), np.uint8))
    assert (free[0, 0], free[7, 5], free[4, 2], free.sum()) == (2, 1, 1, 4)
    assert not occupied.any()


@BOTH
@pytest.mark.parametrize("is_plane", [True, False])
def test_occupied_points_are_high_or_of_an_obstacle_and_not_above_the_limit(kernel, is_plane):
    height = row(0.25, 0.2, 0.2, 2.0, 2.1, 2.1, np.nan, np.nan)
    tags, drivable = row(0, 1, 7, 0, 0, 255, 7, 0, kind=np.uint8), row(1, 1, 0, 0, 0, 1, 1, 1, kind=np.uint8)
    points = one_row(np.zeros(8), np.zeros(8), height if is_plane else 9.0)
    free, occupied = counted(kernel, *points, LEVEL, None if is_plane else height, drivable, tags)
    assert (free[4, 0], occupied[4, 0]) == (3, 3)


@BOTH
def test_heights_are_over_the_plane(kernel):
    points = one_row((1.1, 1.1, 1.1), (1.6, 1.6, 1.6), (0.55, 0.65, 2.45))
    climbing = np.array([-0.5, 0.25, 0.4], np.float32)  # 0.55 m high at that place
    free, occupied = counted(kernel, *points, climbing, None, np.ones((1, 3), np.uint8), np.zeros((1, 3), np.uint8))
    assert (free[7, 2], occupied[7, 2], occupied.sum()) == (3, 1, 1)


@given(st.integers(0, 2**32 - 1), st.integers(0, 5), st.integers(0, 300), st.booleans())
def test_compiled_counts_are_the_same(seed, height, width, is_plane):
    rng = np.random.default_rng(seed)
    depth, heights = (rng.uniform(-4, 4, (height, width)).astype(np.float32) for _ in range(2))
    for numbers in (depth, heights):
        for wild in (np.nan, np.inf, -np.inf, 3e38):
            numbers[rng.random(numbers.shape) < 0.04] = wild
    column, parts, start = (rng.uniform(-1, 1, shape).astype(np.float32) for shape in ((3, width), (3, height), 3))
    if rng.random() < 0.3:
        depth, column, parts, start = (np.round(a) for a in (depth, column, parts, start))
    marks = rng.integers(0, 2, (2 * height, 2 * width)).astype(np.uint8)[::2, ::2]
    tags = rng.choice(np.array([0, 1, 7], np.uint8), (2 * height, 2 * width))[::2, ::2]
    road = rng.uniform(-1, 1, 3).astype(np.float32), None if is_plane else heights
    expected, found = (
        counted(kernel, depth, Rays(column, parts, start), *road, marks, tags) for kernel in (plain, compiled)
    )
    np.testing.assert_array_equal(found, expected)


def test_counts_refuse_other_sizes():
    depth, rays = one_row((0.0, 1.0, 2.0), (0.0, 1.0, 2.0))
    marks = np.zeros((1, 3), np.uint8)
    for depths, *others in (
        (depth, None, marks, marks[:, :2]),
        (depth, None, marks[:, :2], marks),
        (depth, depth[:, 1:], marks, marks),
        (depth[:, 1:], None, marks[:, 1:], marks[:, 1:]),
    ):
        with pytest.raises(ValueError, match="of the same size"):
            counted(compiled, depths, rays, LEVEL, *others)
    counts = np.zeros((2, 2), np.int64), np.zeros((2, 3), np.int64)
    with pytest.raises(ValueError, match="counts of"):
        compiled.count_points(CELLS, KnownPixels(depth, None, marks, marks, OBSTACLE_TAGS), rays, LEVEL, *counts)


PROJECTION = Projection(10.0, 10.0, 7.5, 2.0)
SIZE = 12, 16
CAMERA_T_EGO = inverse(mounting(z=1.0))
X, Y = np.array([-1.0, 2.0, 4.0]), np.array([0.0, 1.0])
"""Rows 7 and 4.5 (rounded to 4), columns 7.5 (rounded to 8), 2.5 and 5; the first x lies behind the camera."""
FLAT = np.zeros((2, 3))


def seen(kernel, drivable, depth=None, tolerance=0.1, slack_m=0.2, z=FLAT):
    return kernel.mark_visible(PROJECTION, CAMERA_T_EGO, Middles(X, Y, z), drivable, depth, (tolerance, slack_m))


@BOTH
def test_cells_are_visible_where_their_pixels_are_drivable(kernel):
    drivable = np.zeros(SIZE, np.uint8)
    drivable[6:9, 7:10] = 1
    np.testing.assert_array_equal(seen(kernel, drivable), [[0, 1, 0], [0, 0, 0]])
    np.testing.assert_array_equal(seen(kernel, np.ones(SIZE, np.uint8)), [[0, 1, 1], [0, 1, 1]])


@BOTH
def test_nearer_and_unknown_depth_hides_the_road(kernel):
    depth = np.full(SIZE, 2.0, np.float32)
    depth[4] = np.nan
    np.testing.assert_array_equal(seen(kernel, np.ones(SIZE, np.uint8), depth), [[0, 1, 0], [0, 1, 0]])
    depth[7] = 1.59  # 2 m less a tenth and 0.2 m
    np.testing.assert_array_equal(seen(kernel, np.ones(SIZE, np.uint8), depth), np.zeros((2, 3)))


@given(st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from([(1, 1), (1, 9), (9, 1), SIZE]))
def test_compiled_marks_are_the_same(seed, has_depth, size):
    rng = np.random.default_rng(seed)
    drivable, depth = rng.integers(0, 2, size).astype(np.uint8), rng.uniform(1, 5, size).astype(np.float32)
    depth[rng.random(size) < 0.2] = np.nan
    z = rng.normal(0.0, 1.0, FLAT.shape)
    z[rng.random(z.shape) < 0.1] = np.nan
    found = [seen(k, drivable, depth if has_depth else None, z=z) for k in (plain, compiled)]
    np.testing.assert_array_equal(*found)


@BOTH
@given(st.integers(0, 2**32 - 1))
def test_most_of_nine_pixels_are_their_median(kernel, seed):
    drivable = np.random.default_rng(seed).integers(0, 2, SIZE).astype(np.uint8)
    x, y = 10.0 / np.arange(1.0, 10.0), (7.5 - np.arange(16.0)) / 10
    visible, expected = np.empty((16, 9), np.uint8), cv2.medianBlur(drivable, 3)
    for column in range(9):  # row 3 + column of the image
        at = x[column : column + 1]
        middles = Middles(at, y * at, np.zeros((16, 1)))
        found = kernel.mark_visible(PROJECTION, CAMERA_T_EGO, middles, drivable, None, (0.0, 0.0))
        visible[:, column : column + 1] = found
    np.testing.assert_array_equal(visible, expected[3:12].T)


def test_visible_cells_refuse_other_sizes():
    drivable, depth = np.ones(SIZE, np.uint8), np.ones(SIZE, np.float32)
    for wrong in ({"depth": depth[1:]}, {"z": np.zeros((3, 2))}):
        with pytest.raises(ValueError, match="cells"):
            seen(compiled, drivable, **wrong)
