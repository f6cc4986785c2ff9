"""The report over a batch's dataset: known answers, reading in batches, and one-line errors."""

import shlex
from dataclasses import replace
from functools import partial

import polars as pl
import pytest

from roadperc_stream.cli.report import main
from roadperc_stream.eval.dataset.place import dataset_at, read_runs
from roadperc_stream.eval.report import grouping, sources
from roadperc_stream.eval.report import report as module
from roadperc_stream.eval.report.grouping import grouped_frames
from roadperc_stream.eval.report.sources import load, source_of_dataset
from roadperc_stream.eval.report.summaries import summarise
from roadperc_stream.eval.runs import find_runs
from roadperc_stream.tools.bench.report import write_dataset
from tests.eval.dataset.datasets import A, B, add_table, compact, done, frames, log_id, small_dataset, write_runs
from tests.eval.tables import outcome, summary_of, usage_error

report = partial(outcome, lambda argv: main([*argv, "--full"]))


@pytest.fixture
def dataset(tmp_path):
    return small_dataset(tmp_path / "dataset")


def summaries(folder, *by):
    dataset = dataset_at(str(folder))
    frames = load(source_of_dataset(dataset, read_runs(dataset)), by)
    return summarise(frames, [grouped_frames(frames, by)])[0]


@pytest.mark.parametrize(
    ("by", "names"),
    [
        ("log", ["drive1", "drive2"]),
        ("date", ["2026-01-01", "2026-01-02"]),
        ("path", ["/drives/drive1.mcap", "/drives/drive2.mcap"]),
        ("missing", ["depth", "none"]),
        ("config_digest", [A * 8, B * 8]),
    ],
)
def test_names_of_groups(dataset, by, names):
    assert [summary.name for summary in summaries(dataset, by)] == names


def test_the_short_report_has_a_row_per_configuration_and_the_worst_log(dataset, capsys):
    _, text, _ = outcome(main, capsys, dataset)
    at = text.index("Group")
    assert [line.split() for line in text[at:].splitlines()[2:4]] == [[B, "10", "0.688"], [A, "10", "0.220"]]
    command = f"roadperc-view {shlex.quote(str(dataset))} --log drive1 --config {B} --frame 2"
    assert f"worst log: lane left error at 10 m 0.610 m on average: {command}" in text.splitlines()
    assert len(text.splitlines()) <= 20
    _, text, _ = outcome(main, capsys, dataset, "--by", "lane_left_status || '-' || config")
    assert f"measured-{A}" in text


def test_a_dataset_is_found_by_its_address_on_this_machine(dataset, capsys):
    assert report(capsys, f"file://{dataset}") == report(capsys, dataset)


def test_the_longest_stretch_without_an_output(tmp_path, capsys):
    offsets = [1.0, None, 1.0, None, None, None, 1.0, None]
    seen = zip(frames(1, [0.1] * len(offsets)), offsets, strict=True)
    add_table(tmp_path, [replace(item, lane_left_offset_m=offset) for item, offset in seen])
    _, text, _ = report(capsys, tmp_path)
    at = text.index("Least covered logs")
    assert [line.split() for line in text[at:].splitlines()[2:4]] == [
        ["left"],
        [log_id(1), "37.5", "3-5", "(0.15-0.25", "s)"],
    ]


def test_reading_in_batches_gives_the_same_as_single_tables(tmp_path, monkeypatch):
    """Batches of texts end within logs, and columns are read one by one."""
    write_dataset(tmp_path / "dataset", 6, 500)
    monkeypatch.setattr(sources, "_ROWS", 330)
    monkeypatch.setattr(sources, "_MOST_VALUES", 1)
    found = summaries(tmp_path / "dataset", "config")
    folder = tmp_path / "tables"
    folder.mkdir()
    for path in (tmp_path / "dataset").glob("metrics/*/*-11111111.parquet"):
        path.rename(folder / f"{path.stem}.metrics.parquet")
    alone = summary_of(*find_runs([str(folder)]))
    (of_config,) = (summary for summary in found if summary.name == "11111111")
    exact = ("frames", "runs", "segments", "longest_gap_s", "incomplete", "categories", "missing", "reasons", "totals")
    for name in exact:
        assert getattr(of_config, name) == getattr(alone, name), name
    assert of_config.span_s == pytest.approx(alone.span_s)
    assert of_config.statistics.keys() == alone.statistics.keys()
    for name, expected in alone.statistics.items():
        assert vars(of_config.statistics[name]) == pytest.approx(vars(expected), rel=1e-9, abs=1e-12), name


