"""roadperc-compare on hand-made tables: its output, its exit code, and updated references."""

import json
import math
import re
import shutil
from dataclasses import replace
from functools import partial

import polars as pl
import pytest
from junitparser import JUnitXml

from roadperc_stream.cli.compare import main
from roadperc_stream.config import load_config
from roadperc_stream.eval.compare.bootstrap import MANY_LOGS
from roadperc_stream.eval.criteria import BY_NAME
from roadperc_stream.model import Reason
from roadperc_stream.output.tables import table_facts
from tests.eval.tables import START_NS, outcome, row, write

compare = partial(outcome, main)

OTHER = "b" * 16


def table(path, errors):
    """A metrics table with these lane errors."""
    return write(path, [row(k, lane_left_error_m=error) for k, error in enumerate(errors)])


def wave(frames, shift=0.0):
    return [0.02 * math.sin(0.9 * k) + 0.1 + shift for k in range(frames)]


@pytest.fixture
def reference(tmp_path):
    return table(tmp_path / "a.metrics.parquet", wave(40))


def other(reference, name="b", **changes):
    """The reference's rows with columns changed by expressions, under another name."""
    path = reference.with_name(f"{name}.metrics.parquet")
    pl.read_parquet(reference).with_columns(**changes).write_parquet(path)
    return path


def frames(first, last):
    return pl.col("frame").is_between(first, last)


LEFT = pl.col("lane_left_error_m")
SHIFTED = {"lane_left_error_m": LEFT + 0.01}
STATES = {"odometry_status": pl.lit("tracked"), "surface_source": pl.lit("depth"), "drivable_iou": pl.lit(0.9)}
SOMETIMES_LOST = pl.when(frames(3, 5)).then(pl.lit("lost")).otherwise(pl.lit("tracked"))


@pytest.mark.parametrize(
    ("before", "after", "options", "worse"),
    [
        ({}, SHIFTED, [], "lane_left_error_m"),
        ({}, {"lane_left_error_m": pl.lit(-0.2)}, [], "lane_left_error_m"),
        ({}, {"lane_left_error_m": pl.lit(-0.05)}, [], ""),
        ({}, SHIFTED, ["--allow", "lane_left_error_m=0.011"], ""),
        ({}, SHIFTED, ["--allow", "lane_left_error_m=0.009"], "lane_left_error_m"),
        ({}, SHIFTED, ["--allow", "11%"], ""),
        ({}, SHIFTED, ["--allow", "9%"], "lane_left_error_m"),
        ({}, SHIFTED, ["--allow", "lane_*=11%"], ""),
        (STATES, {"drivable_iou": pl.lit(0.8)}, [], "drivable_iou"),
        (STATES, {"surface_source": pl.lit("lower_image")}, [], "surface_source.depth"),
        (STATES, {"odometry_status": SOMETIMES_LOST}, [], "odometry_status.tracked"),
    ],
)
def test_metrics_that_become_worse(reference, capsys, before, after, options, worse):
    """The absolute error counts (here 0.1 m); a lower value is worse if high is better; states are metrics."""
    base = other(reference, "c", **before)
    code, text, error = compare(capsys, base, other(base, "d", **after), *options)
    assert (code, error) == ((1, f"worse than the base run: {worse}\n") if worse else (0, ""))
    beginning = (f"worse: {BY_NAME[worse].label}, mean ",) if worse else ("no relevant difference", "better: ")
    assert text.startswith(beginning)


def test_an_unchanged_run_is_identical(reference, capsys):
    changed_times = other(reference, total_ms=pl.col("total_ms") * 1.5)
    code, text, error = compare(capsys, reference, changed_times, "--exact", "--full")
    assert (code, error) == (0, "")
    assert "within tolerance, 0 differ\n" in text
    assert re.search(r"total_ms +10.00 +15.00 +1.50 +1.50 +1.50\n", text)


