"""The command on tables made by hand: what it says, how it ends, and what a reference becomes."""

import math
import re
import shutil
from dataclasses import replace
from functools import partial

import polars as pl
import pytest

from roadperc_stream.cli.compare import main
from roadperc_stream.config import load_config
from roadperc_stream.output.tables import table_facts
from tests.eval.tables import START_NS, outcome, row, write

compare = partial(outcome, main)

OTHER = "b" * 16


def table(path, errors, **columns):
    """A drive with these lane errors."""
    return write(path, [row(k, lane_left_error_m=error, **columns) for k, error in enumerate(errors)])


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
def test_what_is_worse(reference, capsys, before, after, options, worse):
    """It is the absolute error that counts, of 0.1 m here; where high is good less is worse; states are metrics."""
    base = other(reference, "c", **before)
    code, text, error = compare(capsys, base, other(base, "d", **after), *options)
    assert (code, error) == ((1, f"worse than the reference: {worse}\n") if worse else (0, ""))
    assert (f"\nverdict: worse in {worse}\n" in text) == bool(worse)


@pytest.mark.parametrize("options", [["--tolerance", "lane_*=0.011"], ["--ignore", "lane_left_error*"]])
def test_tolerance_and_ignored_fields(reference, capsys, options):
    candidate = other(reference, lane_left_error_m=LEFT - 0.01)
    assert compare(capsys, reference, candidate, "--exact")[0] == 1
    assert compare(capsys, reference, candidate, "--exact", *options)[0] == 0


def test_an_unchanged_run_is_identical(reference, capsys):
    changed_times = other(reference, total_ms=pl.col("total_ms") * 1.5)
    code, text, error = compare(capsys, reference, changed_times, "--exact")
    assert (code, error) == (0, "")
    assert "differ" not in text.replace("0 differ", "").replace("settings that differ: unknown", "")
    assert text.endswith("verdict: identical\n")
    assert re.search(r"total_ms +10.00 +15.00 +1.50 +1.50 +1.50\n", text)


def test_values_that_differ_late_are_shown_with_all_their_digits(reference, capsys):
    _, text, _ = compare(capsys, reference, other(reference, lane_left_error_m=pl.col("lane_left_error_m") + 1e-13))
    reference_value, candidate_value = re.search(r"lane_left_error_m: (\S+) → (\S+), in 40 frames", text).groups()
    assert reference_value != candidate_value
    assert "nothing worse" in text


def test_texts_lists_and_nan(reference, capsys):
    base = other(reference, "c", lane_left_status=pl.lit("held"), step_m=pl.lit(math.nan))
    candidate = other(base, "d", lane_left_status=pl.lit("lost"), reasons=pl.lit(["lanes: gone"]))
    _, text, _ = compare(capsys, base, candidate)
    assert "lane_left_status: held → lost, in 40 frames" in text
    assert "reasons:  → lanes: gone, in 40 frames" in text
    assert "step_m:" not in text


def test_lost_coverage_is_a_regression_even_where_the_error_is_the_same(reference, capsys):
    lost = pl.when(~frames(10, 14)).then(pl.col("lane_left_error_m"))
    code, text, error = compare(capsys, reference, other(reference, lane_left_error_m=lost))
    assert (code, error) == (1, "worse than the reference: lane_left_error_m.coverage\n")
    assert "worse: lane_left_error_m.coverage 1 → 0.875 (-0.125" in text
    assert "worse: lane_left_error_m 0" not in text
    allowed = ("--allow", "*.coverage=0.13")
    assert compare(capsys, reference, other(reference, lane_left_error_m=lost), *allowed)[0] == 0


def test_times_are_judged_on_request_only(reference, capsys):
    slower = other(reference, total_ms=pl.col("total_ms") * 1.2)
    assert compare(capsys, reference, slower, "--allow", "10%")[0] == 0
    code, text, error = compare(capsys, reference, slower, "--allow", "total_ms=10%")
    assert (code, error) == (1, "worse than the reference: total_ms\n")
    assert "worse: total_ms 10 → 12 (+2 [+2, +2])" in text
    assert compare(capsys, reference, slower, "--allow", "total_ms=21%")[0] == 0


