"""Replays one log of a batch: fetches it from a store, replays it, and puts its tables into the dataset."""

import hashlib
import os
import resource
import shutil
import socket
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter
from typing import Final

from roadperc_stream.batch import task as tasks
from roadperc_stream.batch.addresses import is_address
from roadperc_stream.batch.location import Location
from roadperc_stream.batch.task import RESULTS_VERSION, BatchJob, Outcome, Task, as_text, this_worker
from roadperc_stream.chain.own_stage import own_stages
from roadperc_stream.errors import LogError, NoFrameError, RoadpercError, StorageError, TargetError
from roadperc_stream.info.contract import broken, record
from roadperc_stream.input import ReplaySource
from roadperc_stream.loop import replay
from roadperc_stream.output.tables import copy_table, totals
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import Callbacks, ReplaySummary
from roadperc_stream.resume.opening import ReplayOptions, open_log
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.columns.runs import OF_THE_MACHINE, stage_column
from roadperc_stream.system.files import make_private
from roadperc_stream.system.process import keep_freed_memory
from roadperc_stream.system.progress import Progress
from roadperc_stream.system.text import print_line
from roadperc_stream.system.time import NS_PER_S

_CHECKPOINTS: Final = ReplayOptions(checkpoint_every_s=60.0, resume=True)
"""A killed replay continues at its last checkpoint."""
_DIGITS: Final = 16
_MB: Final = 1e6
_MEMORY_UNIT: Final = 1 if sys.platform == "darwin" else 1024
"""Bytes of the unit of ``ru_maxrss``."""


def work(task: Task, on_progress: Progress) -> Outcome:
    """Replay a log into the dataset; an error of the log also gives an outcome.

    ``on_progress`` is called during the replay.
    """
    started = perf_counter()
    keep_freed_memory()
    try:
        folder = _folder_for(task)
        outcome = _judged(_outcome_of(task, folder, on_progress), task, folder)
        if outcome.status not in OF_THE_MACHINE:
            shutil.rmtree(folder, ignore_errors=True)
        with suppress(OSError):  # it has files for the next attempt
            folder.rmdir()
        error = outcome.error and _with_addresses(outcome.error, task, folder)
        warnings = tuple(_with_addresses(text, task, folder) for text in outcome.warnings)
        outcome = replace(outcome, error=error, warnings=warnings)
    except (OSError, StorageError, TargetError) as refused:
        outcome = Outcome("unreachable", _line(refused))
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _MEMORY_UNIT / _MB
    return replace(outcome, seconds=perf_counter() - started, peak_memory_mb=peak_mb, worker=this_worker())


def _outcome_of(task: Task, folder: Path, on_progress: Progress) -> Outcome:
    """Replay a log, and turn an error into an outcome."""
    try:
        return _replayed(task, folder, on_progress)
    except NoFrameError as error:
        return Outcome("empty", _line(error))
    except (StorageError, TargetError, OSError) as error:
        return Outcome("unreachable", _line(error))
    except LogError as error:
        return Outcome("damaged" if task.log.size_bytes else "empty", _line(error))
    except RoadpercError as error:
        return Outcome("unfit", _line(error))
    except MemoryError:
        return Outcome("memory", "not enough memory")


def _judged(outcome: Outcome, task: Task, folder: Path) -> Outcome:
    """The outcome with the limits of the contract that the log breaks, unless it cannot be read."""
    job = task.job
    if job.contract is None or outcome.status in OF_THE_MACHINE:
        return outcome
    with suppress(RoadpercError):
        recording = record(_fetched(task, folder), dict(job.configuration.topics), job.configuration.cfg)
        found = tuple(as_text(str(one)) for one in broken(recording, job.contract))
        return replace(outcome, contract=job.contract.name, broken=found)
    return outcome


def _line(error: Exception) -> str:
    return as_text(" ".join(str(error).splitlines())) or type(error).__name__


def scratch_of(task: Task) -> Path:
    """The folder for partial files of a task, where an interrupted replay continues.

    Raises:
        TargetError: as ``scratch_root``.
    """
    return scratch_root(task.job) / f"{task.key}.{task.content_key}"


def scratch_root(job: BatchJob) -> Path:
    """The folder for partial files: in the dataset, or in a private folder, which this function makes.

    Raises:
        TargetError: the private folder cannot be made, or is not private.
    """
    if job.scratch is None and job.out.is_local:
        return Path(job.out.address, tasks.SCRATCH)
    private = (job.scratch or Path(tempfile.gettempdir())) / f"roadperc-batch-{os.getuid()}"
    make_private(private)
    return private / hashlib.sha256(job.out.address.encode()).hexdigest()[:_DIGITS]


def _folder_for(task: Task) -> Path:
    """Make a task's folder, with files for the next attempt: a checkpoint, or a fetched log.

    Folders of earlier content or code are removed.
    """
    folder = scratch_of(task)
    folder.mkdir(parents=True, exist_ok=True)
    for earlier in folder.parent.glob(f"{task.key}.*"):
        if earlier != folder and earlier.is_dir():
            shutil.rmtree(earlier, ignore_errors=True)
    return folder


