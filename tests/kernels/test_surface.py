"""Pixels of a class and near a plane, medians of cells, normal equations: known answers, same bits by both forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.kernels import surface_plain as plain

compiled = pytest.importorskip("roadperc_stream.kernels.surface_compiled")
BOTH = pytest.mark.parametrize("kernel", [plain, compiled], ids=["plain", "compiled"])


@given(st.integers(0, 2**32 - 1), st.integers(0, 90), st.integers(0, 200), st.integers(0, 256))
def test_mark_finds_the_pixels_of_a_class(seed, height, width, tags_of_class):
    rng = np.random.default_rng(seed)
    of_class = (rng.permutation(256) < tags_of_class).astype(np.uint8)
    tags = rng.integers(0, 256, (2 * height, 3 * width), np.uint8)[::2, ::3]
    for kernel in (plain, compiled) if tags.size else (compiled,):  # OpenCV has no empty image
        np.testing.assert_array_equal(kernel.mark(tags, of_class), of_class[tags], strict=True)


def test_marks_need_a_class_of_256_tags():
    with pytest.raises(ValueError, match="expected 256"):
        compiled.mark(np.zeros((2, 3), np.uint8), np.zeros(9, np.uint8))


def image(seed, height, width):
    """Depth with unknown and wild pixels, distances per depth, marks and rays."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 3.0, (height, width)).astype(np.float32)
    for wild in (np.nan, np.inf, -np.inf, 0.0, 3e38):
        depth[rng.random(depth.shape) < 0.05] = wild
    column, row, ray = (rng.normal(size=length).astype(np.float32) for length in (width, height, width))
    return depth, column, row, rng.integers(0, 2, depth.shape).astype(np.uint8), ray


@BOTH
def test_pixels_of_known_depth_within_the_distance_are_near(kernel):
    depth = np.array([[1.0, 2.0, np.nan, 2.0], [1.0, 1.5, 2.0, 4.0]], np.float32)
    among, near = np.array([[1, 1, 1, 0], [1, 1, 1, 1]], np.uint8), np.full((2, 4), 9, np.uint8)
    plane = (np.zeros(4, np.float32), np.ones(2, np.float32), -1.5), 0.5
    kernel.mark_near(depth, *plane, among, near)
    np.testing.assert_array_equal(near, [[1, 1, 0, 0], [1, 1, 1, 0]])


@BOTH
def test_moments_are_those_of_the_points(kernel):
    depth, marks = np.array([[1.0, 2.0, 3.0, np.nan]], np.float32), np.array([[1, 1, 0, 1]], np.uint8)
    flat, ray = np.zeros(4, np.float32), np.array([0.5, -1.0, 7.0, 7.0], np.float32)
    found = kernel.moments_near(depth, (flat, flat[:1], 0.0), 1.0, marks, ray)
    np.testing.assert_array_equal(found, [[2, 3, -1.5, 5, -3.5, 4.25]])


@given(st.integers(0, 2**32 - 1), st.integers(0, 12), st.integers(0, 40))
def test_compiled_marks_and_moments_have_the_same_bits(seed, height, width):
    depth, column, row, marks, ray = image(seed, height, width)
    near = np.full((2, height, width), 9, np.uint8)
    for kernel, written in zip((plain, compiled), near, strict=True):
        kernel.mark_near(depth, (column, row, 0.25), 0.7, marks, written)
    np.testing.assert_array_equal(*near)
    expected, found = (k.moments_near(depth, (column, row, 0.25), 0.7, marks, ray) for k in (plain, compiled))
    assert expected.tobytes() == found.tobytes()


@given(st.integers(0, 2**32 - 1), st.integers(0, 12), st.integers(0, 90), st.sampled_from([0.01, 0.5, 1.0]))
def test_marks_are_counted_row_by_row(seed, height, width, share):
    marks = (np.random.default_rng(seed).random((height, width)) < share).astype(np.uint8)
    ranks = np.random.default_rng(seed).permutation(np.count_nonzero(marks))
    for kernel in (plain, compiled):
        np.testing.assert_array_equal(kernel.marked(marks, ranks), np.flatnonzero(marks)[ranks])


def test_ranks_beyond_the_marks_are_refused_and_wrong_marks_do_not_leave_the_image():
    for rank in (-1, 3):
        with pytest.raises(IndexError, match="of 3"):
            compiled.marked(np.array([[0, 1, 1], [0, 0, 1]], np.uint8), np.array([0, rank]))
    marks = np.full((2, 3), 255, np.uint8)
    assert set(compiled.marked(marks, np.arange(6 * 255)).tolist()) == set(range(6))