def test_frames_that_only_one_run_has(reference, tmp_path, capsys):
    shorter = table(tmp_path / "b.metrics.parquet", wave(30))
    code, text, error = compare(capsys, reference, shorter)
    assert "a: 10 frames only in the reference, 0 only in the candidate" in text
    assert "30 frames compared" in text
    assert (code, error) == (1, "worse than the reference: frames.coverage\n")
    assert compare(capsys, shorter, reference)[0] == 0
    assert compare(capsys, shorter, reference, "--exact")[0] == 1


def test_a_table_of_an_older_version_lacks_columns(reference, capsys):
    older = reference.with_name("old.metrics.parquet")
    pl.read_parquet(reference).drop("lane_left_error_m", "objects_carried").write_parquet(older)
    code, text, _ = compare(capsys, older, reference)
    assert code == 0
    assert "lane_left_error_m: none → 0.1, in 40 frames" in text


@pytest.mark.parametrize(
    "strange",
    [
        pl.duration(seconds="frame"),
        pl.struct("frame", "log_id"),
        pl.col("log_id").cast(pl.Binary),
        pl.concat_list("frame"),
    ],
)
def test_columns_of_a_type_that_no_replay_writes(reference, capsys, strange):
    candidate = other(reference, extra=strange)
    assert compare(capsys, reference, candidate)[0] == 0
    code, text, error = compare(capsys, candidate, reference, "--exact")
    assert "extra: " in text
    assert (code, error) == (1, "differs from the reference: extra\n")
    assert compare(capsys, candidate, other(candidate, "c", extra=strange), "--exact")[0] == 0


