"""Points counted in cells: known answers, and the same bits by both forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.kernels.occupancy_plain import Cells, KnownPixels, Rays
from tests.kernels.forms import SEEDS, assert_same_bits, both, wild

CELLS = Cells(0.0, -2.0, 0.5, 0.25, 2.0)
LEVEL = np.zeros(3, np.float32)
OBSTACLE_TAGS = np.zeros(256, np.uint8)
OBSTACLE_TAGS[[7, 255]] = 1


def counted(kernel, depth, rays, abd, height, drivable, tags):
    free, occupied = np.zeros((2, 8, 6), np.int64)
    kernel.count_points(CELLS, KnownPixels(depth, height, drivable, tags, OBSTACLE_TAGS), rays, abd, free, occupied)
    return free, occupied


def one_row(x, y, z=0.0):
    """Depths of 1 m, and rays to such points."""
    column = np.zeros((3, len(x)), np.float32)
    column[0], column[1], column[2] = x, y, z
    return np.ones((1, len(x)), np.float32), Rays(column, np.zeros((3, 1), np.float32), LEVEL)


def row(*numbers, kind=np.float32):
    return np.array([numbers], kind)


@both("occupancy")
def test_points_lie_in_their_cells(kernel):
    points = one_row((0.1, 0.1, 2.9, 3.0, 0.1, -0.1, 1.2), (-2.0, -1.8, 1.9, 0.0, -2.1, 0.0, 0.0))
    free, occupied = counted(kernel, *points, LEVEL, None, np.ones((1, 7), np.uint8), np.zeros((1, 7), np.uint8))
    assert (free[0, 0], free[7, 5], free[4, 2], free.sum()) == (2, 1, 1, 4)
    assert not occupied.any()


@both("occupancy")
@pytest.mark.parametrize("is_plane", [True, False])
def test_occupied_points_are_high_or_of_an_obstacle_and_not_above_the_limit(kernel, is_plane):
    height = row(0.25, 0.2, 0.2, 2.0, 2.1, 2.1, np.nan, np.nan)
    tags, drivable = row(0, 1, 7, 0, 0, 255, 7, 0, kind=np.uint8), row(1, 1, 0, 0, 0, 1, 1, 1, kind=np.uint8)
    points = one_row(np.zeros(8), np.zeros(8), height if is_plane else 9.0)
    free, occupied = counted(kernel, *points, LEVEL, None if is_plane else height, drivable, tags)
    assert (free[4, 0], occupied[4, 0]) == (3, 3)


@both("occupancy")
def test_heights_are_over_the_plane(kernel):
    points = one_row((1.1, 1.1, 1.1), (1.6, 1.6, 1.6), (0.55, 0.65, 2.45))
    climbing = np.array([-0.5, 0.25, 0.4], np.float32)  # 0.55 m high at that place
    free, occupied = counted(kernel, *points, climbing, None, np.ones((1, 3), np.uint8), np.zeros((1, 3), np.uint8))
    assert (free[7, 2], occupied[7, 2], occupied.sum()) == (3, 1, 1)


@given(SEEDS, st.integers(0, 5), st.integers(0, 300), st.booleans())
def test_both_forms_count_alike(seed, height, width, is_plane):
    rng = np.random.default_rng(seed)
    depth, heights = wild(rng, (height, width), 4.0), wild(rng, (height, width), 4.0)
    rays = Rays(*(rng.uniform(-1, 1, shape).astype(np.float32) for shape in ((3, width), (3, height), 3)))
    if rng.random() < 0.3:
        depth, rays = np.round(depth), Rays(*map(np.round, rays))
    marks = rng.integers(0, 2, (2 * height, 2 * width)).astype(np.uint8)[::2, ::2]
    tags = rng.choice(np.array([0, 1, 7], np.uint8), (2 * height, 2 * width))[::2, ::2]
    pixels = KnownPixels(depth, None if is_plane else heights, marks, tags, OBSTACLE_TAGS)
    counts = np.zeros((2, 8, 6), np.int64)
    assert_same_bits(
        "occupancy", "count_points", CELLS, pixels, rays, rng.uniform(-1, 1, 3).astype(np.float32), *counts
    )
