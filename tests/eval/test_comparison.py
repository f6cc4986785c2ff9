"""Agreement of two values, rules, and intervals: known answers and rates of false alarms."""

import argparse
import math

import numpy as np
import polars as pl
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from roadperc_stream.cli.compare import allowance, tolerance
from roadperc_stream.eval.compare.bootstrap import MANY_LOGS, Interval, _block_means, block_length, mean_interval
from roadperc_stream.eval.compare.comparison import compare_runs
from roadperc_stream.eval.compare.fields import INCOMPARABLE, Agreement, Difference, added, distance
from roadperc_stream.eval.compare.metrics import METRICS, LogValues
from roadperc_stream.eval.compare.pairing import RunPair, logged_runs, pair_runs
from roadperc_stream.eval.compare.verdicts import tail_findings, worst_places
from roadperc_stream.eval.options import Amount, Rules
from tests.eval.tables import row, run_of, write

NAN = math.nan
METRIC = {metric.name: metric for metric in METRICS}


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
    from scipy.signal import lfilter  # takes a second in each process that collects the tests

    return lfilter([1.0], [1.0, -correlation], rng.normal(size=frames + 200))[200:]


def excludes_zero(interval):
    return interval.low > 0 or interval.high < 0


def test_interval_of_independent_values_equals_students_t():
    """900 values in 30 blocks: 2.756 standard errors to each side."""
    values = np.random.default_rng(5).normal(loc=2.0, size=900)
    interval = mean_interval([values])
    expected = 2.756 * np.sqrt(30 / 29) * values.std() / 30
    blocks = values.reshape(30, 30).mean(axis=1)
    assert interval.low < 2.0 < interval.high
    assert (interval.high - interval.low) / 2 == pytest.approx(expected, rel=0.35)
    assert (interval.high - interval.low) / 2 == pytest.approx(2.756 * blocks.std() / np.sqrt(29), rel=0.35)


def test_the_interval_of_one_value_is_infinite():
    assert mean_interval([np.array([0.25])]) == Interval(-np.inf, np.inf)


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


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    run = run_of(write(tmp_path_factory.mktemp("tails") / "a.metrics.parquet", [row(0)]))
    return RunPair(run, run)


def worse_tails(pair, name, base, new):
    """The statistics that are worse in six logs, with their base and new values."""
    numbers = np.arange(100) + 7
    metric = METRIC[name]
    logs = [LogValues(metric, pair, numbers, numbers, *one) for one in zip(base, new, strict=True)]
    place = max(
        (found for log in logs if (found := next(worst_places(log), None))), key=lambda at: at.new, default=None
    )
    found = tail_findings(logs, metric.relevant, metric.limit, 10, place)
    return {one.statistic: one for one in found if one.mark == "worse"}


def errors(seed=0):
    """Errors of six logs, 100 frames each, in metres."""
    return [drive(np.random.default_rng([seed, log]), 100, 0.8) * 0.01 for log in range(6)]


@pytest.mark.parametrize(
    ("offs", "found"),
    [
        ({40: 2.0, 41: 2.0}, True),
        ({3: -2.0, 90: 2.0}, True),
        ({40: 2.0}, True),
        ({40: 0.4}, False),
        ({40: 0.2, 41: 0.2}, False),
    ],
)
def test_a_few_frames_far_off_are_found(pair, offs, found):
    base, new = errors(), errors(1)
    new[4] = new[4].copy()
    for frame, off in offs.items():
        new[4][frame] = off
    worse = worse_tails(pair, "lane_left_error_m", base, new)
    assert set(worse) == ({"worst frame"} if found else set())
    if found:
        assert worse["worst frame"].place.frame - 7 in offs
        assert worse["worst frame"].new == 2.0
    assert not worse_tails(pair, "lane_left_error_m", new, base)


def test_outliers_on_both_sides_are_no_regression(pair):
    base, new = errors(), errors(1)
    new[4][[40, 41]], base[2][[10, 11]] = 2.0, 1.2
    assert not worse_tails(pair, "lane_left_error_m", base, new)


def test_a_tripled_spread_is_found(pair):
    base = [0.5 + values for values in errors()]
    new = [0.5 + 3 * values for values in errors()]
    assert "spread" in worse_tails(pair, "surface_height_error_m", base, new)
    assert not worse_tails(pair, "surface_height_error_m", base, [values[::-1] for values in base])


@pytest.mark.parametrize(("lost", "gained", "found"), [(2, 0, True), (1, 0, False), (2, 2, False), (12, 1, True)])
def test_coverage_lost_in_one_log(pair, lost, gained, found):
    """The logs gain ``gained`` frames each, the last one also loses some."""
    base, new = np.ones((6, 100)), np.ones((6, 100))
    base[:, :gained] = 0
    new[5, 50 : 50 + lost] = 0
    assert bool(worse_tails(pair, "lane_left_error_m.coverage", base, new)) == found


def compared(tmp_path, rules=None, times=1.0, objects=False, **changed):
    """A log of 300 frames, compared with itself after changes to columns."""
    rng = np.random.default_rng(3)
    rows = [
        row(n, lane_left_error_m=e, lane_left_offset_m=1.5, drivable_iou=0.97)
        for n, e in enumerate(rng.normal(size=300) / 100)
    ]
    base = write(tmp_path / "base" / "a.metrics.parquet", rows)
    table = pl.read_parquet(base).with_columns(pl.col("total_ms") * times, **changed)
    (tmp_path / "new").mkdir()
    table.write_parquet(tmp_path / "new" / "a.metrics.parquet")
    for side, long in (("base", 1.0), ("new", 1.05)):
        cars = {"frame": range(300), "label": "Car", "kept": True, "true_distance_m": 20.0, "distance_m": 20.0 * long}
        pl.DataFrame(cars).write_parquet(tmp_path / side / "a.objects.parquet") if objects else None
    return compare_runs(
        pair_runs(*(logged_runs(str(tmp_path / side)) for side in ("base", "new")), False), None, rules or Rules()
    )


def test_one_loss_is_one_group_with_its_frame(tmp_path):
    known = ~pl.col("frame").is_between(100, 120)
    columns = {name: pl.when(known).then(pl.col(name)) for name in ("lane_left_error_m", "lane_left_offset_m")}
    found = compared(tmp_path, **columns)
    (group,) = found.groups("worse")
    assert {verdict.metric.name for verdict in group.verdicts} == {f"{name}.coverage" for name in columns}
    assert (found.worst_places[0].frame, found.worst_places[0].base, found.worst_places[0].new) == (100, 1.0, 0.0)


@pytest.mark.parametrize(("judged", "factor", "worse"), [(True, 1.2, True), (True, 1.05, False), (False, 1.2, False)])
def test_times_are_judged_on_request(tmp_path, judged, factor, worse):
    found = compared(tmp_path, Rules(times=judged), times=factor)
    assert ("total_ms" in found.regressions) == worse
    (total,) = (verdict for verdict in found.verdicts if verdict.metric.name == "total_ms")
    assert total.new / total.base == pytest.approx(factor)


def test_classes_of_objects_are_compared(tmp_path):
    assert compared(tmp_path, objects=True).regressions == ["object_distance_error_m.Car"]


@pytest.mark.parametrize(("relevant", "worse"), [({}, []), ({"drivable_iou": 1e-5}, ["drivable_iou"])])
def test_an_irrelevant_change_is_unchanged(tmp_path, relevant, worse):
    assert compared(tmp_path, Rules(relevant=relevant), drivable_iou=pl.lit(0.97 - 2e-5)).regressions == worse
