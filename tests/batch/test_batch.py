"""Whole batches by the command: what they write, what they leave, and what failures become."""

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import polars as pl
import pytest

from roadperc_stream.log import summarise
from roadperc_stream.output.tables import read_footer
from roadperc_stream.schemas.columns.runs import RUN_TIME_COLUMNS
from tests import logs
from tests.batch.dataset import assert_as_single, batch, change_rows, runs, statuses, write_log
from tests.commands import environment, words

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives")
    for number in range(4):
        write_log(folder / f"drive_{number}.mcap", frames=3 + number, lane_m=0.05 * number)
    return folder


def test_a_dataset_holds_the_rows_of_single_replays_and_says_how_each_was_made(drives, tmp_path):
    done = batch(tmp_path / "out", drives, "--jobs", "2")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0].startswith("4 logs done: 18 frames in ")
    assert done.stderr == ""
    for source in sorted(drives.glob("*.mcap")):
        assert_as_single(tmp_path / "out", source, tmp_path)
    every = pl.scan_parquet(tmp_path / "out/metrics/**/*.parquet", hive_partitioning=True).collect()
    assert every.height == 18
    assert every["config"].n_unique() == 1
    assert every["date"].unique().to_list() == [pl.Series(["2020-09-13"]).str.to_date()[0]]
    rows = runs(tmp_path / "out")
    assert rows["status"].to_list() == ["done"] * 4
    assert rows["frames"].to_list() == [3, 4, 5, 6]
    assert rows["attempts"].to_list() == [1] * 4
    assert (rows["peak_memory_mb"] > 50).all()
    assert (rows["seconds"] > 0).all()
    assert rows["date"].to_list() == ["2020-09-13"] * 4
    assert rows["duration_s"].to_list() == pytest.approx([0.1, 0.15, 0.2, 0.25])
    assert rows["size_bytes"].to_list() == [path.stat().st_size for path in sorted(drives.glob("*"))]
    assert (rows["total_s"] > rows["lanes_s"]).all()
    assert set(RUN_TIME_COLUMNS) <= set(rows.columns)


def test_a_second_run_does_nothing_and_a_new_configuration_stands_beside_the_first(drives, tmp_path):
    out = tmp_path / "out"
    batch(out, drives)
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}
    again = batch(out, drives)
    assert again.returncode == 0
    assert again.stdout.splitlines()[0].startswith("0 logs done, 4 left as they are: 0 frames")
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")} == before
    batch(out, drives / "drive_0.mcap", "--set", "lanes.hold_s=0.7")
    both = runs(out).filter(pl.col("name") == "drive_0.mcap")
    assert both["settings"].to_list().count("[lanes]\nhold_s = 0.7\n") == 1
    assert both["config"].n_unique() == 2
    assert len(list(out.glob("metrics/date=*/*.parquet"))) == 5


