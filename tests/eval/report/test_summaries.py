"""Summaries of hand-made tables with hand-computed numbers."""

import math

import numpy as np
import polars as pl
import pytest

from roadperc_stream.errors import TableError
from roadperc_stream.eval.report import sources
from roadperc_stream.eval.runs import find_runs
from tests.eval import tables
from tests.eval.tables import START_NS, STEP_NS, row, run_of, write

SECOND = round(1e9 / STEP_NS)
"""Frames of a second."""


def summary_of(tmp_path, rows):
    return tables.summary_of(run_of(write(tmp_path / "drive.metrics.parquet", rows)))


def test_extent(tmp_path):
    frames = (0, 1, 2, 6)
    found = summary_of(tmp_path, [row(index) for index in frames])
    assert (found.frames, found.span_s, found.longest_gap_s) == (4, pytest.approx(0.3), pytest.approx(0.2))
    assert found.rate_hz == pytest.approx(10.0)
    assert found.log_ids == ("a" * 16,)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_number_that_is_not_finite_counts_as_missing(tmp_path, value):
    found = summary_of(tmp_path, [row(0, time_to_impact_s=value), row(1, time_to_impact_s=2.0)])
    assert found.statistics["time_to_impact_s"].abs_most == 2.0
    assert found.coverage("time_to_impact_s") == 0.5


def test_jitter_of_a_hand_computed_series(tmp_path):
    """Raw 0 1 0 1 0 has second differences -2 2 -2, whose deviation is sqrt(32/9); a straight line has none."""
    raw = [0.0, 1.0, 0.0, 1.0, 0.0]
    rows = [row(k, lane_left_raw_offset_m=raw[k], lane_left_offset_m=1.0 + 0.25 * k) for k in range(5)]
    found = summary_of(tmp_path, rows).statistics
    assert found["lane_left_raw_second_difference_m"].std == pytest.approx(math.sqrt(32 / 9))
    assert found["lane_left_second_difference_m"].std == pytest.approx(0.0)


def test_jitter_compares_smoothed_and_raw_on_the_same_frames(tmp_path):
    """The smoothed offset jumps in frame 5, which has no raw one: neither counts it."""
    smoothed = [0.0, 0.0, 0.0, 0.0, 0.0, 9.0]
    raw = [0.0, 1.0, 0.0, 1.0, 0.0, None]
    rows = [row(k, lane_left_raw_offset_m=raw[k], lane_left_offset_m=smoothed[k]) for k in range(6)]
    found = summary_of(tmp_path, rows).statistics
    assert found["lane_left_second_difference_m"].values == found["lane_left_raw_second_difference_m"].values == 3
    assert found["lane_left_second_difference_m"].std == 0.0


def test_a_lane_change_is_not_jitter(tmp_path):
    """The offset jumps to another boundary, so the two differences across the lane change do not count."""
    offsets, changes = [0.3, 0.2, 0.1, 3.5, 3.4, 3.3], [0, 0, 0, 1, 1, 1]
    rows = [
        row(k, lane_left_raw_offset_m=y, lane_left_offset_m=y, lane_changes=n)
        for k, (y, n) in enumerate(zip(offsets, changes, strict=True))
    ]
    found = summary_of(tmp_path, rows).statistics["lane_left_second_difference_m"]
    assert (found.values, found.std) == (2, pytest.approx(0.0, abs=1e-12))


def test_worst_frames_by_absolute_value_the_earliest_of_equals_first(tmp_path):
    errors = [0.1, -0.9, None, 0.5, -0.5]
    found = summary_of(tmp_path, [row(SECOND * k, lane_left_error_m=error) for k, error in enumerate(errors)])
    worst = found.worst["lane_left_error_m"]
    ranked = [(SECOND, -0.9), (3 * SECOND, 0.5), (4 * SECOND, -0.5), (0, 0.1)]
    assert [(frame.frame, frame.value) for frame in worst] == ranked[: len(worst)]
    assert worst[1].since_start_s == pytest.approx(3.0)
    assert worst[1].stamp_ns == START_NS + 3 * SECOND * STEP_NS


