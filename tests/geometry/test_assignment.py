"""Pairs of the largest total: known answers, scipy's totals, and no import of scipy for simple cases."""

import subprocess
import sys

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment

from roadperc_stream.geometry.assignment import largest_total

sizes = st.tuples(st.integers(0, 6), st.integers(1, 6))


def check_total(scores):
    pairs = largest_total(scores)
    assert len(set(pairs.values())) == len(pairs)
    assert all(scores[pair] > 0 for pair in pairs.items())
    total = sum(scores[pair] for pair in pairs.items())
    assert np.isclose(total, scores[linear_sum_assignment(scores, maximize=True)].sum(), rtol=0, atol=1e-9)


def test_the_larger_total_wins_not_the_larger_score():
    assert largest_total(np.array([[0.9, 0.8, 0.0], [0.8, 0.1, 0.0]])) == {0: 1, 1: 0}
    assert largest_total(np.array([[0.5], [0.9], [0.7]])) == {1: 0}
    assert largest_total(np.zeros((2, 2))) == {}


def test_of_equal_totals_the_first_row_gets_its_first_column():
    assert largest_total(np.array([[0.5], [0.5]])) == {0: 0}
    assert largest_total(np.array([[0.0, 0.5, 0.5], [0.0, 0.5, 0.5], [0.9, 0.0, 0.0]])) == {0: 1, 1: 2, 2: 0}


@given(arrays(float, sizes, elements=st.sampled_from([0.0, 0.0, 0.3, 0.5, 0.9])))
def test_the_total_is_that_of_scipy_with_equal_scores(scores):
    check_total(scores)


@given(st.integers(0, 2**32 - 1), sizes, st.floats(0, 1))
def test_the_total_is_that_of_scipy(seed, size, share):
    rng = np.random.default_rng(seed)
    check_total(rng.random(size) * (rng.random(size) < share))


def test_scipy_is_imported_only_if_many_pairs_are_in_doubt():
    code = (
        "import sys, numpy as np; from roadperc_stream.geometry.assignment import largest_total\n"
        "for size in (5, 8):\n"
        "    largest_total(np.full((size, size), 0.5)); print('scipy' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["False", "True"]
