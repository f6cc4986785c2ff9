"""Whole batches: what they write, what they skip, and the rows of failed logs."""

import os
import shutil
import signal
import subprocess
import time

import polars as pl
import pytest

from roadperc_stream.log import summarise
from roadperc_stream.output.tables import read_footer
from roadperc_stream.schemas.columns.runs import RUN_TIME_COLUMNS
from tests import logs
from tests.batch.dataset import assert_as_single, batch, runs, statuses, write_log, written
from tests.commands import environment, words
from tests.test_sample import SAMPLE

FRAMES = [3, 4, 5]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for number, frames in enumerate(FRAMES):
        write_log(folder / f"log_{number}.mcap", frames, lane_m=0.05 * number)
    return folder


@pytest.fixture(scope="module")
def dataset(folder, tmp_path_factory):
    """A dataset of all logs, not to be changed, and the output of the command."""
    out = tmp_path_factory.mktemp("dataset") / "out"
    return out, batch(out, folder, "--jobs", "2")


@pytest.fixture
def out(dataset, tmp_path):
    """A copy of the dataset."""
    return shutil.copytree(dataset[0], tmp_path / "out")


def test_a_dataset_has_the_rows_of_single_replays_and_a_row_per_log(folder, dataset, tmp_path):
    out, done = dataset
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    assert done.stdout.splitlines()[0].startswith("3 logs done: 12 frames in ")
    sources = sorted(folder.glob("*.mcap"))
    for source in sources:
        assert_as_single(out, source, tmp_path)
    every = pl.scan_parquet(out / "metrics/**/*.parquet", hive_partitioning=True).collect()
    assert (every.height, every["config"].n_unique()) == (12, 1)
    assert every["date"].unique().to_list() == [pl.Series(["2020-09-13"]).str.to_date()[0]]
    rows = runs(out)
    assert rows["status"].to_list() == ["done"] * 3
    assert rows["frames"].to_list() == FRAMES
    assert rows["attempts"].to_list() == [1] * 3
    assert (rows["peak_memory_mb"] > 50).all()
    assert (rows["seconds"] > 0).all()
    assert rows["date"].to_list() == ["2020-09-13"] * 3
    assert rows["duration_s"].to_list() == pytest.approx([0.1, 0.15, 0.2])
    assert rows["size_bytes"].to_list() == [path.stat().st_size for path in sources]
    assert (rows["total_s"] > rows["lanes_s"]).all()
    assert set(RUN_TIME_COLUMNS) <= set(rows.columns)


def test_a_second_run_skips_all_and_a_new_configuration_is_added(folder, out):
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}
    again = batch(out, folder)
    assert again.returncode == 0
    assert again.stdout.splitlines()[0].startswith("0 logs done, 3 skipped: 0 frames")
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")} == before
    batch(out, folder / "log_0.mcap", "--set", "lanes.hold_s=0.7")
    both = runs(out).filter(pl.col("name") == "log_0.mcap")
    assert both["settings"].to_list().count("[lanes]\nhold_s = 0.7\n") == 1
    assert both["config"].n_unique() == 2
    assert len(written(out)) == 4


