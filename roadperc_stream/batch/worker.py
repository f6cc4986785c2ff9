"""One log of a batch: fetched where it is elsewhere, replayed, its tables put into the dataset."""

import hashlib
import os
import resource
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Final

import roadperc_stream
from roadperc_stream.batch.configuration import code_digest
from roadperc_stream.batch.fetched import FetchedFiles, fetched, with_addresses
from roadperc_stream.batch.part_replay import CHECKPOINTS, cut_log, joined_parts, print_remarks, replayed_part
from roadperc_stream.batch.publishing import of_summary, publish
from roadperc_stream.batch.splitting import SplitPart
from roadperc_stream.batch.task import BUSY, SCRATCH, EndedParts, Outcome, Task, as_text, this_worker
from roadperc_stream.core.memory import keep_freed_memory
from roadperc_stream.core.progress import Progress
from roadperc_stream.errors import LogError, NoFrameError, RoadpercError, StorageError, TargetError
from roadperc_stream.input import ReplaySource
from roadperc_stream.loop import Watcher, replay
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.schemas.columns.runs import OF_THE_MACHINE
from roadperc_stream.state.lock import FolderLock
from roadperc_stream.state.opening import open_log

_DIGITS: Final = 16
_MB: Final = 1e6
_MEMORY_UNIT: Final = 1 if sys.platform == "darwin" else 1024
"""In which the system counts the most memory that a process has held, bytes."""


def work(task: Task, progress: Progress) -> Outcome:
    """Replay a log into the dataset; what goes wrong with the log is an outcome as well.

    Args:
        task: the log, and what to do with it.
        progress: takes the frames done and the frames expected.
    """
    started = perf_counter()
    keep_freed_memory()
    try:
        with _claimed(task) as folder:
            outcome = Outcome(BUSY) if folder is None else _tried(task, folder, progress)
            if folder is not None:
                outcome = _with_addresses(outcome, task, folder)
                if outcome.status not in OF_THE_MACHINE:
                    shutil.rmtree(folder, ignore_errors=True)
    except OSError as error:
        outcome = Outcome("unreachable", _line(error))
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _MEMORY_UNIT / _MB
    return replace(
        outcome,
        seconds=outcome.seconds + perf_counter() - started,
        peak_memory_mb=max(outcome.peak_memory_mb or 0.0, peak_mb),
        worker=this_worker(),
    )


def _tried(task: Task, folder: Path, progress: Progress) -> Outcome:
    """Replay a log; why it cannot be is what comes of it."""
    try:
        return _replayed(task, folder, progress)
    except NoFrameError as error:
        return Outcome("empty", _line(error))
    except (StorageError, TargetError, OSError) as error:
        return Outcome("unreachable", _line(error))
    except LogError as error:
        return Outcome("damaged" if task.drive.size_bytes else "empty", _line(error))
    except RoadpercError as error:
        return Outcome("unfit", _line(error))
    except MemoryError:
        return Outcome("memory", "not enough memory")


def _with_addresses(outcome: Outcome, task: Task, folder: Path) -> Outcome:
    """What is said of a copy that is gone by now, said of the file in the store."""
    error = None if outcome.error is None else with_addresses(outcome.error, task, folder)
    return replace(
        outcome, error=error, warnings=tuple(with_addresses(text, task, folder) for text in outcome.warnings)
    )


def _line(error: Exception) -> str:
    return as_text(" ".join(str(error).splitlines())) or type(error).__name__


def scratch_of(task: Task) -> Path:
    """The folder for what is not complete: where an interrupted replay of the same log goes on."""
    if task.scratch is None and task.out.is_local:
        return task.out.path(f"{SCRATCH}/{task.key}.{task.content_key}")
    user = os.getuid() if hasattr(os, "getuid") else 0
    root = task.scratch or Path(tempfile.gettempdir()) / f"roadperc-batch-{user}"
    return root / hashlib.sha256(task.out.address.encode()).hexdigest()[:_DIGITS] / f"{task.key}.{task.content_key}"


def discard(task: Task) -> None:
    """Remove what an interrupted attempt has left on this machine, unless somebody is at work on it."""
    if scratch_of(task).exists():
        with suppress(OSError), _claimed(task) as folder:
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _claimed(task: Task) -> Iterator[Path | None]:
    """Hold a task's folder while nobody else does; None where somebody does.

    What is in it is of use for the next attempt: a checkpoint, or a log that has been fetched. That of a log, or code,
    as it was before goes.
    """
    folder = scratch_of(task)
    folder.mkdir(parents=True, exist_ok=True)
    lock = FolderLock(folder)
    if not lock.take():
        yield None
        return
    for former in folder.parent.glob(f"{task.key}.*"):
        if former != folder and former.is_dir():
            shutil.rmtree(former, ignore_errors=True)
    try:
        yield folder
    finally:
        with suppress(OSError):  # something is in it
            folder.rmdir()
        lock.release()


def _replayed(task: Task, folder: Path, progress: Progress) -> Outcome:
    _require_same_code(task)
    if isinstance(task.piece, EndedParts):
        return joined_parts(task, task.piece, folder)
    with fetched(task, folder) as files:
        try:
            outcome = _replayed_files(task, files, folder, progress)
        except RoadpercError:
            files.require_unchanged()  # what is wrong with it may be that it is half another file
            raise
    return outcome


def _replayed_files(task: Task, files: FetchedFiles, folder: Path, progress: Progress) -> Outcome:
    paths, (topics, time_range) = files.paths, (dict(task.how.topics), task.how.time_range)
    source = ReplaySource(paths, topics, time_range, task.recover, is_audited=task.is_audited)
    if isinstance(task.piece, SplitPart):
        return replayed_part(task, task.piece, source, files, folder, progress)
    if (outcome := _without_replay(task, source)) is not None:
        files.require_unchanged()
        return outcome
    target = ReplayTarget(folder / "out.mcap", results_only=task.keep_logs != "whole", force=True)
    summary = replay(source, target, task.how.cfg, checkpoints=CHECKPOINTS, watcher=Watcher(progress))
    files.require_unchanged()
    print_remarks(summary, task, folder)
    return publish(task, target, summary.log_id, summary.first_ns, of_summary(summary))


def _without_replay(task: Task, source: ReplaySource) -> Outcome | None:
    """What comes of a log that is in the dataset already, or is to be replayed in parts."""
    if task.same_ids:
        as_before = replace(source, recover=task.recover or task.was_recovered)
        log_id = open_log(as_before, task.how.cfg).input.log_id
        if log_id in task.same_ids:
            return Outcome("done", log_id=log_id, is_new=False)
    return None if task.how.split_s is None else cut_log(task, open_log(source, task.how.cfg).input)


def _require_same_code(task: Task) -> None:
    """Check that a worker elsewhere computes what the others compute.

    Raises:
        StorageError: it has another version of the program.
    """
    if task.code and task.code != code_digest():
        found = f"{roadperc_stream.__version__}, code {code_digest()}"
        raise StorageError(f"{this_worker()}: has another version of roadperc_stream ({found}); expected {task.code}")
