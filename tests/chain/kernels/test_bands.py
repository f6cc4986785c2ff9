"""Normal equations as a band: against full matrices, and the compiled sums against numpy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.kernels import surface_plain

COUNT = 9


def equations(seed, number, unknowns):
    rng = np.random.default_rng(seed)
    first = rng.integers(0, COUNT - unknowns + 1, number)
    return first, rng.normal(size=(number, unknowns)), rng.uniform(size=number), rng.normal(size=number)


@given(st.integers(0, 2**32 - 1), st.integers(0, 30), st.integers(1, 8))
def test_the_band_is_that_of_the_full_matrix(seed, number, unknowns):
    first, values, weights, targets = equations(seed, number, unknowns)
    A = np.zeros((number, COUNT))
    np.put_along_axis(A, first[:, None] + np.arange(unknowns), values, axis=1)
    N = A.T @ (weights[:, None] * A)
    lower, right = surface_plain.normal_equations(first, values, weights, targets, COUNT)
    for beside in range(unknowns):
        np.testing.assert_allclose(lower[beside, : COUNT - beside], np.diag(N, -beside), atol=1e-12)
    np.testing.assert_allclose(right, A.T @ (weights * targets), atol=1e-12)


@given(st.integers(0, 2**32 - 1), st.integers(0, 30), st.integers(1, 8))
def test_compiled_sums_have_the_same_bits(seed, number, unknowns):
    compiled = pytest.importorskip("roadperc_stream.chain.kernels.surface_compiled")
    asked = (*equations(seed, number, unknowns), COUNT)
    for found, expected in zip(compiled.normal_equations(*asked), surface_plain.normal_equations(*asked), strict=True):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("way", ["plain", "compiled"])
def test_what_does_not_fit_is_refused(way):
    kernel = pytest.importorskip(f"roadperc_stream.chain.kernels.surface_{way}")
    first, values, weights, targets = equations(0, 5, 3)
    with pytest.raises(ValueError, match="5 equations"):
        kernel.normal_equations(first, values, weights[:4], targets, COUNT)
    for off in (-1, COUNT - 2):
        with pytest.raises(ValueError, match=f"of {COUNT}"):
            kernel.normal_equations(np.full(5, off), values, weights, targets, COUNT)
