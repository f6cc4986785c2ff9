"""Quadratics along points: known answers, and the same bits by both forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.kernels.lanes_plain import Following, Points, Weighing
from tests.kernels.forms import SEEDS, assert_same_bits, both

STATE = (1.7, 0.02, 1 / 150)


def drawn(state=STATE, noise_m=0.0, seed=0, count=200):
    """Points along a quadratic, some of them in one row."""
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(3.0, 38.0, count))
    y = state[0] + state[1] * x + 0.5 * state[2] * x**2 + noise_m * rng.standard_normal(count)
    return x, y, np.hypot(0.01, x / 640), np.sort(rng.integers(0, 2 * count, count))


def asked(x, y, std, rows, inward=1.0, innermost=True):
    strip = np.full(len(x), 0.3)
    following = Following(inward, 12.0, 6.0, 40.0, innermost, 8, 3)
    return Points(x, y, std, rows, strip, strip / 2), (1.7, 0.0, 0.0), following, Weighing(2.0, 24.0, 1e4)


@both("lanes")
def test_points_of_a_quadratic_give_it_back(kernel):
    x, y, std, rows = drawn()
    found = kernel.follow(*asked(x, y, std, rows, innermost=False))
    np.testing.assert_allclose(found.state, STATE, atol=1e-3)
    assert found.reached == x.max()
    assert found.spread < 0.05
    assert (np.linalg.eigvalsh(np.array(found.information)[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)) > 0).all()


@both("lanes")
def test_accurate_points_in_separate_rows_give_the_weighted_least_squares_solution(kernel):
    x, y, std, _ = drawn(noise_m=0.001)
    found = kernel.follow(*asked(x, y, std, np.arange(len(x))))
    design = np.stack((np.ones_like(x), x, x**2 / 2), axis=-1)
    information = design.T @ (design / (24.0 * std**2)[:, None])
    expected = np.linalg.solve(information + np.diag((0, 0, 1e4)), design.T @ (y / (24.0 * std**2)))
    np.testing.assert_allclose(found.state, expected, rtol=1e-9)
    np.testing.assert_allclose(found.information, information[np.triu_indices(3)], rtol=1e-12)
    spread = np.average(((y - design @ expected) / std) ** 2, weights=std**-2)
    np.testing.assert_allclose(found.spread, spread, rtol=1e-6)


@both("lanes")
@pytest.mark.parametrize("inward", [1.0, -1.0])
def test_the_innermost_point_of_a_row_counts(kernel, inward):
    x, y, std, _ = drawn()
    rows = np.repeat(np.arange(len(x)), 2)
    y = np.repeat(y, 2) - inward * 0.1 * np.tile((1.0, 0.0), len(y))
    found = kernel.follow(*asked(np.repeat(x, 2), y, np.repeat(std, 2), rows, inward))
    np.testing.assert_allclose(found.state, STATE, atol=1e-3)


@both("lanes")
def test_too_few_points_points_at_one_place_and_nan_give_no_quadratic(kernel):
    x, y, std, rows = drawn()
    for count in (0, 1, 7):
        assert kernel.follow(*asked(*(values[:count] for values in (x, y, std, rows)))) is None
    assert kernel.follow(*asked(np.full_like(x, 5.0), np.full_like(y, 1.7), std, np.arange(len(x)))) is None
    some = np.arange(len(y)) % 5 == 0
    found = kernel.follow(*asked(x, np.where(some, np.nan, y), std, rows))
    assert found == kernel.follow(*asked(*(values[~some] for values in (x, y, std, rows))))
    assert kernel.follow(*asked(x, np.full_like(y, np.nan), std, rows)) is None


@given(SEEDS, st.integers(1, 300), st.floats(0.0, 0.5), st.booleans(), st.sampled_from((-1.0, 1.0)))
def test_both_forms_give_the_same_bits(seed, count, noise_m, innermost, inward):
    x, y, std, rows = drawn(noise_m=noise_m, seed=seed, count=count)
    y = np.where(np.random.default_rng(seed).random(count) < 0.1, np.round(y, 1), y)
    assert_same_bits("lanes", "follow", *asked(x, y, std, rows, inward, innermost))