def test_of_too_many_groups_the_first_are_listed(dataset, monkeypatch, capsys):
    monkeypatch.setattr(module, "_ROWS_LISTED", 1)
    _, text, _ = report(capsys, dataset, "--by", "log")
    assert "listed: the first 1 of 2 groups" in text
    lines = [line.split() for line in text.splitlines()]
    assert ["drive1", "1", "8", "0.30", "s", "100.0"] in lines


def test_compacted_tables_give_the_same_report(dataset, monkeypatch, capsys):
    _, before, _ = report(capsys, dataset)
    for day in ("2026-01-01", "2026-01-02"):
        compact(dataset, day)
    assert len(list(dataset.glob("metrics/*/*"))) == 2
    assert report(capsys, dataset) == (0, before, "")


def test_a_column_that_only_the_newest_version_has_groups(dataset):
    *_, path = sorted(dataset.glob("metrics/*/*.parquet"))
    pl.read_parquet(path, hive_partitioning=False).with_columns(weather=pl.lit("rain")).write_parquet(path)
    assert [(summary.name, summary.frames) for summary in summaries(dataset, "weather")] == [("rain", 6), ("none", 14)]


def test_values_that_are_not_finite_count_as_missing(dataset):
    (path, *_) = sorted(dataset.glob(f"metrics/*/*-{A}.parquet"))
    table = pl.read_parquet(path, hive_partitioning=False)
    table.with_columns(lane_left_error_m=pl.Series([float("nan"), float("inf"), 0.5, None])).write_parquet(path)
    first, _ = summaries(dataset, "config")
    assert (first.statistics["lane_left_error_m"].values, first.statistics["lane_left_error_m"].abs_most) == (7, 0.5)


def test_tables_missing_in_the_list_of_runs_are_included_with_a_note(dataset, capsys):
    add_table(dataset, frames(9, [0.0]))
    (dataset / "metrics" / "date=2026-01-02" / f"{log_id(2)}-{B}.parquet").unlink()
    _, text, _ = report(capsys, dataset)
    assert "3 logs, 2 configurations, 15 frames" in text
    assert f"included, but not in runs.parquet (a batch may be running): 1 ({log_id(9)}-{A})" in text
    assert "done in runs.parquet, but without a table: 1 (/drives/drive2.mcap)" in text


def test_the_newest_row_of_a_log_replaces_older_ones_also_by_path(dataset):
    known = {"path": "/drives/bad.mcap", "names": ("/drives/bad.mcap", "/other/bad.mcap")}
    listed = dataset / "runs.parquet"
    earlier = pl.read_parquet(listed)
    write_runs(listed, [done(3, A, 5, **known, finished_ns=500), done(4, A, 7, finished_ns=600)])
    pl.concat([earlier, pl.read_parquet(listed)]).write_parquet(listed)
    runs = read_runs(dataset_at(str(dataset)))
    found = {(row["path"], row["config"]): row["status"] for row in runs.iter_rows(named=True)}
    assert found["/drives/bad.mcap", A] == found["/drives/drive4.mcap", A] == "done"
    assert found["/drives/bad.mcap", B] == "damaged"
    assert runs.height == 7


def test_without_a_list_of_runs_the_tables_are_reported(dataset, capsys):
    before = report(capsys, dataset)[1]
    (dataset / "runs.parquet").unlink()
    code, text, _ = report(capsys, dataset)
    assert code == 0
    assert "runs: status unknown, no runs.parquet" in text
    assert f"  {log_id(1)}: path unknown (log {log_id(1)})" in text
    ours, theirs = ([line for line in said.splitlines() if line.startswith((A, B))] for said in (text, before))
    assert ours == theirs != []


def test_without_tables_the_failures_are_printed(tmp_path, capsys):
    write_runs(tmp_path / "runs.parquet", [done(1, status="empty", error="no frame")])
    code, text, error = report(capsys, tmp_path)
    assert code == 1
    assert "empty: /drives/drive1.mcap: no frame" in text
    assert "no log of the batch has frames" in error


@pytest.mark.parametrize(
    ("by", "said"),
    [
        ("lane_left_stats", "no column of the metrics tables or of runs.parquet; similar columns: lane_"),
        ("stamp_ns", "has more than 3 different values"),
    ],
)
def test_invalid_groupings_are_errors(dataset, monkeypatch, capsys, by, said):
    monkeypatch.setattr(grouping, "MOST_GROUPS", 3)
    code, _, error = report(capsys, dataset, "--by", by)
    assert (code, f"--by {by}: {said}" in error) == (1, True)


