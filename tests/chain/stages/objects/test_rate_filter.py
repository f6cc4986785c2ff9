"""The filter of a value and its rate against the matrix form; the jitter of distances about a line."""

from dataclasses import astuple
from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.chain.stages.objects import rate_filter
from roadperc_stream.chain.stages.objects.rate_filter import Jitter

WANDER = 2.0
STD_M = 0.15
FILTERED = rate_filter.start(10.0, 0.5, 1.0)
seconds = st.floats(0.0, 2.0)


def matrices(m):
    return np.array([m.value, m.rate]), np.array([[m.value_var, m.cross_var], [m.cross_var, m.rate_var]])


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
    twice, once = first.predict(WANDER, a).predict(WANDER, b), first.predict(WANDER, a + b)
    np.testing.assert_allclose(astuple(twice), astuple(once), rtol=1e-9, atol=1e-12)


def test_covariance_stays_positive_over_thousands_of_frames():
    state = rate_filter.start(0.0, 1e-3, 20.0)
    for _ in range(5000):
        state = state.predict(WANDER, 0.05).update(0.0, 1e-3)
        assert state.value_var > 0
        assert state.value_var * state.rate_var > state.cross_var**2


def test_a_value_without_rate_keeps_the_rate_and_adds_variance():
    filtered = rate_filter.start(10.0, 0.1, 2.0).predict(1.5, 0.1).at(9.0, 0.2, 3.0)
    assert (filtered.value, filtered.rate, filtered.cross_var) == (9.0, 0.0, 0.0)
    assert (filtered.value_var, filtered.rate_var) == pytest.approx((0.04, 4.0 + 1.5**2 * 0.1 + 9.0))


def after(distances_m, stamps_ns):
    jitter = Jitter.of_first(stamps_ns[0], distances_m[0], STD_M)
    for stamp_ns, distance_m in zip(stamps_ns[1:], distances_m[1:], strict=True):
        jitter = jitter.after(stamp_ns, FILTERED, distance_m, STD_M)
    return jitter


@pytest.mark.parametrize("true_m", [0.02, 0.1])
@pytest.mark.parametrize("steps_ns", [(50_000_000,), (20_000_000, 90_000_000)])
def test_the_jitter_about_a_line_is_estimated_at_any_frame_rate(true_m, steps_ns):
    found = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        stamps = np.cumsum([steps_ns[k % len(steps_ns)] for k in range(100)])
        distances = 40.0 - 7.0 * stamps / 1e9 + rng.normal(0, true_m, len(stamps))
        found.append(after(distances.tolist(), stamps.tolist()).variance)
    assert sqrt(np.mean(found)) == pytest.approx(true_m, rel=0.2)


def test_the_jitter_is_at_most_the_deviation_of_a_distance():
    stamps = [k * 50_000_000 for k in range(1, 60)]
    assert sqrt(after([10.0 + (k % 2) for k in range(59)], stamps).variance) <= STD_M + 1e-9


def test_an_outlier_has_a_larger_deviation():
    jitter = Jitter(1e-4, 10.0, 1, 10.0)
    filtered = rate_filter.start(10.0, 0.01, 0.1)
    near, off = (jitter.std(filtered, distance_m, STD_M) for distance_m in (10.01, 10.2))
    assert (near, off) == (pytest.approx(0.01), pytest.approx(0.1, rel=0.02))
    assert jitter.std(filtered, 12.0, STD_M) == STD_M


@pytest.mark.parametrize(("true_m", "expected"), [(0.02, 0.25), (1.0, 1.0), (2.0, 4.0), (50.0, 10.0)])
def test_the_variance_of_the_rate_follows_the_innovations(true_m, expected):
    """The filter expects innovations of 1 m; the distances lie on a line."""
    rng = np.random.default_rng(0)
    jitter = Jitter.of_first(1, 10.0, STD_M)
    scales = []
    for k in range(2, 400):
        filtered = rate_filter.start(10.0 - rng.normal(0, true_m), 1.0, 1.0)
        jitter = jitter.after(k * 50_000_000, filtered, 10.0, STD_M)
        scales.append(jitter.rate_var_scale)
    assert np.median(scales[100:]) == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize(("signs", "least", "most"), [((1, 1), 6.0, 10.0), ((1, -1), 0.8, 1.2)])
def test_innovations_of_one_sign_make_the_rate_less_certain(signs, least, most):
    """Each innovation is as large as the filter expects; a filter that follows has both signs."""
    jitter = Jitter.of_first(1, 10.0, STD_M)
    for k in range(2, 22):
        filtered = rate_filter.start(10.0 - signs[k % 2], 1.0, 1.0)
        jitter = jitter.after(k * 50_000_000, filtered, 10.0, STD_M)
    assert least < jitter.rate_var_scale <= most
    assert jitter.renewed().rate_var_scale == 1.0