def test_worst_frames_are_different_moments(tmp_path):
    errors = {0: 0.5, SECOND - 1: 0.9, SECOND: 0.8, 2 * SECOND: 0.4}
    found = summary_of(tmp_path, [row(k, lane_left_error_m=error) for k, error in errors.items()])
    assert [frame.frame for frame in found.worst["lane_left_error_m"]] == [SECOND - 1, 2 * SECOND]


def test_worst_frames_without_a_lane(tmp_path):
    states = [("measured", "measured"), ("lost", "held"), ("lost", "lost"), (None, None)]
    rows = [row(SECOND * k, lane_left_status=left, lane_right_status=right) for k, (left, right) in enumerate(states)]
    worst = summary_of(tmp_path, rows).worst["lanes_lost"]
    assert [(frame.frame, frame.value) for frame in worst] == [(2 * SECOND, 2.0), (SECOND, 1.0)]


def test_damaged_data_behind_a_whole_footer(tmp_path):
    path = write(tmp_path / "bad.metrics.parquet", [row(k, camera_height_m=k / 7) for k in range(500)])
    content = bytearray(path.read_bytes())
    content[4:2000] = bytes(1996)
    path.write_bytes(content)
    with pytest.raises(TableError, match=r"bad\.metrics\.parquet: its data cannot be read"):
        find_runs([str(path)])


def test_second_differences_do_not_cross_from_log_to_log(tmp_path):
    for name, offset in (("a", 0.0), ("b", 5.0)):
        rows = [row(k, lane_left_offset_m=offset, lane_left_raw_offset_m=offset) for k in range(3)]
        write(tmp_path / f"{name}.metrics.parquet", rows)
    together = tables.summary_of(*find_runs([str(tmp_path)]))
    assert together.statistics["lane_left_second_difference_m"].values == 2
    assert together.statistics["lane_left_second_difference_m"].abs_most == 0.0


@pytest.fixture(scope="module")
def fifty_tables(tmp_path_factory):
    """Fifty tables of up to 300 frames, each about a place of its own; a fifth of the values are null."""
    rng, folder = np.random.default_rng(7), tmp_path_factory.mktemp("tables")
    for index in range(50):
        errors = rng.normal(rng.uniform(-2, 2), 0.1, rng.integers(1, 300))
        known = rng.random(len(errors)) > 0.2
        rows = [
            row(k, f"{index:016x}", lane_left_error_m=error if known[k] else None) for k, error in enumerate(errors)
        ]
        write(folder / f"log{index:02}.metrics.parquet", rows)
    return find_runs([str(folder)]), pl.read_parquet(folder / "*.parquet")["lane_left_error_m"].drop_nulls()


@pytest.mark.parametrize("values", [1, 10**9], ids=["a column at a time", "all columns"])
def test_statistics_over_several_tables(fifty_tables, monkeypatch, values):
    runs, joined = fifty_tables
    monkeypatch.setattr(sources, "_MOST_VALUES", values)
    found = tables.summary_of(*runs).statistics["lane_left_error_m"]
    assert found.values == len(joined)
    assert [found.total, found.std, found.least] == pytest.approx([joined.sum(), joined.std(ddof=0), joined.min()])
    expected = [joined.quantile(share, "linear") for share in (0.05, 0.5, 0.95, 0.99)]
    assert [found.p5, found.median, found.p95, found.p99] == pytest.approx(expected, rel=1e-12)
    sizes = joined.abs()
    expected = [sizes.median(), sizes.quantile(0.95, "linear"), sizes.max()]
    assert [found.abs_median, found.abs_p95, found.abs_most] == pytest.approx(expected, rel=1e-12)


def test_perfect_frames_are_not_among_the_worst(tmp_path):
    rows = [row(k, drivable_iou=iou, lane_left_error_m=m) for k, (iou, m) in enumerate([(1.0, 0.0), (0.9, -0.1)])]
    found = summary_of(tmp_path, rows)
    assert [frame.value for frame in found.worst["drivable_iou"]] == [0.9]
    assert [frame.value for frame in found.worst["lane_left_error_m"]] == [-0.1]