def test_tolerance_and_ignored_fields(reference, capsys):
    new = other(reference, lane_left_error_m=LEFT - 0.01)
    assert compare(capsys, reference, new, "--exact")[0] == 1
    for option in ("--tolerance=lane_*=0.011", "--ignore=lane_left_error*"):
        assert compare(capsys, reference, new, "--exact", option)[0] == 0


def test_times_are_judged_on_request_only(reference, capsys):
    slower = other(reference, total_ms=pl.col("total_ms") * 1.2)
    code, text, error = compare(capsys, reference, slower, "--allow", "total_ms=10%")
    assert (code, error) == (1, "worse than the base run: total_ms\n")
    assert "worse, times: total, mean 10 → 12 ms (+2 [+2, +2])" in text
    for allowed in ("10%", "total_ms=21%"):
        assert compare(capsys, reference, slower, "--allow", allowed)[0] == 0


def test_texts_lists_nan_and_values_that_differ_in_late_digits(reference, capsys):
    base = other(reference, "c", lane_left_status=pl.lit("held"), step_m=pl.lit(math.nan))
    far = Reason("lanes", "car_on_boundary", ("left",))
    changes = {"lane_left_status": pl.lit("lost"), "reasons": pl.lit([far.stored])}
    _, text, _ = compare(capsys, base, other(base, "d", lane_left_error_m=LEFT + 1e-13, **changes), "--full")
    assert "lane_left_status: held → lost, in 40 frames" in text
    assert "reasons:  → lanes car_on_boundary left, in 40 frames" in text
    assert "step_m:" not in text
    base_value, new_value = re.search(r"lane_left_error_m: (\S+) → (\S+), in 40 frames", text).groups()
    assert base_value != new_value
    assert text.startswith("no relevant difference")


def test_lost_coverage_is_a_regression_even_if_the_error_is_equal(reference, capsys):
    new = other(reference, lane_left_error_m=pl.when(~frames(10, 14)).then(LEFT))
    code, text, error = compare(capsys, reference, new)
    assert (code, error) == (1, "worse than the base run: lane_left_error_m.coverage\n")
    assert "worse, lanes coverage: lane left error at 10 m coverage, mean 100 → 87.5 % (-12.5 [" in text
    assert "  frame 10 of a, 100 → 0 %: roadperc-view " in text
    assert "lane_left_error_m mean" not in text
    assert compare(capsys, reference, new, "--allow", "*.coverage=0.13")[0] == 0


def test_frames_that_only_one_run_has(reference, tmp_path, capsys):
    shorter = table(tmp_path / "b.metrics.parquet", wave(30))
    code, text, error = compare(capsys, reference, shorter)
    assert "frames only in the base run: 10, only in the new run: 0 (in a)" in text
    assert "30 frames compared" in text
    assert (code, error) == (1, "worse than the base run: frames.coverage\n")
    assert compare(capsys, shorter, reference)[0] == 0
    assert compare(capsys, shorter, reference, "--exact")[0] == 1


