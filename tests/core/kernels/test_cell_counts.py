"""Points in the cells of a grid: known answers, and the compiled counts against numpy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.core.kernels import cell_counts_plain
from roadperc_stream.core.kernels.cell_counts import Cells

compiled = pytest.importorskip("roadperc_stream.core.kernels.cell_counts_compiled")
BOTH = pytest.mark.parametrize("kernel", [cell_counts_plain, compiled], ids=["plain", "compiled"])
CELLS = Cells(0.0, -2.0, 0.5, 0.25, 2.0)
SHAPE = 8, 6


def counted(kernel, *points):
    free, occupied = np.zeros(SHAPE, np.int64), np.zeros(SHAPE, np.int64)
    kernel.count_points(CELLS, *points, free, occupied)
    return free, occupied


def row(*numbers, kind=np.float32):
    return np.array([numbers], kind)


@BOTH
def test_points_lie_in_their_cells(kernel):
    x, y = row(0.1, 0.1, 2.9, 3.0, 0.1, -0.1, 1.2), row(-2.0, -1.8, 1.9, 0.0, -2.1, 0.0, 0.0)
    height, drivable = np.zeros((1, 7), np.float32), np.ones((1, 7), np.uint8)
    free, occupied = counted(kernel, x, y, height, drivable, 0 * drivable)
    assert (free[0, 0], free[7, 5], free[4, 2], free.sum()) == (2, 1, 1, 4)
    assert not occupied.any()


@BOTH
def test_what_stands_in_the_way_is_high_or_an_obstacle_and_not_above(kernel):
    height = row(0.25, 0.2, 0.2, 2.0, 2.1, 2.1, np.nan, np.nan)
    obstacle, drivable = row(0, 0, 1, 0, 0, 1, 1, 0, kind=np.uint8), row(1, 1, 0, 0, 0, 1, 1, 1, kind=np.uint8)
    place = np.zeros_like(height)
    free, occupied = counted(kernel, place, place, height, drivable, obstacle)
    assert (free[4, 0], occupied[4, 0]) == (3, 3)


@given(st.integers(0, 2**32 - 1), st.integers(0, 9), st.integers(0, 30))
def test_compiled_counts_are_the_same(seed, height, width):
    rng = np.random.default_rng(seed)
    x, y, z = (rng.uniform(-4, 4, (height, width)).astype(np.float32) for _ in range(3))
    x = np.where(rng.random(x.shape) < 0.3, np.round(2 * x) / 2, x).astype(np.float32)
    for coordinate in (x, y, z):
        for wild in (np.nan, np.inf, -np.inf, 3e38):
            coordinate[rng.random(coordinate.shape) < 0.04] = wild
    marks = rng.integers(0, 2, (2, 2 * height, 2 * width)).astype(np.uint8)[:, ::2, ::2]
    expected, found = (counted(kernel, x, y, z, *marks) for kernel in (cell_counts_plain, compiled))
    np.testing.assert_array_equal(found, expected)


@BOTH
def test_what_does_not_fit_is_refused(kernel):
    points, marks = np.zeros((2, 3), np.float32), np.zeros((2, 3), np.uint8)
    with pytest.raises(ValueError, match="other sizes"):
        counted(kernel, points, points, points, marks, marks[:1])
    with pytest.raises(ValueError, match="counts of"):
        kernel.count_points(CELLS, *[points] * 3, marks, marks, np.zeros((2, 2), np.int64), np.zeros((2, 3), np.int64))