def damaged(folder):
    *_, path = sorted(folder.glob("metrics/*/*.parquet"))
    path.write_bytes(path.read_bytes()[:-100])


def of_single_replays(folder):
    for path in folder.glob("metrics/*/*.parquet"):
        pl.read_parquet(path, hive_partitioning=False).drop("config").write_parquet(path)


def with_another_list(folder):
    pl.DataFrame({"a": [1]}).write_parquet(folder / "runs.parquet")


def with_logs_that_are_gone(folder):
    none = pl.lit([], pl.List(pl.String))
    rows = pl.read_parquet(folder / "runs.parquet")
    rows.with_columns(names=none, fingerprints=none).write_parquet(folder / "runs.parquet")


def with_frames_twice(folder):
    day = folder / "metrics" / "date=2026-01-01"
    pl.read_parquet(min(day.iterdir()), hive_partitioning=False).write_parquet(day / "part-0.parquet")


def without_column(folder, column):
    path = sorted(folder.glob("metrics/*/*.parquet"))[1]
    pl.read_parquet(path, hive_partitioning=False).drop(column).write_parquet(path)


ROWS_WITHOUT = f"{log_id(1)}-{B}.parquet: is not a metrics table of a batch: it has rows without "


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        (with_frames_twice, f"{log_id(1)}-{A}.parquet and"),
        *((partial(without_column, column=name), ROWS_WITHOUT) for name in ("log_id", "config", "stamp_ns", "frame")),
        (damaged, f"{log_id(2)}-{B}.parquet"),
        (of_single_replays, "it has no column config"),
        (with_another_list, "runs.parquet: is not a list of runs of this version: it has no column log_id"),
        (with_logs_that_are_gone, "error: no log to report"),
    ],
)
def test_every_error_is_one_line(dataset, capsys, spoilt, said):
    spoilt(dataset)
    code, _, error = report(capsys, dataset)
    assert (code, error.count("\n")) == (1, 1)
    assert said in error


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("DATASET", "elsewhere"), "expected one OUT_DIR of a batch"),
        (("DATASET", "--by", "log,,date"), "expected columns or SQL expressions"),
    ],
)
def test_wrong_usage(dataset, capsys, arguments, said):
    assert said in usage_error(main, capsys, *(dataset if word == "DATASET" else word for word in arguments))


def test_logs_whose_files_were_replaced_are_left_out(dataset, capsys):
    rows = pl.read_parquet(dataset / "runs.parquet")
    of_first = pl.col("log_id") == log_id(1)
    none = pl.lit([], pl.List(pl.String))
    gone = rows.with_columns(
        pl.when(of_first).then(none).otherwise(pl.col(n)).alias(n) for n in ("names", "fingerprints")
    )
    gone.write_parquet(dataset / "runs.parquet")
    text = report(capsys, dataset)[1]
    assert text.startswith(f"{dataset}: 1 log, 2 configurations, 12 frames")
    said = f"left out, because other logs have replaced their files: 2 ({log_id(1)}-{A}, {log_id(1)}-{B})"
    assert said in text.splitlines()


@pytest.mark.parametrize("name", ["site=berlin", "config=zz", "frame=7", "date=1999-01-01"])
def test_folders_above_the_dataset_are_not_columns(tmp_path, capsys, name):
    dataset = small_dataset(tmp_path / name / "dataset")
    code, text, said = report(capsys, dataset, "--by", "date,config")
    assert (code, said) == (0, "")
    assert "2026-01-02, bbbb0000" in text


def test_long_groups_by_several_columns_are_numbered(dataset, capsys):
    text = report(capsys, dataset, "--by", "config,log,date,lane_left_status")[1]
    assert f"group 1: {A}, drive1, 2026-01-01, measured" in text.splitlines()
    assert "group 1 " in text


def test_disabled_outputs_are_not_among_the_least_covered(tmp_path, capsys):
    folder = tmp_path / "dataset"
    for config, covered in ((A, 0.5), (B, None)):
        for number in (1, 2):
            ratios = [covered if k < 2 * number else None for k in range(6)]
            rows = [replace(item, drivable_ratio=r) for item, r in zip(frames(number, [0.1] * 6), ratios, strict=True)]
            add_table(folder, rows, config)
    write_runs(folder / "runs.parquet", [done(number, config, 6) for config in (A, B) for number in (1, 2)])
    lines = report(capsys, folder)[1].splitlines()
    start = lines.index("drivable")
    assert [line.split()[:2] for line in lines[start + 1 : start + 3]] == [["drive1", A], ["drive2", A]]
