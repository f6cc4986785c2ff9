"""Thinned and merged distributions against sorting everything."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.eval.distribution import FAN_IN, Sketch, absolute, exactly, merged, quantiles, thinned

FINITE = st.floats(-1e6, 1e6)
PARTS = st.lists(st.lists(FINITE, min_size=1, max_size=40), min_size=1, max_size=3 * FAN_IN)
SHARES = (0.0, 0.05, 0.5, 0.95, 0.99, 1.0)


def sorted_part(values):
    return exactly(np.sort(np.array(values, dtype=float)))


def sketch_of(parts, points):
    sketch = Sketch(points)
    for part in parts:
        sketch.add(sorted_part(part))
    return sketch.distribution()


def rank_distance(values, found, rank):
    """How many values lie between a quantile and the rank it should have, from 0 to n; ties hold all their ranks."""
    below, to = np.searchsorted(values, found, "left"), np.searchsorted(values, found, "right")
    return max(below - rank, rank - to, 0)


@given(st.lists(FINITE, min_size=1, max_size=50))
def test_quantiles_of_all_values_are_those_of_numpy(values):
    found = quantiles(sorted_part(values), SHARES)
    assert found == pytest.approx(np.quantile(values, SHARES), rel=1e-9, abs=1e-9)


def test_thinned_keeps_the_middle_of_equal_parts():
    part = thinned(sorted_part(range(12)), 3)
    assert part.values.tolist() == [1, 5, 9]
    assert (part.weights.tolist(), part.error_frames) == ([4, 4, 4], 2)


def test_few_values_are_not_thinned():
    whole = sorted_part([1, 2, 3])
    assert thinned(whole, 3) is whole
    assert whole.rank_error == 0


def test_merged_keeps_the_weights_with_their_values():
    both = merged([thinned(sorted_part(range(12)), 3), sorted_part([4.0])])
    assert both.values.tolist() == [1, 4, 5, 9]
    assert both.weights.tolist() == [4, 1, 4, 4]
    assert both.rank_error == pytest.approx((2 + 2) / 13)


def test_absolute_values_err_from_both_sides():
    sizes = absolute(thinned(sorted_part(range(-8, 4)), 3))
    assert sizes.values.tolist() == [1, 3, 7]
    assert sizes.error_frames == 4


@given(PARTS)
def test_a_sketch_with_room_for_all_is_exact(parts):
    whole = sketch_of(parts, sum(len(part) for part in parts))
    assert whole.values.tolist() == sorted(value for part in parts for value in part)
    assert (whole.rank_error, whole.heights[-1]) == (0, len(whole.values))


@given(PARTS, st.integers(1, 12))
def test_rank_error_of_a_sketch_holds(parts, points):
    whole = sketch_of(parts, points)
    values = np.sort(np.concatenate(parts))
    assert whole.heights[-1] == pytest.approx(len(values))
    for share, found in zip(SHARES, quantiles(whole, SHARES), strict=True):
        assert rank_distance(values, found, share * len(values)) <= whole.rank_error * len(values) + 1


def test_size_of_a_sketch_grows_with_the_levels_alone():
    rng = np.random.default_rng(0)
    whole = sketch_of([rng.normal(size=100) for _ in range(FAN_IN**2 + FAN_IN - 1)], 8)
    assert len(whole.values) <= 8 * 2 * FAN_IN
    assert whole.rank_error < 3 / 16 + 1 / 16