def test_frames_of_equal_stamps_stay_in_order(tmp_path, capsys):
    rows = [replace(row(k, lane_merged=k), stamp_ns=START_NS + k // 2) for k in range(6)]
    path = write(tmp_path / "a.metrics.parquet", rows)
    code, text, _ = compare(capsys, path, path, "--exact")
    assert (code, "6 frames compared" in text) == (0, True)


def folder(path, shifts):
    for index, shift in enumerate(shifts):
        log_id = f"{index:016x}"
        rows = [row(k, log_id, lane_left_error_m=error) for k, error in enumerate(wave(20, shift))]
        write(path / f"part{index // 2}" / f"log{index}.metrics.parquet", rows)
    return path


def test_folders_pair_by_log(tmp_path, capsys):
    """Eight logs are the blocks; a renamed table still pairs by its log."""
    ours = folder(tmp_path / "a", [0.0] * MANY_LOGS)
    theirs = folder(tmp_path / "b", [0.010 + 0.001 * (k % 3) for k in range(MANY_LOGS)])
    (theirs / "part0" / "log0.metrics.parquet").rename(theirs / "renamed.metrics.parquet")
    code, text, _ = compare(capsys, ours, theirs, "--full")
    assert code == 1
    assert f"{20 * MANY_LOGS} frames compared in {MANY_LOGS} pairs of runs" in text
    assert "from resampled whole logs" in text
    assert "part0/log0: frame 0" in text
    low, high = (float(x) for x in re.search(r"worse, .*\[(\S+), (\S+)\]", text).groups())
    assert 0.009 < low < 0.0109 < high < 0.013


def test_a_jump_in_two_frames_is_named_with_its_log_and_command(tmp_path, capsys):
    ours, theirs = folder(tmp_path / "a", [0.0] * 2), folder(tmp_path / "b", [0.0] * 2)
    table_path = theirs / "part0" / "log1.metrics.parquet"
    rows = pl.read_parquet(table_path)
    rows.with_columns(lane_left_error_m=pl.when(frames(7, 8)).then(-2.42).otherwise(LEFT)).write_parquet(table_path)
    outputs = {kind: tmp_path / f"compare.{kind}" for kind in ("json", "markdown", "junit")}
    options = [word for kind, path in outputs.items() for word in (f"--{kind}", path)]
    code, text, error = compare(capsys, ours, theirs, *options)
    logs = [f"{side}/part0/log1.metrics.parquet" for side in (ours, theirs)]
    shown = f"frame 7 of part0/log1, 0.1 → 2.42 m: roadperc-view {logs[0]} {logs[1]}"
    assert (code, error) == (1, "worse than the base run: lane_left_error_m\n")
    assert text.startswith("worse: lane left error at 10 m, worst frame of part0/log1 0.1 → 2.42 m; 3 metrics ")
    assert f"\n  {shown} --frame 7\n" in text

    found = json.loads(outputs["json"].read_text(), parse_constant=pytest.fail)
    assert (found["verdict"], found["counts"]) == ("worse", {"worse": 1, "unchanged": 2, "better": 0})
    place = found["metrics"]["lane_left_error_m"]["place"]
    assert (place["log"], place["frame"], place["new"]) == ("part0/log1", 7, 2.42)
    assert outputs["markdown"].read_text().startswith("## Comparison: worse: lane left error at 10 m, worst frame")
    (suite,) = JUnitXml.fromfile(str(outputs["junit"]))
    bad = [case for case in suite if case.result]
    assert [(case.classname, case.name) for case in bad] == [("part0/log1", "lane_left_error_m worst frame")]
    assert shown in bad[0].result[0].text
    assert len({case.name for case in suite}) == suite.tests
    criteria = tmp_path / "criteria.toml"
    criteria.write_text("[metrics.lane_left_error_m]\nrelevant = 0.3\n")
    assert compare(capsys, ours, theirs, "--criteria", criteria)[0] == 0


def test_several_runs_of_one_log_pair_by_name(tmp_path, capsys):
    for side in "ab":
        for name, error in (("fast", 0.1), ("full", 0.2)):
            table(tmp_path / side / f"{name}.metrics.parquet", [error] * 5)
    code, text, _ = compare(capsys, tmp_path / "a", tmp_path / "b", "--exact")
    assert code == 0
    assert "10 frames compared in 2 pairs" in text


def other_log(path, start=0):
    rows = [replace(row(k, OTHER), stamp_ns=START_NS + start + k * 50_000_000) for k in range(40)]
    return write(path, rows)


def test_runs_that_only_one_folder_has(tmp_path, capsys):
    ours, theirs = folder(tmp_path / "a", [0.0]), folder(tmp_path / "b", [0.0] * 2)
    code, text, _ = compare(capsys, ours, theirs)
    assert code == 0
    assert f"only in new: part0/log1 (log {1:016x})" in text
    code, _, error = compare(capsys, theirs, ours)
    assert (code, error) == (1, "worse than the base run: no run of part0/log1\n")


def test_folders_without_anything_in_common(tmp_path, capsys):
    ours = folder(tmp_path / "a", [0.0, 0.0])
    for name in ("x", "y"):
        other_log(tmp_path / "b" / f"{name}.metrics.parquet")
    code, _, error = compare(capsys, ours, tmp_path / "b")
    assert code == 3
    assert "no new run has the log or the name of a base run" in error


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (other_log, [], rf"b\.metrics\.parquet: is of log {OTHER}, expected a+ as in .*--other-log"),
        (lambda path: other_log(path, 17), ["--other-log"], r"shares no stamp with .*a\.metrics\.parquet: \d+ to \d+"),
        (lambda path: write(path, []), [], r"b\.metrics\.parquet: no frames in this table"),
        (lambda path: write(path, [row(0), row(1, OTHER)]), [], r"b\.metrics\.parquet: holds 2 logs"),
        (lambda path: path, [], r"b\.metrics\.parquet: no such file"),
        (lambda path: shutil.copy(__file__, path), [], r"b\.metrics\.parquet: is not a Parquet file"),
    ],
    ids=["other log", "no common stamp", "empty", "two logs", "absent", "no table"],
)
def test_runs_that_cannot_be_compared(reference, capsys, make, options, message):
    make(reference.with_name("b.metrics.parquet"))
    code, text, error = compare(capsys, reference, reference.with_name("b.metrics.parquet"), *options)
    assert (code, text) == (3, "")
    assert re.fullmatch(rf"error: .*{message}.*\n", error)


