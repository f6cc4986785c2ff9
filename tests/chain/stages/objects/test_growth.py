"""The growth of boxes against known times to impact."""

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects import growth, rate_filter
from roadperc_stream.chain.stages.objects.growth import Approach, Growth
from roadperc_stream.model import Box
from tests.analytic import STEP_NS

EDGES = (1.0, 1.0)
GATE = 10.83


def box_at(distance_m, noise=(0.0, 0.0, 0.0, 0.0)):
    half_x, half_y = 900.0 / distance_m, 750.0 / distance_m
    return Box(*(np.array([500 - half_x, 400 - half_y, 500 + half_x, 400 + half_y]) + noise))


def approached(speed_mps, seed=None, frames=40, start_m=40.0):
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
            found = found.predict(1.5 / distance_m, STEP_NS / 1e9).after(stamp_ns, box, EDGES, GATE)
    return found.approach, speed_mps / distance_m


@pytest.mark.parametrize("speed_mps", [-5.0, 0.0, 5.0, 15.0])
def test_the_rate_is_the_inverse_of_the_time_to_impact(speed_mps):
    found, true_rate = approached(speed_mps)
    assert found.rate == pytest.approx(true_rate, rel=0.05, abs=0.01)


def test_the_deviation_agrees_with_the_errors_of_many_approaches():
    errors = []
    for seed in range(60):
        found, true_rate = approached(10.0, seed)
        errors.append((found.rate - true_rate) / found.variance**0.5)
    assert 0.4 < np.std(errors) < 1.2


def test_a_box_of_another_part_starts_the_growth_again():
    first = Growth.of_first(1, box_at(20.0), EDGES)
    for frame in range(2, 20):
        first = first.predict(0.1, 0.05).after(frame * STEP_NS, box_at(20.0), EDGES, GATE)
    again = first.predict(0.1, 0.05).after(20 * STEP_NS, box_at(12.0), EDGES, GATE)
    assert again == Growth.of_first(20 * STEP_NS, box_at(12.0), EDGES)


def test_fusion_by_inverse_variances():
    fused = Approach(0.5, 0.01).fused(Approach(0.3, 0.03), GATE)
    assert (fused.rate, fused.variance) == (pytest.approx(0.45), pytest.approx(0.0075))
    assert Approach(0.5, 0.001).fused(Approach(0.0, 0.002), GATE) == Approach(0.5, 0.001)


def test_the_deviation_of_a_time_covers_that_of_the_rate():
    found = Approach(0.5, 0.01)
    assert found.time_to_impact_std_s == pytest.approx((1 / 0.4 - 1 / 0.6) / 2)


def test_the_approach_of_a_distance():
    distance = rate_filter.RateFilter(20.0, -5.0, 0.04, 0.0, 0.25)
    found = growth.of_distance(distance, 1.0, 0.1)
    assert found.rate == pytest.approx(0.25)
    assert found.variance == pytest.approx(0.25 / 400 + (5 / 400) ** 2 * 0.04 + 0.025**2)