def test_frames_of_equal_stamps_stay_in_order(tmp_path, capsys):
    rows = [replace(row(k, lane_merged=k), stamp_ns=START_NS + k // 2) for k in range(6)]
    path = write(tmp_path / "a.metrics.parquet", rows)
    code, text, _ = compare(capsys, path, path, "--exact")
    assert code == 0
    assert "6 frames compared" in text


def folder(path, shifts):
    for index, shift in enumerate(shifts):
        log_id = f"{index:016x}"
        rows = [row(k, log_id, lane_left_error_m=error) for k, error in enumerate(wave(20, shift))]
        write(path / f"part{index // 2}" / f"log{index}.metrics.parquet", rows)
    return path


def test_folders_pair_by_log(tmp_path, capsys):
    """Over ten logs the logs are the blocks; under other names they find each other."""
    ours = folder(tmp_path / "a", [0.0] * 10)
    theirs = folder(tmp_path / "b", [0.010 + 0.001 * (k % 3) for k in range(10)])
    (theirs / "part0" / "log0.metrics.parquet").rename(theirs / "renamed.metrics.parquet")
    code, text, _ = compare(capsys, ours, theirs)
    assert code == 1
    assert "200 frames compared in 10 pairs of runs" in text
    assert "whole logs as blocks" in text
    assert "part0/log0: frame 0" in text
    low, high = (float(x) for x in re.search(r"worse: .*\[(\S+), (\S+)\]", text).groups())
    assert 0.009 < low < 0.0109 < high < 0.013


def test_runs_that_only_one_folder_has(tmp_path, capsys):
    ours, theirs = folder(tmp_path / "a", [0.0] * 3), folder(tmp_path / "b", [0.0] * 4)
    code, text, _ = compare(capsys, ours, theirs)
    assert code == 0
    assert f"only in the candidate: part1/log3 (log {3:016x})" in text
    code, _, error = compare(capsys, theirs, ours)
    assert (code, error) == (1, "worse than the reference: no run of part1/log3\n")


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
    assert (code, text) == (1, "")
    assert re.fullmatch(rf"error: .*{message}.*\n", error)


def test_names_that_two_algorithms_made_do_not_tell_logs_apart(reference, capsys):
    rows = [row(k, OTHER, lane_left_error_m=error) for k, error in enumerate(wave(40))]
    write(reference.with_name("b.metrics.parquet"), rows, digest_algorithm="blake3")
    code, text, _ = compare(capsys, reference, reference.with_name("b.metrics.parquet"), "--exact")
    assert code == 0
    assert "one log is named by sha256, the other by blake3" in text
    assert "log_id:" not in text


def test_folders_without_anything_in_common(tmp_path, capsys):
    ours = folder(tmp_path / "a", [0.0, 0.0])
    for name in ("x", "y"):
        other_log(tmp_path / "b" / f"{name}.metrics.parquet")
    code, _, error = compare(capsys, ours, tmp_path / "b")
    assert code == 1
    assert "no run here has the log or the name of one in the reference" in error


def test_a_misspelt_name_is_an_error(reference, capsys):
    code, _, error = compare(capsys, reference, reference, "--ignore", "lame_*")
    assert (code, error) == (1, "error: lame_*: matches no field and no metric of these runs; check the spelling\n")


def test_a_new_reference_is_made_and_then_kept_up_to_date(tmp_path, capsys):
    kept, runs = tmp_path / "kept", folder(tmp_path / "runs", [0.0, 0.0])
    code, text, _ = compare(capsys, kept, runs, "--update-reference")
    assert code == 0
    assert text.count("reference: ") == 2
    assert compare(capsys, kept, runs, "--exact")[0] == 0
    before = {path: path.stat().st_mtime_ns for path in kept.rglob("*.parquet")}

    folder(runs, [0.0, 0.3, 0.0])
    assert compare(capsys, kept, runs)[0] == 1
    code, text, _ = compare(capsys, kept, runs, "--update-reference")
    assert code == 0
    assert re.findall(r"reference: .+kept/(\S+) is now", text) == [
        "part0/log1.metrics.parquet",
        "part1/log2.metrics.parquet",
    ]
    unchanged = kept / "part0" / "log0.metrics.parquet"
    assert unchanged.stat().st_mtime_ns == before[unchanged]
    assert compare(capsys, kept, runs, "--exact")[0] == 0
    assert "nothing to replace" in compare(capsys, kept, runs, "--update-reference")[1]


def test_a_table_as_reference_is_replaced(reference, capsys):
    candidate = other(reference, lane_left_error_m=pl.col("lane_left_error_m") + 0.01)
    assert compare(capsys, reference, candidate, "--update-reference")[0] == 0
    assert reference.read_bytes() == candidate.read_bytes()
    assert [path for path in reference.parent.iterdir() if path.name.startswith(".")] == []


def test_a_log_as_reference_is_not_updated(reference, capsys):
    code, _, error = compare(capsys, reference.with_name("a.mcap"), reference, "--update-reference")
    assert code == 1
    assert re.fullmatch(r"error: .*a\.mcap: is a log; to update a reference, .*\n", error)


def made_by(path, *settings):
    """The same table, carrying the configuration that made it."""
    facts = table_facts(path, path, load_config(settings=settings))
    pl.read_parquet(path).write_parquet(path, metadata=facts)
    return path


def test_of_several_pairs_the_settings_stand_once_for_those_that_share_them(tmp_path, capsys):
    for folder, hold_s in (("a", 0.5), ("b", 2.0)):
        for name, log_id in (("day", "d" * 16), ("night", "e" * 16), ("rain", "f" * 16)):
            (tmp_path / folder).mkdir(exist_ok=True)
            path = write(tmp_path / folder / f"{name}.metrics.parquet", [row(k, log_id=log_id) for k in range(3)])
            made_by(path, f"lanes.hold_s={0.5 if name == 'rain' else hold_s}")
    _, text, _ = compare(capsys, tmp_path / "a", tmp_path / "b")
    assert text.startswith(
        "settings that differ in day, night:\n  lanes.hold_s 0.5 → 2.0\n9 frames compared in 3 pairs"
    )