def test_failures_are_rows_and_the_rest_is_done(drives, tmp_path):
    folder, out = tmp_path / "in", tmp_path / "out"
    shutil.copytree(drives, folder)
    whole = (folder / "drive_3.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    (folder / "rubbish.mcap").write_bytes(b"rubbish" * 100)
    (folder / "nothing.mcap").write_bytes(b"")
    write_log(folder / "frameless.mcap", frames=0)
    done = batch(out, folder)
    assert done.returncode == 1
    assert done.stdout.splitlines()[0].startswith("4 logs done, 4 failed: 18 frames")
    assert done.stderr == f"error: {out}: 4 of 8 logs failed; runs.parquet there says how\n"
    failed = {"cut.mcap": "damaged", "rubbish.mcap": "damaged", "nothing.mcap": "empty", "frameless.mcap": "unfit"}
    assert statuses(out) == failed | {f"drive_{number}.mcap": "done" for number in range(4)}
    errors = dict(runs(out).select("name", "error").iter_rows())
    assert "damaged at byte" in errors["cut.mcap"]
    assert errors["drive_0.mcap"] is None

    again = batch(out, folder)  # they have not changed
    assert again.returncode == 1
    assert again.stdout.splitlines()[0].startswith("0 logs done, 4 left as they are, 4 failed")
    assert "rubbish.mcap" in again.stdout

    shutil.copy(folder / "drive_2.mcap", folder / "rubbish.mcap")
    plan = batch(out, folder, "--dry-run")
    assert f"replay  {folder}/rubbish.mcap: was damaged, and the file has changed\n" in plan.stdout
    batch(out, folder)
    assert statuses(out) == {name: s for name, s in failed.items() if name != "rubbish.mcap"} | {
        f"drive_{number}.mcap": "done" for number in range(4)
    }
    (row,) = runs(out).filter(pl.col("name") == "drive_2.mcap").to_dicts()
    assert sorted(name.rpartition("/")[2] for name in row["names"]) == ["drive_2.mcap", "rubbish.mcap"]


def test_recover_takes_the_damaged_ones_alone(drives, tmp_path):
    folder, out = tmp_path / "in", tmp_path / "out"
    shutil.copytree(drives, folder)
    whole = SAMPLE.read_bytes()
    (folder / "cut.mcap").write_bytes(whole[: len(whole) // 4])
    batch(out, folder)
    done = batch(out, folder, "--recover")
    assert done.stdout.splitlines()[0].startswith("1 log done, 4 left as they are")
    (row,) = runs(out).filter(pl.col("name") == "cut.mcap").to_dicts()
    assert row["status"] == "done"
    assert any("damaged" in text for text in row["warnings"])
    assert batch(out, folder, "--recover").stdout.startswith("0 logs done, 5 left")


def test_a_copy_a_touched_file_and_verify_are_not_replayed_again(drives, tmp_path):
    folder, out = tmp_path / "in", tmp_path / "out"
    shutil.copytree(drives, folder)
    batch(out, folder)
    tables = {path: path.stat().st_mtime_ns for path in out.glob("metrics/*/*.parquet")}
    shutil.copy(folder / "drive_1.mcap", folder / "another.mcap")
    os.utime(folder / "drive_2.mcap")
    plan = batch(out, folder, "--dry-run").stdout
    assert f"check  {folder}/drive_2.mcap: the file has changed\n" in plan
    assert f"replay  {folder}/another.mcap: is new\n" in plan
    batch(out, folder)
    assert {path: path.stat().st_mtime_ns for path in out.glob("metrics/*/*.parquet")} == tables
    assert runs(out).height == 4
    assert batch(out, folder).stdout.startswith("0 logs done, 5 left")
    verified = batch(out, folder, "--verify")
    assert verified.stdout.startswith("5 logs done")
    assert {path: path.stat().st_mtime_ns for path in out.glob("metrics/*/*.parquet")} == tables


def test_changed_content_that_size_and_time_do_not_show_is_found_by_verify(tmp_path):
    folder, out = tmp_path / "in", tmp_path / "out"
    write_log(folder / "a.mcap")
    batch(out, folder)
    facts = write_log(folder / "a.mcap", lane_m=0.3).stat()
    unchanged = [f"{facts.st_size}:{facts.st_mtime_ns}"]
    change_rows(out, fingerprints=pl.lit(unchanged))
    assert batch(out, folder).stdout.startswith("0 logs done")
    assert batch(out, folder, "--verify").stdout.startswith("1 log done")
    assert runs(out).height == 2
    (named,) = (row["names"] for row in runs(out).to_dicts() if row["names"])
    assert named == [str(folder / "a.mcap")]
    assert_as_single(out, folder / "a.mcap", tmp_path)


def test_result_logs_on_request(drives, tmp_path):
    out = tmp_path / "out"
    batch(out, drives / "drive_0.mcap")
    assert not (out / "logs").exists()
    plan = batch(out, drives / "drive_0.mcap", "--logs", "--dry-run").stdout
    assert "has no such result log" in plan
    batch(out, drives / "drive_0.mcap", "--logs")
    (log,) = out.glob("logs/date=*/*.mcap")
    topics = {channel.topic for channel in summarise(log).channels}
    assert {"/camera/front/image", "/perception/lanes"} <= topics
    (table,) = out.glob("metrics/date=*/*.parquet")
    facts = read_footer(table).facts
    assert (facts["log"], facts["source"]) == (str(log), str(drives / "drive_0.mcap"))
    assert "has no such" in batch(out, drives / "drive_0.mcap", "--logs", "--results-only", "--dry-run").stdout
    assert batch(out, drives / "drive_0.mcap").stdout.startswith("0 logs done, 1 left")


def test_parts_of_a_drive_are_joined(tmp_path):
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    items = logs.items(8)
    middle = len(items) // 2
    logs.write(folder / "town_9.mcap", items[:middle])
    logs.write(folder / "town_10.mcap", items[middle:])
    write_log(folder / "other.mcap")
    batch(out, folder, "--join", r"_\d+$")
    rows = runs(out)
    assert rows["name"].to_list() == ["other.mcap", "town_9.mcap"]
    assert rows["frames"].to_list() == [4, 8]


def test_globs_and_what_is_not_there(drives, tmp_path):
    assert batch(tmp_path / "b", f"{drives}/drive_[23].mcap", "--dry-run").stdout.count("replay  ") == 2
    missing = batch(tmp_path / "c", drives / "none.mcap")
    assert missing.returncode == 1
    assert "none.mcap" in missing.stderr
    assert batch(tmp_path / "c", f"@{tmp_path}/none.txt").returncode == 1


@pytest.mark.parametrize(
    "options", ["--results-only", "--memory lots", "--join (", "--retries -1", "--timeout 0", "--split 9"]
)
def test_options_that_make_no_sense(drives, tmp_path, options):
    done = batch(tmp_path / "out", drives, *options.split())
    assert done.returncode == 2
    assert not (tmp_path / "out").exists()


def test_a_timeout_and_too_little_memory_are_rows_that_are_tried_again(drives, tmp_path):
    out = tmp_path / "out"
    batch(out, drives / "drive_0.mcap")
    slow = write_log(tmp_path / "slow.mcap", frames=100)
    assert batch(out, slow, drives / "drive_0.mcap", "--timeout", "0.05").returncode == 1
    assert statuses(out) == {"drive_0.mcap": "done", "slow.mcap": "timeout"}
    assert batch(out, slow, drives / "drive_0.mcap", "--memory", "20MB").returncode == 1
    assert statuses(out) == {"drive_0.mcap": "done", "slow.mcap": "memory"}
    assert "held more than the 20 MB of --memory" in runs(out).filter(pl.col("name") == "slow.mcap")["error"][0]
    assert batch(out, slow, "--dry-run").stdout.startswith(f"replay  {slow}: failed before: memory")
    assert batch(out, slow).returncode == 0
    assert_as_single(out, slow, tmp_path)


@pytest.mark.promise("Crashes", "A log that crashes its worker is a row in `runs.parquet` with the error and its place")
@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("os.abort()", "SIGABRT: {}Aborted"),
        ("ctypes.pythonapi.Py_FatalError(b'no state')", "SIGABRT: {}no state"),
        ("faulthandler._sigsegv()", "SIGSEGV: {}Segmentation fault"),
    ],
)
def test_the_row_of_a_log_that_crashes_its_worker_says_how(drives, tmp_path, code, said):
    """In the process from which workers are forked something else does their work."""
    tmp_path.joinpath("sitecustomize.py").write_text(
        "import ctypes, faulthandler, os, sys\n"
        "def dies(task, progress):\n"
        "    os.write(2, b'one line\\nfree(): invalid pointer\\n')\n"
        f"    {code}\n"
        "if any('forkserver' in word for word in sys.orig_argv):\n"
        "    import roadperc_stream.batch.worker as worker\n"
        "    worker.work = dies\n"
    )
    out = tmp_path / "out"
    done = batch(out, drives / "drive_0.mcap", "--retries", "0", env=environment(PYTHONPATH=str(tmp_path)))
    assert done.returncode == 1
    (row,) = runs(out).to_dicts()
    where = f'File "{tmp_path}/sitecustomize.py", line 4 in dies'
    said = said.format("free(): invalid pointer: Fatal Python error: ")
    assert (row["status"], row["error"]) == ("killed", f"its process ended by {said}: {where}")
    assert row["error"] in done.stdout
    (printed,) = (out / "log").iterdir()
    assert "free(): invalid pointer\nFatal Python error: " in printed.read_text()


def test_a_batch_that_is_killed_goes_on(drives, tmp_path):
    out, folder = tmp_path / "out", tmp_path / "in"
    for number in range(6):
        write_log(folder / f"{number}.mcap", frames=30, lane_m=0.03 * number)
    process = subprocess.Popen(words("roadperc-batch", out, folder, "--jobs", "1"), stdout=subprocess.DEVNULL)
    while not list(out.glob("metrics/*/*.parquet")):
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = batch(out, folder)
    assert done.returncode == 0
    assert set(statuses(out).values()) == {"done"}
    for source in sorted(folder.glob("*.mcap")):
        assert_as_single(out, source, tmp_path)
    assert not list((out / ".work").iterdir())


def test_a_name_that_is_no_text_is_a_row_like_others(tmp_path):
    out, folder = tmp_path / "out", tmp_path / "in"
    write_log(folder / "good.mcap")
    for name in (b"\xff.mcap", b"\xfe_0.mcap"):
        (folder / os.fsdecode(name)).write_bytes(b"rubbish")
    done = batch(out, folder, "--join", r"_\d+$")
    assert done.returncode == 1
    assert statuses(out) == {"good.mcap": "done", "\\udcff.mcap": "damaged", "\\udcfe_0.mcap": "damaged"}
    assert batch(out, folder, "--join", r"_\d+$").stdout.startswith("0 logs done, 1 left as they are, 2 failed")


def test_rows_of_a_batch_that_was_killed_come_into_the_list(drives, tmp_path):
    out = tmp_path / "out"
    batch(out, drives)
    (out / "runs").mkdir(exist_ok=True)
    (out / "runs.parquet").rename(out / "runs" / "20260101T000000Z-elsewhere-1.parquet")
    assert batch(out, drives).stdout.startswith("0 logs done, 4 left")
    assert runs(out).height == 4
