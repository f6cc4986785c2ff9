"""A batch again, after logs or the dataset have changed."""

import os

import polars as pl
import pytest

from roadperc_stream.batch import worker
from roadperc_stream.batch.location import Location, find_files
from roadperc_stream.batch.task import BatchConfiguration, BatchJob, LogFiles, Task
from roadperc_stream.config import load_config
from roadperc_stream.system.progress import no_progress
from roadperc_stream.system.time import TimeRange
from tests.batch.dataset import batch, runs, statuses, write_log, written

CONFIGURATION = BatchConfiguration(load_config(None))


@pytest.fixture
def source(tmp_path):
    return write_log(tmp_path / "in" / "a.mcap")


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def task(source, out, scratch=None):
    out.mkdir(exist_ok=True)
    return Task(LogFiles(tuple(find_files(str(source)))), BatchJob(CONFIGURATION, Location(str(out)), scratch=scratch))


def test_nearly_equal_numbers_are_different_configurations():
    ends_s = [0.2, 0.1999999, 0.2000001, 1234.561, 1234.564]
    configs = [BatchConfiguration(load_config(None), time_range=TimeRange(None, end_s)) for end_s in ends_s]
    assert len({config.name for config in configs}) == len(ends_s)


@pytest.mark.parametrize("change", ["replaced", "cut off"])
def test_a_log_that_changes_during_its_replay_is_unreachable_and_has_no_tables(
    tmp_path, source, out, monkeypatch, change
):
    other = write_log(tmp_path / "other.mcap", lane_m=0.2)

    def changed(*arguments, **options):
        if change == "replaced":
            other.rename(source)
        else:
            source.write_bytes(source.read_bytes()[:-3000])
        return replay(*arguments, **options)

    replay = worker.replay
    monkeypatch.setattr(worker, "replay", changed)
    outcome = worker.work(task(source, out), no_progress)
    error = f"{source}: changed while it was replayed; run the command again"
    assert (outcome.status, outcome.error) == ("unreachable", error)
    assert not written(out)


def test_the_path_of_a_log_is_one_of_its_current_names(tmp_path, source, out):
    other = write_log(source.with_name("b.mcap"), frames=5)
    batch(out, source.parent)
    source.rename(tmp_path / "c")
    other.rename(source)
    (tmp_path / "c").rename(other)
    batch(out, source.parent)
    assert {row["path"]: (row["names"], row["frames"]) for row in runs(out).to_dicts()} == {
        str(source): ([str(source)], 5),
        str(other): ([str(other)], 4),
    }


def test_a_recovered_log_is_checked_as_it_was_replayed(tmp_path, out):
    source = write_log(tmp_path / "in" / "a.mcap", frames=12)
    source.write_bytes(source.read_bytes()[:-4000])
    assert batch(out, source, "--recover").returncode == 0
    before = runs(out)
    for option in ("--verify", "--recover"):
        assert batch(out, source, option).returncode == 0
    os.utime(source)
    assert batch(out, source).stdout.startswith("1 log done: 0 frames")
    changing = ("names", "fingerprints", "finished_ns")
    assert runs(out).drop(changing).equals(before.drop(changing))


def test_a_dead_link_is_an_unreachable_log(tmp_path, source, out):
    dead, target = source.with_name("dead.mcap"), tmp_path / "elsewhere.mcap"
    (source.parent / "loop.txt").symlink_to("loop.txt")
    (source.parent / "loop.mcap").symlink_to("loop.mcap")
    dead.symlink_to(target)
    once = batch(out, source.parent, "--retries", 0)
    assert (once.returncode, once.stdout.partition(":")[0]) == (1, "1 log done, 2 failed")
    assert statuses(out) == {"a.mcap": "done", "dead.mcap": "unreachable", "loop.mcap": "unreachable"}
    errors = runs(out).filter(status="unreachable")["error"]
    assert set(errors.str.split(": ").list.first()) == {str(source.with_name("loop.mcap")), str(dead)}
    (source.parent / "loop.mcap").unlink()
    write_log(target, lane_m=0.2)
    assert batch(out, source.parent).stdout.startswith("1 log done, 1 skipped")
    assert statuses(out)["dead.mcap"] == "done"


def test_result_logs_of_the_dataset_are_no_inputs(tmp_path):
    real, link = tmp_path / "real", tmp_path / "link"
    write_log(real / "a.mcap")
    link.symlink_to(real)
    for _ in range(2):
        batch(link / "out", real, "--logs")
    assert runs(real / "out").height == 1
    nothing = batch(link / "out", real / "out" / "logs")
    assert (nothing.returncode, nothing.stderr.count("\n")) == (1, 1)
    assert "only result logs of this dataset" in nothing.stderr


def test_a_list_with_other_line_ends_and_a_list_without_logs(tmp_path, source, out):
    listed = tmp_path / "list.txt"
    listed.write_text(f"\ufeff{source}\r\n# more\r\n\r\n", encoding="utf-8")
    assert batch(out, f"@{listed}").stdout.startswith("1 log done")
    listed.write_text("# none\n")
    nothing = batch(out, f"@{listed}")
    assert (nothing.returncode, nothing.stderr) == (1, f"error: @{listed}: names no log\n")


def test_a_list_of_runs_with_wrong_values_or_columns_is_a_one_line_error(source, out):
    path = out / "runs.parquet"
    batch(out, source)
    rows = pl.read_parquet(path)
    for changed, error in (
        (rows.with_columns(finished_ns=pl.lit("today")), "not a list of runs"),
        (rows.with_columns(fingerprints=pl.lit([], pl.List(pl.String))), "not a list of runs"),
        (rows.drop("logs"), "has no column logs; another version of this program wrote it\n"),
    ):
        changed.write_parquet(path)
        refused = batch(out, source)
        assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)
        assert refused.stderr.startswith(f"error: {path}: {error}")


def test_an_impossible_scratch_folder_is_an_error_at_once(tmp_path, source, out):
    (tmp_path / "file").touch()
    refused = batch(out, source, "--scratch", tmp_path / "file" / "a")
    assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)
    assert str(tmp_path / "file") in refused.stderr
