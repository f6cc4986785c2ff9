"""Pairs of the largest total: known answers, scipy's pairs, and no import of scipy for simple cases."""

import subprocess
import sys

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment

from roadperc_stream.geometry.assignment import largest_total

sizes = st.tuples(st.integers(0, 6), st.integers(1, 6))


def of_scipy(scores):
    pairs = zip(*linear_sum_assignment(scores, maximize=True), strict=True)
    return {int(r): int(c) for r, c in pairs if scores[r, c] > 0}


def test_the_larger_total_wins_not_the_larger_score():
    assert largest_total(np.array([[0.9, 0.8, 0.0], [0.8, 0.1, 0.0]])) == {0: 1, 1: 0}
    assert largest_total(np.array([[0.5], [0.9], [0.7]])) == {1: 0}
    assert largest_total(np.zeros((2, 2))) == {}


@given(arrays(float, sizes, elements=st.sampled_from([0.0, 0.0, 0.3, 0.5, 0.9])))
def test_equal_totals_are_decided_as_scipy_does(scores):
    assert largest_total(scores) == of_scipy(scores)


@given(st.integers(0, 2**32 - 1), sizes, st.floats(0, 1))
def test_the_pairs_are_those_of_scipy(seed, size, share):
    rng = np.random.default_rng(seed)
    scores = rng.random(size) * (rng.random(size) < share)
    assert largest_total(scores) == of_scipy(scores)


def test_scipy_is_imported_only_if_it_is_needed():
    code = (
        "import sys, numpy as np; from roadperc_stream.geometry.assignment import largest_total\n"
        "for scores in ([[0.5, 0.0], [0.4, 0.0]], [[0.5], [0.5]]):\n"
        "    largest_total(np.array(scores)); print('scipy' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["False", "True"]
