"""Whole sweeps: rows equal those of replays, and failures leave no files."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from roadperc_stream.cli.sweep import main
from roadperc_stream.config import load_config
from roadperc_stream.eval.runs import find_runs
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.system.time import TimeRange
from tests import logs
from tests.eval.tables import usage_error
from tests.replaying import replay

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"
LANES = ("--vary", "lanes.process_noise=0.1,1")
SURFACE = ("--vary", "surface.inlier_m=0.03,0.05")


@pytest.fixture
def source(tmp_path):
    return logs.write(tmp_path / "in.mcap", logs.items(4))


def sweep(source, out, *options):
    assert main([str(source), "--out", str(out), "--jobs", "1", *options]) == 0
    return pl.scan_parquet(f"{out}/**/*.parquet").collect()


def without_times(table, *parameters):
    return table.drop(*TIME_COLUMNS, *parameters)


def failed(capsys, *arguments):
    assert main([str(argument) for argument in arguments]) == 1
    return capsys.readouterr().err


def test_rows_equal_those_of_replays_with_the_same_settings(tmp_path):
    """With truth, stereo and random numbers, and a setting that decides which messages form a frame."""
    options = ("--vary", "surface.inlier_m=0.01,0.05", "--vary", "sync.tolerance_s=0,0.01", "--set", "seed=3")
    swept = sweep(SAMPLE, tmp_path / "out", *options, "--frames", "3")
    for inlier_m, tolerance_s in ((0.01, 0.0), (0.05, 0.01)):
        settings = (f"surface.inlier_m={inlier_m}", f"sync.tolerance_s={tolerance_s}", "seed=3")
        replay(SAMPLE, tmp_path / "one.mcap", load_config(None, settings), time_range=TimeRange(frames=3), force=True)
        rows = swept.filter(pl.col("surface.inlier_m") == inlier_m, pl.col("sync.tolerance_s") == tolerance_s)
        expected = pl.read_parquet(sidecar_path(tmp_path / "one.mcap", "metrics"))
        assert rows.height == 3
        rows = without_times(rows, "surface.inlier_m", "sync.tolerance_s")
        assert_frame_equal(rows, without_times(expected), check_exact=True)
    assert swept["surface_angle_error_deg"].n_unique() > 3


def test_settings_are_columns_of_their_types(source, tmp_path):
    options = ("lanes.hold_s=1,2", "surface.hypotheses=8", "lanes.use_odometry=false", "stereo.disparities=64,auto")
    swept = sweep(source, tmp_path / "out", *(f"--vary={option}" for option in options))
    assert swept.height == 4 * 4
    columns = swept.select("lanes.hold_s", "surface.hypotheses", "lanes.use_odometry", "stereo.disparities")
    assert columns.dtypes == [pl.Float64, pl.Int64, pl.Boolean, pl.String]
    assert columns.unique().height == 4
    assert columns.unique("stereo.disparities")["stereo.disparities"].sort().to_list() == ["64", "auto"]


def test_a_table_has_its_configuration_and_the_report_reads_it(source, tmp_path):
    sweep(source, tmp_path / "out", *LANES)
    runs = find_runs([str(tmp_path / "out")])
    replay(source, tmp_path / "one.mcap", load_config(None, ("lanes.process_noise=1",)))
    (one,) = find_runs([str(tmp_path / "one.mcap")])
    assert [run.name for run in runs] == ["0000/in", "0001/in"]
    assert (runs[1].config_digest, runs[1].version) == (one.config_digest, one.version)
    assert load_config(tmp_path / "out" / "0001" / "roadperc.toml").lanes.process_noise == 1.0
    assert runs[0].frames == 4


def test_two_processes_give_the_same_tables_as_one(source, tmp_path, capsys):
    other = tmp_path / "b" / "in.mcap"
    other.parent.mkdir()
    logs.write(other, logs.items(2))
    for jobs in (1, 2):
        out = tmp_path / f"out{jobs}"
        assert main([*map(str, (source, other)), *LANES, "--out", str(out), "--jobs", str(jobs)]) == 0
    one, two = (pl.scan_parquet(f"{tmp_path}/out{jobs}/**/*.parquet").collect() for jobs in (1, 2))
    assert_frame_equal(without_times(one), without_times(two), check_exact=True)
    assert one.height == 2 * (4 + 2)
    assert capsys.readouterr().out.count("4 tables") == 2


def test_best_settings_are_printed_beside_the_reference(tmp_path, capsys):
    sweep(SAMPLE, tmp_path / "out", *LANES, "--vary", "surface.inlier_m=0.05,0.01", "--vary", "seed=0", "--frames", "3")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("4 settings, reference lanes.process_noise=0.1 surface.inlier_m=0.05 seed=0")
    assert [line for line in lines if line.endswith("changed nothing")] == ["lanes.process_noise changed nothing"]
    angle = next(line.split() for line in lines if line.startswith("surface angle"))
    assert angle[-1] == "reference"
    assert angle[4] == angle[6]
    assert any(line.startswith("no difference: ") for line in lines)
    assert max(len(line) for line in lines[1:]) <= 80


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "--vary"),
        (("--vary", "lanes.gate"), "expected KEY=VALUE,VALUE"),
        (("--vary", "lanes.gate=1,2,1.0"), "contains a value twice"),
        (("--vary", "lanes.gate=1", "--vary", "lanes.gate=2"), "lanes.gate is varied twice"),
        (("--vary", "lanes.gate=1,2", "--jobs", "0"), "expected a whole number of 1 or more"),
    ],
)
def test_wrong_usage(source, tmp_path, capsys, options, said):
    assert said in usage_error(main, capsys, source, "--out", tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()
    assert "is given twice" in usage_error(main, capsys, source, source.parent / "." / source.name, *LANES)


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("lanes.process_nose=1,2", "did you mean lanes.process_noise?"),
        ("lanes.process_noise=0.1,x", "lanes.process_noise: expected a number 0.001 to 100 (m/s), found"),
        (LANES[1], "none.mcap: no such file\n"),
    ],
)
def test_invalid_values_and_missing_logs_are_errors_before_any_replay(tmp_path, capsys, option, said):
    err = failed(capsys, tmp_path / "none.mcap", "--out", tmp_path / "out", "--vary", option)
    assert (said in err, err.count("\n")) == (True, 1)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_log_that_fails_leaves_no_files(source, tmp_path, capsys, jobs):
    (tmp_path / "bad.mcap").write_bytes(source.read_bytes()[:3000])
    err = failed(capsys, source, tmp_path / "bad.mcap", "--out", tmp_path / "out", "--jobs", jobs, *LANES)
    assert "bad.mcap: damaged at byte" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.mcap", "in.mcap"]


def test_an_earlier_sweep_is_replaced_only_with_force_and_success(source, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    before = sweep(source, out, "--vary", "lanes.gate=1,2,3")
    assert "exists; pass --force to overwrite it" in failed(capsys, source, "--out", out, *LANES)
    (tmp_path / "bad.mcap").write_bytes(b"no log")
    failed(capsys, tmp_path / "bad.mcap", "--out", out, *LANES, "--force")
    assert_frame_equal(pl.scan_parquet(f"{out}/**/*.parquet").collect(), before)
    assert sweep(source, out, *LANES, "--force").height == 2 * 4
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.mcap", "in.mcap", "out"]


def test_other_files_are_never_replaced(source, tmp_path, capsys):
    err = failed(capsys, source, "--out", tmp_path, *LANES, "--force")
    assert "the folder holds other files" in err
    err = failed(capsys, source, "--out", source, *LANES, "--force")
    assert "is a file" in err
    assert source.is_file()


@pytest.fixture(scope="module")
def long_logs(tmp_path_factory):
    """Two logs, long enough for a signal during their sweep."""
    folder = tmp_path_factory.mktemp("long")
    return [logs.write(folder / f"in{k}.mcap", logs.items(100)) for k in range(2)]


@pytest.mark.parametrize(("number", "jobs"), [(signal.SIGINT, 2), (signal.SIGTERM, 1), (signal.SIGHUP, 1)])
def test_a_signal_leaves_no_files(long_logs, tmp_path, number, jobs):
    """All processes receive the signal, as with Ctrl-C in a terminal."""
    command = [sys.executable, "-c", "import sys; from roadperc_stream.cli.launch import sweep; sys.exit(sweep())"]
    options = [*map(str, long_logs), *LANES, "--out", str(tmp_path / "out"), "--jobs", str(jobs)]
    process = subprocess.Popen([*command, *options], stderr=subprocess.PIPE, text=True, start_new_session=True)
    while process.poll() is None and not list(tmp_path.glob(".out*/000*/.*")):
        time.sleep(0.01)
    os.killpg(process.pid, number)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (1, "error: interrupted\n")
    assert not list(tmp_path.iterdir())
