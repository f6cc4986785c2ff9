"""The filter of a value and its rate, against the same filter in matrices."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.stages.objects import rate_filter

WANDER = 2.0
seconds = st.floats(0.0, 2.0)


def matrices(m):
    return np.array([m.value, m.rate]), np.array([[m.value_var, m.cross_var], [m.cross_var, m.rate_var]])


def same(a, b):
    for ours, theirs in zip(matrices(a), matrices(b), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


@given(seconds, st.floats(-50, 50), st.floats(0.01, 5))
def test_equals_the_matrix_form(dt, measured, std):
    first = rate_filter.start(10.0, 0.3, 20.0).predict(WANDER, 0.05).update(9.5, 0.2)
    mean, P = matrices(first)
    F = np.array([[1.0, dt], [0.0, 1.0]])
    Q = WANDER**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    mean, P = F @ mean, F @ P @ F.T + Q
    gain = P[:, 0] / (P[0, 0] + std**2)
    predicted = first.predict(WANDER, dt)
    assert predicted.surprise(measured, std) == pytest.approx((measured - mean[0]) ** 2 / (P[0, 0] + std**2))
    ours, covariance = matrices(predicted.update(measured, std))
    np.testing.assert_allclose(ours, mean + gain * (measured - mean[0]), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(covariance, P - np.outer(gain, P[0]), rtol=1e-6, atol=1e-9)


@given(seconds, seconds)
def test_two_steps_are_one(a, b):
    first = rate_filter.start(10.0, 0.3, 5.0).predict(WANDER, 0.1).update(9.0, 0.2)
    same(first.predict(WANDER, a).predict(WANDER, b), first.predict(WANDER, a + b))


def test_covariance_stays_positive_over_thousands_of_frames():
    state = rate_filter.start(0.0, 1e-3, 20.0)
    for _ in range(5000):
        state = state.predict(WANDER, 0.05).update(0.0, 1e-3)
        assert state.value_var > 0
        assert state.value_var * state.rate_var > state.cross_var**2


def test_a_value_that_says_nothing_of_the_rate_leaves_it_and_adds_what_it_may_have_changed():
    filtered = rate_filter.start(10.0, 0.1, 2.0).predict(1.5, 0.1).at(9.0, 0.2, 3.0)
    assert (filtered.value, filtered.rate, filtered.cross_var) == (9.0, 0.0, 0.0)
    assert (filtered.value_var, filtered.rate_var) == pytest.approx((0.04, 4.0 + 1.5**2 * 0.1 + 9.0))
