"""Agreement of two values, rules, and intervals: known answers and rates of false alarms."""

import argparse
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.signal import lfilter

from roadperc_stream.eval.comparison.agreement import INCOMPARABLE, Agreement, Difference, added, distance
from roadperc_stream.eval.comparison.bootstrap import MANY_LOGS, Interval, _block_means, block_length, mean_interval
from roadperc_stream.eval.options import Amount, Rules, allowance, tolerance

NAN = math.nan


@pytest.mark.parametrize(
    ("reference", "candidate", "apart"),
    [
        (1.0, 1.0, 0.0),
        (1, 1.5, 0.5),
        (NAN, NAN, 0.0),
        (NAN, 1.0, INCOMPARABLE),
        (None, None, 0.0),
        (None, 0.0, INCOMPARABLE),
        ("held", "lost", INCOMPARABLE),
        (math.inf, math.inf, 0.0),
        (math.inf, 1.0, INCOMPARABLE),
    ],
)
def test_distance(reference, candidate, apart):
    assert distance(reference, candidate) == apart
    assert distance(candidate, reference) == apart


def test_runs_together_keep_the_first_difference():
    first, second = (Difference(run, 3, 7, "x", 1.0, 2.0) for run in "ab")
    parts = [
        {"x": Agreement()},
        {"x": Agreement(1, 2, 0.5, first)},
        {"x": Agreement(0, 1, 0.75, second), "y": Agreement()},
    ]
    assert added(parts) == {"x": Agreement(1, 3, 0.75, first), "y": Agreement()}


def test_the_last_matching_amount_applies():
    rules = Rules(tolerances=(Amount("lane_*", 0.1), Amount("lane_left_*", 0.2)))
    assert [rules.tolerance(n) for n in ("lane_left_offset_m", "lane_width_m", "step_m")] == [0.2, 0.1, 0.0]


def test_allowance_in_the_metrics_unit_or_as_a_ratio():
    rules = Rules(allowances=(allowance("5%"), allowance("step_error_m=0.01"), allowance("turn_*=50%")))
    assert rules.allowance("drivable_iou", 0.8) == pytest.approx(0.04)
    assert rules.allowance("step_error_m", 0.8) == 0.01
    assert rules.allowance("turn_error_deg", -2.0) == 1.0
    assert rules.names("turn_error_deg")
    assert not rules.names("drivable_iou")


@pytest.mark.parametrize(
    ("parse", "texts"),
    [(allowance, "5 =5 x= x=-1 x=nan x=inf x=-5% % x=many"), (tolerance, "5 =5 x= x=-1 x=5%")],
)
def test_invalid_allowances_and_tolerances(parse, texts):
    for text in texts.split():
        with pytest.raises(argparse.ArgumentTypeError):
            parse(text)


def drive(rng, frames, correlation):
    """Noise around zero with correlated neighbours."""
    return lfilter([1.0], [1.0, -correlation], rng.normal(size=frames + 200))[200:]


def excludes_zero(interval):
    return interval.low > 0 or interval.high < 0


def test_the_interval_of_one_value_is_infinite():
    assert mean_interval([np.array([0.25])]) == Interval(-np.inf, np.inf)


def test_interval_of_independent_values_equals_students_t():
    """900 values in 30 blocks: 2.756 standard errors to each side."""
    values = np.random.default_rng(5).normal(loc=2.0, size=900)
    interval = mean_interval([values])
    expected = 2.756 * np.sqrt(30 / 29) * values.std() / 30
    blocks = values.reshape(30, 30).mean(axis=1)
    assert interval.low < 2.0 < interval.high
    assert (interval.high - interval.low) / 2 == pytest.approx(expected, rel=0.35)
    assert (interval.high - interval.low) / 2 == pytest.approx(2.756 * blocks.std() / np.sqrt(29), rel=0.35)


@pytest.mark.parametrize(("frames", "correlation"), [(40, 0.0), (40, 0.8), (200, 0.0), (200, 0.8)])
def test_chance_is_rarely_marked(frames, correlation):
    """200 logs without a change: 2 are expected at 99 %; of short, correlated logs up to 10 %."""
    rng = np.random.default_rng(1)
    marked = sum(excludes_zero(mean_interval([drive(rng, frames, correlation)])) for _ in range(200))
    assert marked <= 20


def test_block_length_of_a_known_process():
    """(6 n)^(1/3) (c / (1 - c^2))^(2/3) for a first-order process with correlation c."""
    rng, frames, correlation = np.random.default_rng(0), 20000, 0.9
    lengths = [block_length(drive(rng, frames, correlation)) for _ in range(11)]
    expected = (6 * frames) ** (1 / 3) * (correlation / (1 - correlation**2)) ** (2 / 3)
    assert np.median(lengths) == pytest.approx(expected, rel=0.15)


def test_blocks_start_at_each_frame_and_wrap_around_the_end():
    np.testing.assert_allclose(_block_means(np.array([1.0, 2.0, 3.0, 6.0]), 2), [1.5, 2.5, 4.5, 3.5])
    np.testing.assert_allclose(_block_means(np.array([1.0, 2.0, 3.0, 6.0]), 1), [1.0, 2.0, 3.0, 6.0])


def test_many_logs_are_the_blocks():
    """With logs as blocks the scatter between logs widens the interval; with frames it does not."""
    rng = np.random.default_rng(6)
    logs = [np.full(50, shift) + 0.01 * rng.normal(size=50) for shift in rng.normal(size=MANY_LOGS)]
    assert not excludes_zero(mean_interval([log - np.mean(logs) + 0.05 for log in logs]))
    few = logs[: MANY_LOGS - 1]
    assert excludes_zero(mean_interval([log - np.mean(few) + 0.05 for log in few]))


def test_a_log_of_one_frame_among_others():
    interval = mean_interval([np.array([1.0]), np.array([2.0, 3.0, 2.5, 3.5])])
    assert interval.low < 2.4 < interval.high


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60), st.floats(0.001, 1000.0))
def test_the_interval_scales_and_contains_the_mean(values, factor):
    array = np.array(values)
    one, scaled = mean_interval([array]), mean_interval([array * factor])
    slack = 1e-6 * factor * (1 + np.abs(array).max())
    assert one.low - slack <= array.mean() <= one.high + slack
    if np.isfinite(one.low) and block_length(array) == block_length(array * factor):
        assert scaled.low == pytest.approx(one.low * factor, rel=1e-6, abs=slack)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=200))
@example([0.0, 0.0, 0.0, 3e-143])
def test_a_block_is_no_longer_than_the_log(values):
    assert 1 <= block_length(np.array(values)) <= len(values)
