"""Hand-computed precision, recall, F1 and lag; statistics against numpy."""

import math

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.eval.lanes.precision_recall import scores
from roadperc_stream.eval.report.lag import averaged, correlations, lag_frames
from roadperc_stream.eval.report.statistics import quantiles, statistics

SUMS = {"filter_tp": 6, "filter_fp": 2, "filter_fn": 4}


def lag(offsets, truths, segments=0):
    table = pl.DataFrame({"offset": offsets, "truth": truths}, schema={"offset": pl.Float64, "truth": pl.Float64})
    table = table.with_columns(segment=pl.Series(segments) if segments else pl.lit(0))
    return lag_frames(table.select(correlations("offset", "truth")).item().to_list())


def wave(frames, shift=0):
    return [math.sin((k - shift) / 4) + 0.3 * math.sin((k - shift) / 1.7) for k in range(frames)]


def test_scores_of_counts_of_0_and_of_missing_counts():
    (kept,) = scores(dict.fromkeys(SUMS, 0))
    assert (kept.precision, kept.recall, kept.f1) == (None, None, None)
    (kept,) = scores({**dict.fromkeys(SUMS, 0), "filter_fn": 3})
    assert (kept.precision, kept.recall, kept.f1) == (None, 0, 0)
    assert scores({"filter_tp": 6, "filter_fp": 2}) == []


@given(st.integers(-5, 5))
def test_lag_is_the_shift(shift):
    assert lag(wave(120, shift), wave(120)) == shift


def test_lag_does_not_depend_on_offset_scale_or_missing_values():
    late = [None if k % 7 == 0 else 2 + 0.5 * value for k, value in enumerate(wave(120, 2))]
    assert lag(late, wave(120)) == 2


ALTERNATING = [0.01 * (-1) ** k for k in range(40)]


@pytest.mark.parametrize(
    ("offsets", "truths"),
    [
        *((wave(120, shift), wave(120)) for shift in (-7, -6, 6, 7)),
        *((ALTERNATING, truths) for truths in ([1.5] * 40, [None] * 40, [(-1) ** (k // 20) for k in range(40)])),
        ([0.01 * (k - 3) for k in range(100)], [0.01 * k for k in range(100)]),
        ([1.0], [1.0]),
    ],
)
def test_no_lag_at_the_largest_shifts_or_without_a_distinct_shift(offsets, truths):
    assert lag(offsets, truths) is None


def late(truths, frames):
    """The truth, delayed by a number of frames."""
    return [truths[0]] * frames + truths[: len(truths) - frames]


@pytest.mark.parametrize(
    "truths",
    [
        [3.5 * math.tanh((k - 100) / 20) for k in range(200)],
        [(k / 100 - 1) ** 2 for k in range(200)],
        [math.sin(math.pi * k / 200) for k in range(200)],
    ],
    ids=["lane change", "parabola", "half a sine"],
)
def test_lag_of_slow_curves_is_the_shift(truths):
    assert [lag(late(truths, shift), truths) for shift in (0, 3, 5)] == [0, 3, 5]


def test_lag_of_a_log_shorter_than_the_shifts():
    assert lag([0.0, 1.0, 0.0], [0.0, 1.0, 0.0]) == 0


def test_correlations_are_weighted_by_frames_without_logs_that_have_no_lag():
    sure, late, silent = [1.0, 0.0, 0.0], [0.0, 0.8, None], [math.nan, None, 0.1]
    assert averaged([(30, sure), (10, late), (1000, silent)]) == pytest.approx((0.75, 0.2, 0.0))
    assert averaged([(5, silent)]) == ()


FINITE = st.floats(-1e6, 1e6)
SHARES = (0.0, 0.05, 0.5, 0.95, 0.99, 1.0)


@given(st.lists(FINITE, min_size=1, max_size=50))
def test_statistics_equal_numpy(values):
    values = np.array(values)
    assert quantiles(values, SHARES) == pytest.approx(np.quantile(values, SHARES), rel=1e-9, abs=1e-9)
    found, sizes = statistics(values.copy()), np.abs(values)
    expected = [*np.quantile(sizes, (0.5, 0.95)), sizes.max(), values.sum(), values.std(), values.min()]
    ours = [found.abs_median, found.abs_p95, found.abs_most, found.total, found.std, found.least]
    assert ours == pytest.approx(expected, rel=1e-9, abs=1e-9)
