"""A batch again, over logs and datasets to which something happened: what was done counts while it is true."""

import os
import shutil
from contextlib import nullcontext

import polars as pl
import pytest

from roadperc_stream.batch import worker
from roadperc_stream.batch.driver import BatchRun
from roadperc_stream.batch.storage.location import Location, find_files
from roadperc_stream.batch.task import BatchConfiguration, BatchJob, DriveFiles, Outcome, Task
from roadperc_stream.config import load_config
from roadperc_stream.system.progress import no_progress
from roadperc_stream.system.time import TimeRange
from tests.batch.backends import Scripted
from tests.batch.dataset import assert_as_single, batch, change_rows, runs, statuses, write_log


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def task(source, out, scratch=None, **how):
    out.mkdir(exist_ok=True)
    configuration = BatchConfiguration(load_config(None), **how)
    return Task(
        DriveFiles(tuple(find_files(str(source)))), BatchJob(configuration, Location(str(out)), scratch=scratch)
    )


def test_numbers_that_hardly_differ_are_other_configurations():
    ends_s = [0.2, 0.1999999, 0.2000001, 1234.561, 1234.564]
    configs = [BatchConfiguration(load_config(None), time_range=TimeRange(None, end_s)) for end_s in ends_s]
    assert len({how.name for how in configs}) == len(ends_s)


@pytest.mark.parametrize("change", ["replaced", "cut off"])
def test_a_log_that_changes_during_its_replay_is_unreachable_and_has_no_tables(tmp_path, out, monkeypatch, change):
    source = write_log(tmp_path / "in" / "a.mcap")
    other = write_log(tmp_path / "other.mcap", lane_m=0.2)

    def changed(*given, **options):
        if change == "replaced":
            other.rename(source)
        else:
            source.write_bytes(source.read_bytes()[:-3000])
        return replay(*given, **options)

    replay = worker.replay
    monkeypatch.setattr(worker, "replay", changed)
    outcome = worker.work(task(source, out), no_progress)
    assert (outcome.status, outcome.error) == ("unreachable", f"{source}: changed while it was replayed")
    assert not list(out.glob("metrics/*/*"))


def test_a_clock_that_was_set_back_hides_nothing(tmp_path, out):
    source = write_log(tmp_path / "in" / "a.mcap")
    batch(out, source)
    change_rows(out, finished_ns=pl.col("finished_ns") + 24 * 3600 * 10**9)
    shutil.rmtree(out / "metrics")
    assert batch(out, source).stdout.startswith("1 log done: 4 frames")
    write_log(source, lane_m=0.3)
    assert batch(out, source).stdout.startswith("1 log done: 4 frames")
    assert batch(out, source).stdout.startswith("0 logs done, 1 left")
    assert sorted(map(len, runs(out)["names"])) == [0, 1]
    assert_as_single(out, source, tmp_path)


def test_the_path_of_a_log_is_one_that_it_still_has(tmp_path, out):
    folder = tmp_path / "in"
    one, other = write_log(folder / "a.mcap"), write_log(folder / "b.mcap", frames=5)
    batch(out, folder)
    one.rename(folder / "c")
    other.rename(one)
    (folder / "c").rename(other)
    batch(out, folder)
    assert {row["path"]: (row["names"], row["frames"]) for row in runs(out).to_dicts()} == {
        str(one): ([str(one)], 5),
        str(other): ([str(other)], 4),
    }


def test_a_table_with_nothing_in_it_is_none(tmp_path, out):
    source = write_log(tmp_path / "in" / "a.mcap")
    batch(out, source)
    (table,) = out.glob("metrics/*/*.parquet")
    table.write_bytes(b"")
    assert batch(out, source).stdout.startswith("1 log done: 4 frames")
    assert_as_single(out, source, tmp_path)


def test_a_check_that_fails_leaves_what_is_done_as_it_is(tmp_path, out):
    source = write_log(tmp_path / "in" / "a.mcap")
    batch(out, source)
    job = BatchJob(BatchConfiguration(load_config(None)), Location(str(out)), verify=True)
    verifying = BatchRun(job, [str(source)], None)
    verifying.run(lambda: Scripted(lambda _: Outcome("timeout", "took too long")), lambda: nullcontext(lambda _: None))
    assert sorted(row["status"] for row in runs(out).to_dicts()) == ["done", "timeout"]
    assert set(runs(out)["names"].list.len()) == {1}
    written = [path.stat().st_mtime_ns for path in out.glob("metrics/*/*")]
    assert batch(out, source).stdout.startswith("1 log done: 0 frames")
    assert [path.stat().st_mtime_ns for path in out.glob("metrics/*/*")] == written
    assert statuses(out) == {"a.mcap": "done"}


