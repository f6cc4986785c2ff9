"""B-splines against scipy's, and equations given as a band against a full matrix."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from roadperc_stream.chain.stages.surface.bsplines import DEGREE, band_of, basis, solved


@pytest.mark.parametrize(("knot_m", "splines"), [(5.0, 15), (1.0, 4), (0.3, 60)])
def test_the_values_are_scipys(knot_m, splines):
    length = knot_m * (splines - DEGREE)
    x = np.concatenate((np.random.default_rng(0).uniform(0, length, 200), knot_m * np.arange(splines - DEGREE + 1)))
    x = np.minimum(x, knot_m * np.arange(splines + 1)[-1 - DEGREE])
    knots = knot_m * np.arange(-DEGREE, splines + 1)
    expected = BSpline.design_matrix(x, knots, DEGREE).toarray()
    first, values = basis(knot_m, splines, x)
    found = np.zeros_like(expected)
    np.put_along_axis(found, first[:, None] + np.arange(DEGREE + 1), values, axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_allclose(values.sum(axis=1), 1.0, atol=1e-12)


@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_a_band_is_solved_as_its_matrix(diagonals, seed):
    rng, size = np.random.default_rng(seed), 12
    lower = rng.normal(size=(diagonals, size))
    lower[0] += 3 * diagonals
    full = sum(np.diag(lower[k, : size - k], -k) for k in range(diagonals))
    full = full + np.tril(full, -1).T
    right = rng.normal(size=size)
    np.testing.assert_allclose(solved(band_of(lower), right, np.zeros(size)), np.linalg.solve(full, right), atol=1e-9)


def test_equations_without_a_solution_leave_what_there_was():
    np.testing.assert_array_equal(solved(np.zeros((3, 4)), np.ones(4), np.arange(4.0)), np.arange(4.0))
