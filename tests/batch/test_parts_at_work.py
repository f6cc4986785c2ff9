"""Logs in parts, as the driver gives them out and workers replay them, where something happens between."""

import shutil
import time
from contextlib import nullcontext
from dataclasses import replace

import pytest

from roadperc_stream.batch.configuration import BatchConfiguration
from roadperc_stream.batch.job import BatchJob
from roadperc_stream.batch.plan import Again
from roadperc_stream.batch.running import BatchRun
from roadperc_stream.batch.splitting import SplitPart
from roadperc_stream.batch.task import BUSY, CUT, CutLog, DriveFiles, Outcome, Task
from roadperc_stream.batch.worker import work
from roadperc_stream.core.config import load_config
from roadperc_stream.core.progress import no_progress
from roadperc_stream.storage.finding import find_files
from roadperc_stream.storage.folder import Folder
from tests.batch.backends import Scripted
from tests.batch.dataset import batch, runs, write_log

SPLIT = {"split_s": 2.5, "warm_up_s": 0.5}
LOG_ID = "0123456789abcdef"
PARTS = tuple(SplitPart(k, 2.0 * k or None, None if k == 2 else 2.0 * k + 3, 3 * bool(k)) for k in range(3))


@pytest.fixture
def out(tmp_path):
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


def task_of(out, *sources, **how):
    files = tuple(file for source in sources for file in find_files(str(source)))
    return Task(DriveFiles(files), BatchConfiguration(load_config(None), **how), Folder(str(out)))


def test_whether_parts_need_not_be_checked_again(tmp_path, out):
    source = write_log(tmp_path / "in" / "a.mcap", frames=160)
    assert work(task_of(out, source, **SPLIT), no_progress).cut.is_audited
    again = shutil.copy(source, tmp_path / "in" / "b.mcap")
    assert not work(task_of(out, source, again, **SPLIT), no_progress).cut.is_audited
    whole = source.read_bytes()
    source.write_bytes(whole[: len(whole) * 9 // 10])
    recovered = work(replace(task_of(out, source, **SPLIT), recover=True), no_progress)
    assert not recovered.cut.is_audited


def test_parts_of_two_logs_are_not_joined(tmp_path, out):
    source = write_log(tmp_path / "in" / "a.mcap", frames=160)
    task = task_of(out, source, **SPLIT)
    cut = work(task, no_progress).cut
    parts = [replace(task, piece=part, is_audited=cut.is_audited) for part in cut.parts]
    assert work(parts[0], no_progress).status == "done"
    write_log(source, frames=160, lane_m=0.2)
    changed = work(parts[1], no_progress)
    assert (changed.status, changed.error) == ("unreachable", f"{source}: changed while its parts were replayed")


def test_a_damaged_log_is_not_split_because_it_was_recovered_before(tmp_path, out):
    source = write_log(tmp_path / "in" / "a.mcap", frames=160)
    source.write_bytes(source.read_bytes()[:-4000])
    assert batch(out, source, "--recover", "--split", "2.5").returncode == 0
    shutil.rmtree(out / "metrics")
    refused = batch(out, source, "--split", "2.5")
    assert (refused.returncode, refused.stdout.splitlines()[0].startswith("0 logs done, 1 failed")) == (1, True)


def run_scripted(out, source, script):
    """The summary, and how far the batch was at last."""
    job, seen = BatchJob(BatchConfiguration(load_config(None), **SPLIT), Folder(str(out))), []
    display = nullcontext((lambda progress: seen.append(replace(progress)), lambda _: None))
    return BatchRun(job, [str(source)], None, Again()).run(lambda: Scripted(script), lambda: display), seen[-1]


def test_a_split_log_that_another_batch_has_done_is_left_to_it(tmp_path, out):
    """It has done it while parts wait; what it has written stays."""
    source = write_log(tmp_path / "in" / "a.mcap", frames=160)
    given = []

    def script(task):
        given.append(task.piece)
        if task.piece is None:
            return Outcome(CUT, log_id=LOG_ID, cut=CutLog(LOG_ID, 0, PARTS))
        batch(out, source, "--split", SPLIT["split_s"], "--warm-up", SPLIT["warm_up_s"])
        time.sleep(1.2)  # what others write is looked at once a second
        return Outcome("done", frames=60)

    summary, at_last = run_scripted(out, source, script)
    assert given == [None, PARTS[0]]
    assert (summary.done, summary.failed) == (1, ())
    assert (at_last.done, at_last.bytes_done) == (1, source.stat().st_size)
    (row,) = runs(out).to_dicts()
    assert (row["status"], row["frames"]) == ("done", 160)


def test_parts_that_another_batch_has_joined_count_once(tmp_path, out):
    source = write_log(tmp_path / "in" / "a.mcap", frames=160)
    joins = []

    def script(task):
        if task.piece is None:
            again = Outcome("done", log_id=LOG_ID, date="2026-01-01", frames=160, frames_before=160)
            return again if joins else Outcome(CUT, log_id=LOG_ID, cut=CutLog(LOG_ID, 0, PARTS))
        if isinstance(task.piece, SplitPart):
            return Outcome("done", frames=60)
        joins.append(task)
        return Outcome(BUSY)

    summary, at_last = run_scripted(out, source, script)
    assert (summary.done, summary.frames) == (1, 0)
    assert at_last.bytes_done == source.stat().st_size


def test_frames_in_two_parts_count_once(tmp_path, out):
    source = write_log(tmp_path / "in" / "a.mcap", frames=160)
    done = batch(out, source, "--split", "2.5", "--warm-up", "1")
    assert done.stdout.startswith("1 log done: 160 frames")
    assert not (out / ".parts").exists()
