"""Medians of cells, normal equations: known answers, and the same bits by both forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.kernels.forms import SEEDS, assert_same_bits, both


@both("surface")
def test_the_median_is_the_middle_value_the_lower_of_two_or_the_first_of_equal_ones(kernel):
    places, counts = kernel.median_places(np.int32([3, 0, 3, 3, 0]), np.float32([5.0, 2.0, -1.0, 0.5, 1.0]), 5)
    assert (places.tolist(), counts.tolist()) == ([4, 3], [2, 3])
    assert kernel.median_places(np.zeros(4, np.int32), np.float32([0.0, -0.0, 0.0, -0.0]), 1)[0].tolist() == [1]


@both("surface")
@given(st.integers(1, 8), SEEDS, st.integers(0, 30))
def test_normal_equations_are_those_of_the_full_matrix(kernel, unknowns, seed, number):
    rng, count = np.random.default_rng(seed), 9
    first, values = rng.integers(0, count - unknowns + 1, number), rng.normal(size=(number, unknowns))
    weights, targets = rng.uniform(size=number), rng.normal(size=number)
    A = np.zeros((number, count))
    np.put_along_axis(A, first[:, None] + np.arange(unknowns), values, axis=1)
    N = A.T @ (weights[:, None] * A)
    lower, right = kernel.normal_equations(first, values, weights, targets, count)
    for beside in range(unknowns):
        np.testing.assert_allclose(lower[beside, : count - beside], np.diag(N, -beside), atol=1e-12)
    np.testing.assert_allclose(right, A.T @ (weights * targets), atol=1e-12)
    assert_same_bits("surface", "normal_equations", first, values, weights, targets, count)


@both("surface")
@given(st.integers(1, 8), st.integers(1, 20), SEEDS)
def test_a_band_has_the_solution_of_its_matrix(kernel, diagonals, count, seed):
    rng = np.random.default_rng(seed)
    factor = np.tril(np.triu(rng.normal(size=(count, count)), 1 - diagonals)) + 3 * diagonals * np.eye(count)
    matrix, right = factor @ factor.T, rng.normal(size=count)
    lower = np.array([np.pad(np.diag(matrix, -k), (0, min(k, count))) for k in range(diagonals)])
    np.testing.assert_allclose(kernel.solve_band(lower, right), np.linalg.solve(matrix, right), atol=1e-12)
    assert_same_bits("surface", "solve_band", lower, right)


@both("surface")
@pytest.mark.parametrize("lower", [[[0.0, 1.0]], [[1.0, 1.0], [1.0, 0.0]], [[1.0, -1.0]], [[np.nan, 1.0]]])
def test_a_band_that_is_not_positive_definite_has_no_solution(kernel, lower):
    assert kernel.solve_band(np.array(lower), np.ones(2)) is None


@given(SEEDS, st.integers(0, 200), st.integers(1, 12), st.integers(1, 100))
def test_median_places_are_the_same(seed, number, count, levels):
    rng = np.random.default_rng(seed)
    heights = (rng.integers(-levels, levels, number) / 7).astype(np.float32)
    heights[rng.random(number) < 0.05] = np.inf
    assert_same_bits("surface", "median_places", rng.integers(0, count, number).astype(np.int32), heights, count)