def test_failed_logs_are_rows_and_the_others_are_done(folder, tmp_path):
    source, out = tmp_path / "in", tmp_path / "out"
    good = shutil.copy(folder / "log_2.mcap", write_log(source / "good.mcap"))
    content = good.read_bytes()
    (source / "cut.mcap").write_bytes(content[: len(content) // 2])
    (source / "rubbish.mcap").write_bytes(b"rubbish" * 100)
    (source / "nothing.mcap").write_bytes(b"")
    write_log(source / "frameless.mcap", frames=0)
    done = batch(out, source)
    assert done.returncode == 1
    assert done.stdout.splitlines()[0].startswith("1 log done, 4 failed: 5 frames")
    assert done.stderr == f"error: {out}: 4 of 5 logs failed; see status and error in runs.parquet\n"
    failed = {"cut.mcap": "damaged", "rubbish.mcap": "damaged", "nothing.mcap": "empty", "frameless.mcap": "unfit"}
    assert statuses(out) == failed | {"good.mcap": "done"}
    errors = dict(runs(out).select("name", "error").iter_rows())
    assert "damaged at byte" in errors["cut.mcap"]
    assert errors["good.mcap"] is None

    again = batch(out, source)
    assert again.returncode == 1
    assert again.stdout.splitlines()[0].startswith("0 logs done, 1 skipped, 4 failed")
    assert "rubbish.mcap" in again.stdout

    shutil.copy(good, source / "rubbish.mcap")
    plan = batch(out, source, "--dry-run")
    assert f"replay  {source}/rubbish.mcap: was damaged, and the file has changed\n" in plan.stdout
    batch(out, source)
    del failed["rubbish.mcap"]
    assert statuses(out) == failed | {"good.mcap": "done"}
    (row,) = runs(out).filter(pl.col("name") == "good.mcap").to_dicts()
    assert sorted(name.rpartition("/")[2] for name in row["names"]) == ["good.mcap", "rubbish.mcap"]


def test_recover_replays_only_damaged_logs(folder, tmp_path, out):
    content = SAMPLE.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: len(content) // 8])
    batch(out, folder, cut)
    done = batch(out, folder, cut, "--recover")
    assert done.stdout.splitlines()[0].startswith("1 log done, 3 skipped")
    (row,) = runs(out).filter(pl.col("name") == "cut.mcap").to_dicts()
    assert row["status"] == "done"
    assert any("damaged" in text for text in row["warnings"])
    assert batch(out, folder, cut, "--recover").stdout.startswith("0 logs done, 4 skipped")


def test_a_copy_a_touched_file_and_verify_replay_nothing(tmp_path):
    source, out = tmp_path / "in", tmp_path / "out"
    first, second = write_log(source / "a.mcap", 3), write_log(source / "b.mcap", 3, lane_m=0.1)
    batch(out, source)
    before = written(out)
    shutil.copy(first, source / "copy.mcap")
    os.utime(second)
    plan = batch(out, source, "--dry-run").stdout
    assert f"check  {second}: the file has changed\n" in plan
    assert f"replay  {source}/copy.mcap: is new\n" in plan
    batch(out, source)
    assert (runs(out).height, written(out)) == (2, before)
    assert batch(out, source).stdout.startswith("0 logs done, 3 skipped")
    assert batch(out, source, "--verify").stdout.startswith("3 logs done")
    assert written(out) == before


def test_result_logs_are_stored_on_request(folder, out):
    source = folder / "log_0.mcap"
    assert not (out / "logs").exists()
    assert "its result log is missing" in batch(out, source, "--logs", "--dry-run").stdout
    batch(out, source, "--logs")
    (log,) = out.glob("logs/date=*/*.mcap")
    topics = {channel.topic for channel in summarise(log).channels}
    assert {"/camera/front/image", "/perception/lanes"} <= topics
    (table,) = out.glob(f"metrics/date=*/{log.name.removesuffix('.mcap')}.parquet")
    facts = read_footer(table).facts
    assert (facts["log"], facts["source"]) == (str(log), str(source))
    assert "result log is missing" in batch(out, source, "--logs", "--results-only", "--dry-run").stdout
    assert batch(out, source).stdout.startswith("0 logs done, 1 skipped")


def test_files_of_one_log_are_joined_and_names_may_be_bytes(tmp_path):
    source, out = tmp_path / "in", tmp_path / "out"
    write_log(source / "other.mcap")
    items = logs.items(8)
    logs.write(source / "town_9.mcap", items[: len(items) // 2])
    logs.write(source / "town_10.mcap", items[len(items) // 2 :])
    for name in (b"\xff.mcap", b"\xfe_0.mcap"):
        (source / os.fsdecode(name)).write_bytes(b"rubbish")
    assert batch(out, source, "--join", r"_\d+$").returncode == 1
    expected = {"other.mcap": "done", "town_9.mcap": "done", "\\udcff.mcap": "damaged", "\\udcfe_0.mcap": "damaged"}
    assert statuses(out) == expected
    assert runs(out).filter(status="done")["frames"].to_list() == [4, 8]
    assert batch(out, source, "--join", r"_\d+$").stdout.startswith("0 logs done, 2 skipped, 2 failed")


def test_globs_and_missing_logs(folder, tmp_path):
    assert batch(tmp_path / "b", f"{folder}/log_[12].mcap", "--dry-run").stdout.count("replay  ") == 2
    missing = batch(tmp_path / "c", folder / "none.mcap")
    assert (missing.returncode, "none.mcap" in missing.stderr) == (1, True)
    assert batch(tmp_path / "c", f"@{tmp_path}/none.txt").returncode == 1


@pytest.mark.parametrize("options", ["--results-only", "--memory lots", "--join (", "--join x*"])
def test_wrong_options_have_exit_code_2(folder, tmp_path, options):
    assert batch(tmp_path / "out", folder, *options.split()).returncode == 2
    assert not (tmp_path / "out").exists()


def test_a_timeout_and_too_little_memory_are_rows_that_are_retried(folder, tmp_path, out):
    good = folder / "log_0.mcap"
    slow = write_log(tmp_path / "slow.mcap", frames=40)
    assert batch(out, slow, good, "--timeout", "0.05").returncode == 1
    assert statuses(out)["slow.mcap"] == "timeout"
    assert batch(out, slow, good, "--memory", "20MB").returncode == 1
    assert (statuses(out)["log_0.mcap"], statuses(out)["slow.mcap"]) == ("done", "memory")
    (error,) = runs(out).filter(pl.col("name") == "slow.mcap")["error"]
    assert error.startswith("used ")
    assert error.endswith(" MB, more than the 20 MB of --memory")
    assert batch(out, slow, "--dry-run").stdout.startswith(f"replay  {slow}: failed before: memory")
    assert batch(out, slow).returncode == 0
    assert_as_single(out, slow, tmp_path)


def test_the_row_of_a_log_that_crashes_its_worker_names_its_output(folder, tmp_path):
    """The server that forks the workers replaces their function."""
    tmp_path.joinpath("sitecustomize.py").write_text(
        "import faulthandler, os, sys\n"
        "def dies(task, progress):\n"
        "    os.write(2, b'one line\\nfree(): invalid pointer\\n')\n"
        "    faulthandler._sigsegv()\n"
        "if any('forkserver' in word for word in sys.orig_argv):\n"
        "    import roadperc_stream.batch.worker as worker\n"
        "    worker.work = dies\n"
    )
    out = tmp_path / "out"
    done = batch(out, folder / "log_0.mcap", "--retries", "0", env=environment(PYTHONPATH=str(tmp_path)))
    assert done.returncode == 1
    (row,) = runs(out).to_dicts()
    (printed,) = (out / "log").iterdir()
    assert (row["status"], row["error"]) == ("killed", f"its process ended by SIGSEGV; see log/{printed.name}")
    assert row["error"] in done.stdout
    assert "free(): invalid pointer\nFatal Python error: Segmentation fault" in printed.read_text()


def test_a_killed_batch_continues(tmp_path):
    out, source = tmp_path / "out", tmp_path / "in"
    for number in range(3):
        write_log(source / f"{number}.mcap", frames=8, lane_m=0.03 * number)
    process = subprocess.Popen(words("roadperc-batch", out, source, "--jobs", "1"), stdout=subprocess.DEVNULL)
    while not written(out):
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert batch(out, source).returncode == 0
    assert set(statuses(out).values()) == {"done"}
    assert_as_single(out, source / "2.mcap", tmp_path)
    assert not list((out / ".work").iterdir())
