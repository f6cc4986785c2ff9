"""The growth of boxes against known times to impact."""

from dataclasses import astuple
from math import log

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects import growth, rate_filter
from roadperc_stream.chain.stages.objects.growth import Approach, Growth
from roadperc_stream.chain.stages.objects.rate_filter import Jitter, RateFilter
from roadperc_stream.model import Box
from tests.analytic import STEP_NS

EDGES = (1.0, 1.0)
GATE = 10.83


def box_at(distance_m, noise=(0.0, 0.0, 0.0, 0.0)):
    half_x, half_y = 900.0 / distance_m, 750.0 / distance_m
    return Box(*(np.array([500 - half_x, 400 - half_y, 500 + half_x, 400 + half_y]) + noise))


def approached(speed_mps, seed=None, walk_mps=1.5, frames=40, start_m=40.0):
    """The growth after an approach at a constant speed, and the true inverse of the time to impact."""
    rng = np.random.default_rng(seed)
    found = None
    for frame in range(1, frames + 1):
        distance_m = start_m - speed_mps * frame * STEP_NS / 1e9
        box = box_at(distance_m, rng.normal(0, 1.0, 4) if seed is not None else np.zeros(4))
        stamp_ns = frame * STEP_NS
        if found is None:
            found = Growth.of_first(stamp_ns, box, EDGES)
        else:
            found = found.predict(walk_mps / distance_m, STEP_NS / 1e9).after(stamp_ns, box, EDGES, GATE)
    return found, speed_mps / distance_m


@pytest.mark.parametrize("speed_mps", [-5.0, 0.0, 5.0, 15.0])
def test_the_rate_is_the_inverse_of_the_time_to_impact(speed_mps):
    found, true_rate = approached(speed_mps)
    assert found.approach.rate == pytest.approx(true_rate, rel=0.05, abs=0.01)


def test_deviations_agree_with_the_errors_of_many_approaches():
    """At a constant speed, with a filter that knows it, only the noise of the edges causes errors."""
    errors, jitters = [], []
    for seed in range(60):
        found, true_rate = approached(10.0, seed, walk_mps=0.01)
        errors.append((found.approach.rate - true_rate) / found.approach.variance**0.5)
        jitters.append(approached(0.0, seed, start_m=20.0)[0].jitter.variance)
    assert 0.7 < np.std(errors) < 1.2
    width, height = 1800 / 20.0, 1500 / 20.0
    assert np.mean(jitters) == pytest.approx(100**2 / 2 * (1 / width**2 + 1 / height**2), rel=0.15)


def test_an_error_of_the_growth_increases_as_the_distance_shrinks():
    """At a constant speed the rate r becomes r / (1 - r t), in any number of steps."""
    first = Growth(RateFilter(400.0, 50.0, 0.0, 0.0, 1.0), Jitter.of_first(0, 400.0, 1.0))
    once, twice = first.predict(0.0, 0.4).size, first.predict(0.0, 0.2).predict(0.0, 0.2).size
    assert astuple(once) == pytest.approx(astuple(twice), rel=0.03)
    assert (once.rate, once.rate_var) == (pytest.approx(50 / 0.8), pytest.approx(1 / 0.8**4))
    assert (once.value, once.value_var) == (pytest.approx(400 + 100 * log(1 / 0.8)), pytest.approx(0.5**2))


def test_a_box_of_another_part_starts_the_growth_again():
    first = Growth.of_first(1, box_at(20.0), EDGES)
    for frame in range(2, 20):
        first = first.predict(0.1, 0.05).after(frame * STEP_NS, box_at(20.0), EDGES, GATE)
    again = first.predict(0.1, 0.05).after(20 * STEP_NS, box_at(12.0), EDGES, GATE)
    assert again == Growth.of_first(20 * STEP_NS, box_at(12.0), EDGES)


def test_fusion_allows_for_the_lower_edge_that_both_use():
    """Errors of random edges give the same correlation and variance of the mean."""
    fused = Approach(0.5, 0.01).fused(Approach(0.3, 0.01), GATE)
    lower, upper, left, right = np.random.default_rng(0).normal(size=(4, 100_000))
    size, row = (lower - upper + right - left) / 2, lower
    assert (fused.rate, fused.variance) == (
        pytest.approx(0.4),
        pytest.approx(0.01 * np.var((size + row) / 2), rel=0.02),
    )
    assert Approach(0.5, 0.001).fused(Approach(0.0, 0.002), GATE) == Approach(0.5, 0.001)
    assert Approach(0.5, 0.001).fused(Approach(0.4, 0.1), GATE) == Approach(0.5, 0.001)


def test_the_deviation_of_a_time_covers_that_of_the_rate():
    found = Approach(0.5, 0.01)
    assert found.time_to_impact_std_s == pytest.approx((1 / 0.4 - 1 / 0.6) / 2)


def test_the_approach_of_a_distance():
    distance = rate_filter.RateFilter(20.0, -5.0, 0.04, 0.0, 0.25)
    found = growth.of_distance(distance, 1.0, 0.1)
    assert found.rate == pytest.approx(0.25)
    assert found.variance == pytest.approx(0.25 / 400 + (5 / 400) ** 2 * 0.04 + 0.025**2)