def test_a_misspelt_name_is_an_error(reference, capsys):
    code, _, error = compare(capsys, reference, reference, "--ignore", "lame_*")
    assert (code, error) == (3, "error: lame_*: matches no field and no metric of these runs; check the spelling\n")


def test_a_reference_is_created_and_updated(tmp_path, capsys):
    reference, runs = tmp_path / "reference", folder(tmp_path / "runs", [0.0, 0.0])
    code, text, _ = compare(capsys, reference, runs, "--update-reference")
    assert (code, text.count("base: ")) == (0, 2)
    unchanged = reference / "part0" / "log0.metrics.parquet"
    before_ns = unchanged.stat().st_mtime_ns

    folder(runs, [0.0, 0.3, 0.0])
    code, text, _ = compare(capsys, reference, runs, "--update-reference")
    assert code == 0
    assert re.findall(r"base: .+reference/(\S+) is now", text) == [
        "part0/log1.metrics.parquet",
        "part1/log2.metrics.parquet",
    ]
    assert unchanged.stat().st_mtime_ns == before_ns
    code, text, _ = compare(capsys, reference, runs, "--exact", "--update-reference")
    assert (code, " 0 differ" in text, "unchanged, all results are equal" in text) == (0, True, True)


def test_a_table_as_reference_is_replaced_and_a_log_is_not(reference, capsys):
    new = other(reference, **SHIFTED)
    code, _, error = compare(capsys, reference.with_name("a.mcap"), reference, "--update-reference")
    assert code == 3
    assert re.fullmatch(r"error: .*a\.mcap: is a log; with --update-reference pass .*\n", error)
    assert compare(capsys, reference, new, "--update-reference")[0] == 0
    assert reference.read_bytes() == new.read_bytes()
    assert [path for path in reference.parent.iterdir() if path.name.startswith(".")] == []


def test_pairs_with_the_same_changed_settings_are_listed_together(tmp_path, capsys):
    for folder, hold_s in (("a", 0.5), ("b", 2.0)):
        for name, log_id in (("day", "d" * 16), ("night", "e" * 16), ("rain", "f" * 16)):
            path = write(tmp_path / folder / f"{name}.metrics.parquet", [row(k, log_id=log_id) for k in range(3)])
            settings = (f"lanes.hold_s={0.5 if name == 'rain' else hold_s}",)
            pl.read_parquet(path).write_parquet(path, metadata=table_facts(path, path, load_config(settings=settings)))
    _, text, _ = compare(capsys, tmp_path / "a", tmp_path / "b")
    assert "\nsettings that differ in day, night: lanes.hold_s 0.5 → 2.0\n9 frames compared in 3 pairs" in text
