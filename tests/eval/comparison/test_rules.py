"""What options mean, and which are refused."""

import argparse

import pytest

from roadperc_stream.errors import RoadpercError
from roadperc_stream.eval.comparison.rules import Amount, Rules, allowance, tolerance


def test_the_last_amount_that_matches_holds():
    rules = Rules(tolerances=(Amount("lane_*", 0.1), Amount("lane_left_*", 0.2)))
    assert [rules.tolerance(n) for n in ("lane_left_offset_m", "lane_width_m", "step_m")] == [0.2, 0.1, 0.0]


def test_allowance_in_the_metrics_unit_or_as_a_share():
    rules = Rules(allowances=(allowance("5%"), allowance("step_error_m=0.01"), allowance("turn_*=50%")))
    assert rules.allowance("drivable_iou", 0.8) == pytest.approx(0.04)
    assert rules.allowance("step_error_m", 0.8) == 0.01
    assert rules.allowance("turn_error_deg", -2.0) == 1.0
    assert rules.names("turn_error_deg")
    assert not rules.names("drivable_iou")


@pytest.mark.parametrize("text", ["5", "=5", "x=", "x=-1", "x=nan", "x=inf", "x=-5%", "%", "x=many"])
def test_allowance_refused(text):
    with pytest.raises(argparse.ArgumentTypeError):
        allowance(text)


@pytest.mark.parametrize("text", ["5", "=5", "x=", "x=-1", "x=5%"])
def test_tolerance_refused(text):
    with pytest.raises(argparse.ArgumentTypeError):
        tolerance(text)


def test_a_pattern_that_matches_nothing_is_an_error():
    rules = Rules(ignored=("lane_*",), tolerances=(Amount("lame_*", 0.1),))
    with pytest.raises(RoadpercError, match=r"lame_\*: matches no field and no metric"):
        rules.require_use(["lane_width_m"])
