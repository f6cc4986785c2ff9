"""Errors in units of their standard deviations: hand-computed shares, NEES and interval."""

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadperc_stream.cli.report import main
from roadperc_stream.eval.report.consistency import (
    added,
    consistency,
    consistency_by_run,
    consistency_of_frames,
    object_numbers,
)
from roadperc_stream.eval.report.sources import load, source_of_runs
from tests.eval.tables import object_rows, row, run_of, write


def of(*normalised):
    return consistency(np.array(normalised), len(normalised), np.arange(len(normalised)))


def frames(path, errors_m, stds_m):
    """A metrics table of steps; the deviation's column is put in beside those that a replay writes today."""
    write(path, [row(k, step_m=1 + e, true_step_m=1.0) for k, e in enumerate(errors_m)])
    column = pl.Series("step_std_m", stds_m, pl.Float64)
    pl.read_parquet(path).with_columns(column).write_parquet(path)
    return path


def objects(path, **columns):
    """The table of detections beside a table of frames."""
    target = path.with_name(path.name.replace("metrics", "objects"))
    object_rows(columns).write_parquet(target)
    return target


def only_run(path):
    (found,) = consistency_by_run(load(source_of_runs([run_of(path)])))
    return found


def test_shares_and_nees_by_hand():
    found = of(0.5, -1.0, 1.5, -2.5, 4.0)
    assert [found.within(k) for k in (1, 2, 3)] == [0.4, 0.6, 0.8]
    assert found.nees == pytest.approx((0.25 + 1 + 2.25 + 6.25 + 16) / 5)
    assert of(*np.ones(7)).nees_interval is None
    assert of(*np.ones(8)).nees_interval == pytest.approx((1, 1))


def test_errors_with_the_right_deviation_have_a_nees_of_1():
    found = consistency_of_frames(np.random.default_rng(1).normal(size=20_000), 20_000)
    assert [found.within(k) for k in (1, 2, 3)] == pytest.approx([0.683, 0.954, 0.997], abs=0.01)
    low, high = found.nees_interval
    assert low < 1 < high
    assert high / low < 1.15


def test_the_interval_of_blocks_of_one_equals_that_of_the_mean():
    squares = np.array([1.0, 4.0, 0.25, 2.25, 1.0, 0.01, 0.49, 3.0, 1.5, 0.8])
    found = of(*np.sqrt(squares))
    error = squares.std(ddof=1) / np.sqrt(10)
    low, high = found.nees_interval
    assert np.log(high / found.nees) == pytest.approx(3.2498 * error / squares.mean(), rel=1e-4)  # Student's t, 9
    assert low * high == pytest.approx(found.nees**2)


def test_rows_of_one_object_do_not_narrow_the_interval():
    """40 frames of one car are one block."""
    values = np.random.default_rng(2).normal(size=12)
    once = consistency(values, 12, np.arange(12))
    often = consistency(np.repeat(values, 40), 480, np.repeat(np.arange(12), 40))
    assert often.nees_interval == pytest.approx(once.nees_interval)
    assert often.nees == pytest.approx(once.nees)


def test_the_interval_of_correlated_frames_contains_the_truth():
    """200 logs with correlation 0.9: few 99 % intervals miss the truth; without blocks many do."""
    random = np.random.default_rng(3)
    missed = alone_missed = 0
    for _ in range(200):
        errors = [random.normal()]
        for kick in random.normal(size=399):
            errors.append(0.9 * errors[-1] + np.sqrt(1 - 0.81) * kick)
        low, high = consistency_of_frames(np.array(errors), 400).nees_interval
        missed += not low < 1 < high
        low, high = of(*errors).nees_interval
        alone_missed += not low < 1 < high
    assert missed < 30
    assert alone_missed > 60


@given(st.lists(st.lists(st.floats(-9, 9), min_size=1, max_size=9), min_size=1, max_size=4))
def test_tables_add_up(parts):
    """The sums over several tables equal those of one table with all rows."""
    numbers = np.concatenate([100 * k + np.arange(len(part)) for k, part in enumerate(parts)])
    whole = consistency(np.concatenate(parts), len(numbers), numbers)
    total = added({"step_m": of(*part)} for part in parts)["step_m"]
    assert total.nees == pytest.approx(whole.nees)
    assert [total.within(k) for k in (1, 2, 3)] == [whole.within(k) for k in (1, 2, 3)]
    assert (total.nees_interval is None) == (whole.nees_interval is None)
    if whole.nees_interval:
        assert total.nees_interval == pytest.approx(whole.nees_interval, rel=1e-6)


def test_rows_without_a_track_are_separate_objects():
    numbers = object_numbers(pl.DataFrame({"track_id": ["2", None, "2", "7", None]}))
    assert numbers[0] == numbers[2]
    assert len(set(numbers)) == 4


def test_a_run_is_read_from_both_tables(tmp_path):
    path = frames(tmp_path / "drive.metrics.parquet", [0.1, -0.3, 0.2, 0.1], [0.1, 0.1, None, 0.0])
    objects(
        path,
        frame=[0, 0, 1],
        kept=[True, False, True],
        track_id=["1", "2", "1"],
        distance_m=[11.0, 50.0, 12.0],
        true_distance_m=[10.0, 10.0, 10.0],
        distance_std_m=[1.0, 1.0, 1.0],
    )
    found = only_run(path)
    assert list(found) == ["step_m", "distance_m"]
    assert (found["step_m"].errors, found["step_m"].values) == (4, 2)  # null, and a deviation of nothing
    assert found["step_m"].nees == pytest.approx(5.0)
    assert (found["distance_m"].values, found["distance_m"].blocks) == (2, 1)  # what was dropped does not count
    assert found["distance_m"].nees == pytest.approx(2.5)


def test_the_report_and_the_page_have_the_table(tmp_path, capsys):
    errors = np.random.default_rng(4).normal(size=200)
    path = frames(tmp_path / "drive.metrics.parquet", 0.1 * errors, np.full(200, 0.1))
    assert main([str(path), "--full", "--html", str(tmp_path / "page.html")]) == 0
    text = capsys.readouterr().out
    line = next(line for line in text.partition("Consistency")[2].splitlines() if line.startswith("step_m")).split()
    assert line[1:3] == ["200", "100.0"]
    assert float(line[3]) == pytest.approx(100 * np.mean(np.abs(errors) <= 1), abs=0.06)
    assert float(line[6]) == pytest.approx(np.mean(errors**2), abs=0.006)
    assert "<h2>Consistency</h2>" in (tmp_path / "page.html").read_text()


def test_damaged_detections_are_an_error_that_names_them(tmp_path, capsys):
    path = frames(tmp_path / "drive.metrics.parquet", [0.1], [0.1])
    target = objects(path, kept=[True], distance_m=["far"], true_distance_m=[1.0])
    assert main([str(path), "--full"]) == 1
    assert target.name in capsys.readouterr().err


def test_extreme_numbers_in_a_table_are_clipped(tmp_path, recwarn):
    path = frames(tmp_path / "drive.metrics.parquet", [1e99, 0.1, -0.1], [1e-300, 0.1, np.nan])
    objects(path, kept=[True, False], distance_m=[1e308, 1.0], true_distance_m=[-1e308, 1.0], distance_std_m=[1.0, 1.0])
    found = only_run(path)
    assert list(found) == ["step_m"]
    assert found["step_m"].nees == pytest.approx(5e11)
    assert not recwarn.list
