"""The length of a step from the road's image and the last speed."""

import pytest

from roadperc_stream.chain.stages.odometry.road_image import RoadMotion
from roadperc_stream.chain.stages.odometry.road_scale import Expected, _fused

KNOWN = Expected(length_m=1.0, variance=0.02**2)


def found(length_m):
    """A length by the road's image."""
    return RoadMotion(length_m, variance=0.01**2, metres_per_pitch=0.0, pitch=0.0, pitch_variance=1.0)


def test_lengths_that_agree_are_fused():
    length_m, variance = _fused(found(1.03), KNOWN)
    assert 1.0 < length_m < 1.03
    assert variance < KNOWN.variance


def test_without_a_known_speed_the_roads_length_counts():
    assert _fused(found(0.7), None)[0] == 0.7


def test_a_contradicting_length_counts_only_if_the_next_one_confirms_it():
    length_m, variance = _fused(found(0.7), KNOWN)
    assert (length_m, variance) == (1.0, pytest.approx(0.1**2))
    after = Expected(length_m, variance)
    assert _fused(found(0.7), after)[0] == pytest.approx(0.7, abs=0.02)
    assert _fused(found(1.0), after)[0] == 1.0