def test_arrays_of_other_sizes_are_refused():
    depth, column, row, marks, ray = image(0, 4, 5)
    for wrong in ((column[1:], row, marks, marks), (column, row, marks[:3], marks), (column, row, marks, marks[:3])):
        with pytest.raises(ValueError, match="4x5 depths: expected"):
            compiled.mark_near(depth, (*wrong[:2], 0.0), 1.0, *wrong[2:])
    for wrong in ((row[1:], marks, ray), (row, marks[:3], ray), (row, marks, ray[1:])):
        with pytest.raises(ValueError, match="4x5 depths: expected"):
            compiled.moments_near(depth, (column, wrong[0], 0.0), 1.0, *wrong[1:])
    for cells in ([0, 1], [0, 1, 2], [-1, 0, 1]):
        with pytest.raises(ValueError, match="3 values: expected"):
            compiled.median_places(np.int32(cells), np.float32([1, 2, 3]), 2)
    first, values, weights = np.zeros(5, np.intp), np.ones((5, 3)), np.ones(5)
    with pytest.raises(ValueError, match="5 equations"):
        compiled.normal_equations(first, values, weights[:4], weights, 9)
    for off in (-1, 7):
        with pytest.raises(ValueError, match="expected 0 to 8"):
            compiled.normal_equations(first + off, values, weights, weights, 9)
    with pytest.raises(ValueError, match="3 unknowns: expected as many right sides, got 2"):
        compiled.solve_band(np.ones((1, 3)), np.ones(2))


@BOTH
def test_the_median_is_the_middle_value_the_lower_of_two_or_the_first_of_equal_ones(kernel):
    places, counts = kernel.median_places(np.int32([3, 0, 3, 3, 0]), np.float32([5.0, 2.0, -1.0, 0.5, 1.0]), 5)
    assert (places.tolist(), counts.tolist()) == ([4, 3], [2, 3])
    assert kernel.median_places(np.zeros(4, np.int32), np.float32([0.0, -0.0, 0.0, -0.0]), 1)[0].tolist() == [1]


@given(st.integers(0, 2**32 - 1), st.integers(0, 200), st.integers(1, 12), st.integers(1, 100))
def test_compiled_places_are_the_same(seed, number, count, levels):
    rng = np.random.default_rng(seed)
    cell = rng.integers(0, count, number).astype(np.int32)
    heights = (rng.integers(-levels, levels, number) / 7).astype(np.float32)
    heights[rng.random(number) < 0.05] = np.inf
    expected, found = (kernel.median_places(cell, heights, count) for kernel in (plain, compiled))
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_array_equal(one, other)
    assert expected[1].sum() == number


@given(st.integers(1, 8), st.integers(0, 2**32 - 1), st.integers(0, 30))
def test_normal_equations_are_those_of_the_full_matrix(unknowns, seed, number):
    rng, count = np.random.default_rng(seed), 9
    first, values = rng.integers(0, count - unknowns + 1, number), rng.normal(size=(number, unknowns))
    weights, targets = rng.uniform(size=number), rng.normal(size=number)
    A = np.zeros((number, count))
    np.put_along_axis(A, first[:, None] + np.arange(unknowns), values, axis=1)
    N = A.T @ (weights[:, None] * A)
    lower, right = plain.normal_equations(first, values, weights, targets, count)
    for beside in range(unknowns):
        np.testing.assert_allclose(lower[beside, : count - beside], np.diag(N, -beside), atol=1e-12)
    np.testing.assert_allclose(right, A.T @ (weights * targets), atol=1e-12)
    for found, expected in zip(
        compiled.normal_equations(first, values, weights, targets, count), (lower, right), strict=True
    ):
        np.testing.assert_array_equal(found, expected)


@given(st.integers(1, 8), st.integers(1, 20), st.integers(0, 2**32 - 1))
def test_a_band_has_the_solution_of_its_matrix(diagonals, count, seed):
    rng = np.random.default_rng(seed)
    factor = np.tril(np.triu(rng.normal(size=(count, count)), 1 - diagonals)) + 3 * diagonals * np.eye(count)
    matrix, right = factor @ factor.T, rng.normal(size=count)
    lower = np.array([np.pad(np.diag(matrix, -k), (0, min(k, count))) for k in range(diagonals)])
    expected = plain.solve_band(lower, right)
    np.testing.assert_allclose(expected, np.linalg.solve(matrix, right), atol=1e-12)
    np.testing.assert_array_equal(compiled.solve_band(lower, right), expected)


@BOTH
@pytest.mark.parametrize("lower", [[[0.0, 1.0]], [[1.0, 1.0], [1.0, 0.0]], [[1.0, -1.0]], [[np.nan, 1.0]]])
def test_a_band_that_is_not_positive_definite_has_no_solution(kernel, lower):
    assert kernel.solve_band(np.array(lower), np.ones(2)) is None
