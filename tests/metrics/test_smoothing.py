import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadperc_stream.metrics.smoothing import smoothed

TIMES_S = np.arange(60) / 10
STAMPS_NS = np.arange(60) * 100_000_000
REACH_S = 1.0


def _line(std=0.1):
    return 3 + 2 * TIMES_S, np.full(len(TIMES_S), std)


def test_a_line_gives_its_own_values_and_rate_with_some_values_before_and_a_second_after_them():
    value, std = _line()
    found = smoothed(STAMPS_NS, value, std, 1.5, REACH_S)
    known = (TIMES_S >= 0.2 * REACH_S - 1e-9) & (TIMES_S[-1] - REACH_S + 1e-9 >= TIMES_S)
    np.testing.assert_allclose(found.value[known], value[known], atol=1e-6)
    np.testing.assert_allclose(found.rate[known], 2, atol=1e-5)
    assert np.isnan(found.value[~known]).all()


def test_a_wrong_value_does_not_agree_with_itself_and_hardly_moves_its_neighbours():
    value, std = _line()
    wrong = value.copy()
    wrong[30] += 5
    found = smoothed(STAMPS_NS, wrong, std, 1.5, REACH_S)
    assert found.value[30] == pytest.approx(value[30], abs=1e-3)
    np.testing.assert_allclose(found.value[25:36], value[25:36], atol=0.05)


@given(st.integers(0, 1000), st.integers(5, 40))
@settings(max_examples=20, deadline=None)
def test_a_part_of_a_series_gives_the_values_of_the_whole_away_from_its_ends(seed, first):
    random = np.random.default_rng(seed)
    value = np.cumsum(random.normal(size=60)) * 0.1
    std = random.uniform(0.05, 0.5, 60)
    whole, part = (smoothed(STAMPS_NS[n:], value[n:], std[n:], 1.5, REACH_S) for n in (0, first))
    same = slice(10, 60 - first)
    np.testing.assert_array_equal(part.value[same], whole.value[first:][same])
    np.testing.assert_array_equal(part.value_std[same], whole.value_std[first:][same])


@pytest.mark.parametrize("seed", range(5))
def test_the_deviation_covers_the_error(seed):
    random = np.random.default_rng(seed)
    times_s = np.arange(400) / 10
    true = 20 - 3 * times_s + 2 * np.sin(times_s / 3)
    found = smoothed(np.arange(400) * 100_000_000, true + random.normal(0, 0.2, 400), np.full(400, 0.2), 1.5, REACH_S)
    off = (found.value - true) / found.value_std
    known = np.isfinite(off)
    assert np.mean(np.abs(off[known]) > 3) < 0.02
    assert np.median(found.value_std[known]) < 0.15  # better known than a single value


def test_too_few_neighbours_give_no_answer():
    stamps_ns = np.array([0, 500_000_000, 1_200_000_000])
    assert np.isnan(smoothed(stamps_ns, np.arange(3.0), np.ones(3), 1.5, REACH_S).value).all()
    assert len(smoothed(np.empty(0, int), np.empty(0), np.empty(0), 1.5, REACH_S).value) == 0
