"""Quadratics along points: known answers, and the same bits by both forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.kernels import lanes_plain as plain

compiled = pytest.importorskip("roadperc_stream.kernels.lanes_compiled")
BOTH = pytest.mark.parametrize("way", [plain, compiled], ids=["plain", "compiled"])
STATE = (1.7, 0.02, 1 / 150)


def drawn(state=STATE, noise_m=0.0, seed=0, count=200):
    """Points along a quadratic, some of them in one row."""
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(3.0, 38.0, count))
    y = state[0] + state[1] * x + 0.5 * state[2] * x**2 + noise_m * rng.standard_normal(count)
    return x, y, np.hypot(0.01, x / 640), np.sort(rng.integers(0, 2 * count, count))


def follow(way, x, y, std, rows, inward=1.0, innermost=True):
    strip = np.full(len(x), 0.3)
    following = plain.Following(inward, 12.0, 6.0, 40.0, innermost, 8, 3)
    points = plain.Points(x, y, std, rows, strip, strip / 2)
    return way.follow(points, (1.7, 0.0, 0.0), following, plain.Weighing(2.0, 24.0, 1e4))


@BOTH
def test_points_of_a_quadratic_give_it_back(way):
    x, y, std, rows = drawn()
    found = follow(way, x, y, std, rows, innermost=False)
    np.testing.assert_allclose(found.state, STATE, atol=1e-3)
    assert found.reached == x.max()
    assert found.spread < 0.05
    assert (np.linalg.eigvalsh(np.array(found.information)[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)) > 0).all()


@BOTH
def test_accurate_points_in_separate_rows_give_the_weighted_least_squares_solution(way):
    x, y, std, _ = drawn(noise_m=0.001)
    found = follow(way, x, y, std, np.arange(len(x)))
    design = np.stack((np.ones_like(x), x, x**2 / 2), axis=-1)
    information = design.T @ (design / (24.0 * std**2)[:, None])
    expected = np.linalg.solve(information + np.diag((0, 0, 1e4)), design.T @ (y / (24.0 * std**2)))
    np.testing.assert_allclose(found.state, expected, rtol=1e-9)
    np.testing.assert_allclose(found.information, information[np.triu_indices(3)], rtol=1e-12)
    np.testing.assert_allclose(
        found.spread, np.average(((y - design @ expected) / std) ** 2, weights=std**-2), rtol=1e-6
    )


@BOTH
@pytest.mark.parametrize("inward", [1.0, -1.0])
def test_the_innermost_point_of_a_row_counts(way, inward):
    x, y, std, _ = drawn()
    rows = np.repeat(np.arange(len(x)), 2)
    x, std = np.repeat(x, 2), np.repeat(std, 2)
    y = np.repeat(y, 2) - inward * 0.1 * np.tile((1.0, 0.0), len(y))
    found = follow(way, x, y, std, rows, inward=inward)
    np.testing.assert_allclose(found.state, STATE, atol=1e-3)


@BOTH
def test_too_few_points_points_at_one_place_and_nan_give_no_quadratic(way):
    x, y, std, rows = drawn()
    for count in (0, 1, 7):
        assert follow(way, *(values[:count] for values in (x, y, std, rows))) is None
    assert follow(way, np.full_like(x, 5.0), np.full_like(y, 1.7), std, np.arange(len(x))) is None
    some = np.arange(len(y)) % 5 == 0
    found = follow(way, x, np.where(some, np.nan, y), std, rows)
    assert found == follow(way, *(values[~some] for values in (x, y, std, rows)))
    assert follow(way, x, np.full_like(y, np.nan), std, rows) is None


@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.floats(0.0, 0.5), st.booleans(), st.sampled_from((-1.0, 1.0)))
def test_both_forms_give_the_same_bits(seed, count, noise_m, innermost, inward):
    x, y, std, rows = drawn(noise_m=noise_m, seed=seed, count=count)
    y = np.where(np.random.default_rng(seed).random(count) < 0.1, np.round(y, 1), y)
    first, second = (follow(way, x, y, std, rows, inward=inward, innermost=innermost) for way in (plain, compiled))
    assert first == second
    points = plain.Points(x, y, std, rows, 2.5 * std, std)
    first, second = (way.rows_beside(points, STATE, inward, 30.0, (0.0, 0.1, -0.2)) for way in (plain, compiled))
    assert first == second


@BOTH
@pytest.mark.parametrize("inward", [1.0, -1.0])
def test_rows_are_counted_once_and_only_beside_the_line(way, inward):
    x = np.array([1.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    aside = np.array([0.1, 0.2, -0.1, 0.9, np.nan, 0.1])
    y = STATE[0] + STATE[1] * x + 0.5 * STATE[2] * x**2 + inward * aside
    wide = np.full(6, 0.3)
    points = plain.Points(x, y, wide, np.array([3, 3, 4, 5, 6, 7]), wide, wide / 2)
    assert way.rows_beside(points, STATE, inward, 4.5, (0.0, 1.0)) == (2, 1)
    assert way.rows_beside(points, STATE, inward, 5.0, (0.0,)) == (3,)
    none = plain.Points(*(values[:0] for values in (x, y, wide, points.rows, wide, wide)))
    assert way.rows_beside(none, STATE, inward, 5.0, (0.0, 1.0)) == (0, 0)


def test_arrays_of_other_lengths_and_types_are_refused():
    x, y, std, rows = drawn()
    with pytest.raises(ValueError, match="expected 200 numbers"):
        follow(compiled, x, y[1:], std, rows)
    for wrong in ((x.astype(np.float32), y, std, rows), (x, y, std, rows.astype(np.float64))):
        with pytest.raises((ValueError, TypeError)):
            follow(compiled, *wrong)