def _replayed(task: Task, folder: Path, on_progress: Progress) -> Outcome:
    job = task.job
    _require_same_results(task)
    before = _identities(task)
    paths = _fetched(task, folder)
    target = ReplayTarget(folder / "out.mcap", results_only=job.keep_logs != "whole", force=True)
    source = ReplaySource(paths, dict(job.configuration.topics), job.configuration.time_range, job.recover)
    try:
        known_id = _known_id(task, source)
        if known_id is None:
            cfg, own = own_stages(job.configuration.cfg)
            summary = replay(source, target, cfg, replace(_CHECKPOINTS, own=own), Callbacks(on_progress))
    finally:
        for name, identity in _identities(task).items():  # a mixture of two files may look damaged
            if identity != before[name]:
                raise StorageError(f"{name}: changed while it was replayed; run the command again")
    if known_id is not None:
        return Outcome("done", log_id=known_id, is_new=False)
    for remark in summary.remarks:  # the dataset stores the output of the process
        print_line(_with_addresses(remark, task, folder))
    return _published(task, target, summary)


def _published(task: Task, target: ReplayTarget, summary: ReplaySummary) -> Outcome:
    """Put the tables and, with ``--logs``, the log into the dataset; the metrics table comes last.

    Raises:
        StorageError: the dataset cannot be written.
        TargetError: no space for the copies.
    """
    job, log_id = task.job, summary.log_id
    date = datetime.fromtimestamp(summary.first_ns // NS_PER_S, UTC).date().isoformat()
    place = date, log_id, job.configuration.name
    names = {folder: tasks.name_in(folder, *place) for folder in (tasks.METRICS, tasks.OBJECTS, tasks.LOGS)}
    keeps_log = job.keep_logs != "no"
    facts = {"source": task.log.name, "log": job.out.at(names[tasks.LOGS]).address if keeps_log else ""}
    facts["options"] = job.configuration.options
    measured = totals(target.metrics, TIME_COLUMNS)
    if keeps_log:
        job.out.at(names[tasks.LOGS]).put(target.path)
    else:
        job.out.at(names[tasks.LOGS]).remove()  # an earlier result log does not belong to these tables
    for folder, table in ((tasks.OBJECTS, target.objects), (tasks.METRICS, target.metrics)):
        copy = table.with_suffix(".copy")
        copy_table(table, copy, facts, {"config": job.configuration.name})
        job.out.at(names[folder]).put(copy)
    return Outcome(
        "done",
        log_id=log_id,
        date=date,
        duration_s=measured.span_ns / NS_PER_S,
        frames=measured.rows,
        frames_before=summary.frames_before,
        dropped=sum(summary.dropped.values()),
        unreadable=sum(summary.problems.values()),
        warnings=tuple(map(as_text, summary.warnings)),
        findings=tuple(as_text(str(finding)) for finding in summary.findings),
        stages_s={stage_column(name): value / 1000 for name, value in measured.sums.items()},
    )


def _known_id(task: Task, source: ReplaySource) -> str | None:
    """The id of a log that the dataset already has; None for a new log."""
    if not task.known_ids:
        return None
    source = replace(source, recover=source.recover or task.was_recovered)
    log_id = open_log(source, task.job.configuration.cfg).input.log_id
    return log_id if log_id in task.known_ids else None


def _require_same_results(task: Task) -> None:
    """Check that this worker computes the results of the batch.

    Raises:
        StorageError: its results have another version.
    """
    if task.results_version != RESULTS_VERSION:
        found = f"results of version {RESULTS_VERSION}, expected {task.results_version}"
        raise StorageError(f"{this_worker()}: {found}; install the same version of roadperc_stream")


def _copies_in(task: Task, folder: Path) -> Iterator[Path]:
    """The path of each file on this machine: its own path, or that of a copy in the folder."""
    for number, file in enumerate(task.log.files):
        yield folder / f"{number}.mcap" if is_address(file.address) else Path(file.address)


def _with_addresses(text: str, task: Task, folder: Path) -> str:
    """The text with the addresses of the originals instead of the paths of the copies."""
    for file, copy in zip(task.log.files, _copies_in(task, folder), strict=True):
        text = text.replace(str(copy), file.address)
    return text


def _fetched(task: Task, folder: Path) -> tuple[Path, ...]:
    """The log's files on this machine; files of a store are copied unless an earlier attempt copied them.

    Raises:
        StorageError: a file cannot be read.
    """
    paths = tuple(_copies_in(task, folder))
    for file, path in zip(task.log.files, paths, strict=True):
        if is_address(file.address) and not path.exists():
            Location(file.address).fetch(path)
    return paths


def _identities(task: Task) -> dict[str, tuple[int, ...]]:
    """Device, inode, size and modification time of the local files, by name: a replay reads a log more than once.

    Raises:
        StorageError: a file does not exist.
    """
    found = dict[str, tuple[int, ...]]()
    for name in (file.address for file in task.log.files if not is_address(file.address)):
        try:
            facts = Path(name).stat()
        except OSError as error:
            hint = "use addresses if the machines share no disk"
            raise StorageError(f"{name}: no such file on {socket.gethostname()}; {hint}") from error
        found[name] = facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns
    return found