def test_a_recovered_log_is_looked_at_as_it_was_replayed(tmp_path, out):
    source = write_log(tmp_path / "in" / "a.mcap", frames=12)
    source.write_bytes(source.read_bytes()[:-4000])
    assert batch(out, source, "--recover").returncode == 0
    before = runs(out)
    for option in ("--verify", "--recover"):
        assert batch(out, source, option).returncode == 0
    os.utime(source)
    assert batch(out, source).stdout.startswith("1 log done: 0 frames")
    assert (
        runs(out)
        .drop("names", "fingerprints", "finished_ns")
        .equals(before.drop("names", "fingerprints", "finished_ns"))
    )


def test_a_link_that_leads_nowhere_is_a_log_that_is_not_to_be_had(tmp_path, out):
    """Others in its folder are; to itself, to what is gone, or behind a disk that is not there today."""
    source = write_log(tmp_path / "in" / "a.mcap")
    gone, back = source.with_name("gone.mcap"), tmp_path / "elsewhere.mcap"
    (source.parent / "loop.txt").symlink_to("loop.txt")
    (source.parent / "loop.mcap").symlink_to("loop.mcap")
    gone.symlink_to(back)
    once = batch(out, source.parent, "--retries", 0)
    assert (once.returncode, once.stdout.partition(":")[0]) == (1, "1 log done, 2 failed")
    assert statuses(out) == {"a.mcap": "done", "gone.mcap": "unreachable", "loop.mcap": "unreachable"}
    assert set(runs(out).filter(status="unreachable")["error"].str.split(": ").list.first()) == {
        str(source.with_name("loop.mcap")),
        str(gone),
    }
    (source.parent / "loop.mcap").unlink()
    write_log(back, lane_m=0.2)
    assert batch(out, source.parent).stdout.startswith("1 log done, 1 left")
    assert statuses(out)["gone.mcap"] == "done"


def test_result_logs_are_no_input_by_whatever_name_the_dataset_goes(tmp_path):
    real, link = tmp_path / "real", tmp_path / "link"
    write_log(real / "a.mcap")
    link.symlink_to(real)
    for _ in range(2):
        batch(link / "out", real, "--logs")
    assert runs(real / "out").height == 1
    nothing = batch(link / "out", real / "out" / "logs")
    assert (nothing.returncode, nothing.stderr.count("\n")) == (1, 1)
    assert "no log but those of the dataset itself" in nothing.stderr


def test_a_list_from_elsewhere(tmp_path, out):
    source, listed = write_log(tmp_path / "in" / "a.mcap"), tmp_path / "list.txt"
    listed.write_text(f"\ufeff{source}\r\n# more\r\n\r\n", encoding="utf-8")
    assert batch(out, f"@{listed}").stdout.startswith("1 log done")
    listed.write_text("# none\n")
    nothing = batch(out, f"@{listed}")
    assert (nothing.returncode, nothing.stderr) == (1, f"error: @{listed}: names no log\n")


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (lambda rows: rows.with_columns(finished_ns=pl.lit("today")), "is not a list of runs"),
        (lambda rows: rows.with_columns(finished_ns=None), "is not a list of runs"),
        (lambda rows: rows.with_columns(names=None), "is not a list of runs"),
        (lambda rows: rows.with_columns(fingerprints=pl.lit([], pl.List(pl.String))), "is not a list of runs"),
        (lambda rows: rows.with_columns(path=None), "is not a list of runs"),
        (lambda rows: rows.drop("logs"), "has no column logs; another version of this program wrote it\n"),
    ],
)
def test_a_list_of_runs_with_other_values_or_columns_is_a_one_line_error(tmp_path, out, change, error):
    source, path = write_log(tmp_path / "in" / "a.mcap"), out / "runs.parquet"
    batch(out, source)
    change(pl.read_parquet(path)).write_parquet(path)
    refused = batch(out, source)
    assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)
    assert refused.stderr.startswith(f"error: {path}: {error}")


def test_a_status_of_another_version_is_no_reason_to_leave_a_log(tmp_path, out):
    source = write_log(tmp_path / "in" / "a.mcap")
    batch(out, source)
    change_rows(out, status=pl.lit("lost"))
    assert batch(out, source).returncode == 0
    assert statuses(out) == {"a.mcap": "done"}


def test_a_folder_for_temporary_files_that_cannot_be_is_an_error_at_once(tmp_path, out):
    source = write_log(tmp_path / "in" / "a.mcap")
    (tmp_path / "file").touch()
    refused = batch(out, source, "--scratch", tmp_path / "file" / "a")
    assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)
    assert str(tmp_path / "file") in refused.stderr
