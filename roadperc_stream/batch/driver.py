"""Runs a batch: gives logs to a back end, retries, and records the outcomes in the list of runs."""

import re
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Final

from roadperc_stream import __version__
from roadperc_stream.batch.backend import Backend
from roadperc_stream.batch.dataset_lock import DatasetLock
from roadperc_stream.batch.plan import Planner, Step, find_drives_in
from roadperc_stream.batch.runs import BatchRow, KnownRuns, RunsTable
from roadperc_stream.batch.task import BatchJob, DriveFiles, Outcome, Task, code_digest, libraries
from roadperc_stream.log import DIGEST_ALGORITHM
from roadperc_stream.output.tables import config_digest
from roadperc_stream.schemas.columns.runs import OF_THE_MACHINE, RunRow

_WAIT_S: Final = 0.2
_SAVE_EVERY_S: Final = 1.0
_AGAIN_S: Final = 1.0
"""Wait before the first retry of a log; each further retry waits this much longer."""
_TRIED_AGAIN: Final = frozenset({"killed", "unreachable"})
"""Outcomes that a retry may avoid."""
_RUN_COLUMNS = frozenset(item.name for item in fields(RunRow))


@dataclass
class BatchProgress:
    """How far a batch is; ``frames`` are those it has computed itself, of the logs done, ``failed`` rows of logs."""

    logs: int
    bytes_expected: int
    done: int = 0
    failed: list[RunRow] = field(default_factory=list)
    bytes_done: int = 0
    bytes_at_work: int = 0
    frames: int = 0
    frames_at_work: int = 0


@dataclass(frozen=True)
class _Try:
    """A log that is to be done or is at work."""

    step: Step
    attempts: int = 1
    not_before_s: float = 0.0


Watch = Callable[[BatchProgress], None]
"""Takes how far the batch is, several times a second."""


@dataclass
class Driver:
    """One batch at work."""

    job: BatchJob
    backend: Backend
    table: RunsTable
    known: KnownRuns
    watch: Watch
    _waiting: deque[_Try] = field(default_factory=deque)
    _at_work: dict[str, _Try] = field(default_factory=dict)
    _save_at_s: float = 0.0

    def run(self, steps: Sequence[Step]) -> BatchProgress:
        """Do all steps that are to be done, the longest logs first for load balance; how far it came."""
        todo = sorted((step for step in steps if step.action != "leave"), key=lambda step: -step.drive.size_bytes)
        self._waiting.extend(_Try(step) for step in todo)
        self._progress = BatchProgress(len(todo), sum(step.drive.size_bytes for step in todo))
        try:
            while self._waiting or self._at_work:
                self._give()
                self._take()
                if self._progress.failed and self.job.fail_fast:
                    break
        finally:
            self.table.save()
        return self._progress

    def _give(self) -> None:
        """Keep the back end busy."""
        for _ in range(len(self._waiting)):
            if len(self._at_work) >= max(self.backend.slots, 1):  # a cluster may grow only once it is asked to
                return
            item = self._waiting.popleft()
            before = item.step.before
            was_recovered = before is not None and before.row.recover
            task = Task(item.step.drive, self.job, item.step.same_ids, was_recovered)
            is_early = item.not_before_s > time.monotonic()
            if is_early or task.key in self._at_work:
                self._waiting.append(item)
                continue
            self._at_work[task.key] = item
            self.backend.submit(task)

    def _take(self) -> None:
        """Record the tasks that have ended, and the progress of the others."""
        for task, outcome in self.backend.wait(_WAIT_S):
            item = self._at_work.pop(task.key)
            if outcome.status in _TRIED_AGAIN and item.attempts <= self.job.retries:
                not_before_s = time.monotonic() + _AGAIN_S * item.attempts
                self._waiting.append(replace(item, attempts=item.attempts + 1, not_before_s=not_before_s))
            else:
                self._write(item, outcome)
        self._look_at_work()
        self.watch(self._progress)
        self._save_now_and_then()

    def _look_at_work(self) -> None:
        progress, at_work = self._progress, self.backend.at_work
        progress.frames_at_work = sum(done for done, _ in at_work.values())
        progress.bytes_at_work = sum(
            self._at_work[key].step.drive.size_bytes * min(done, expected) // expected
            for key, (done, expected) in at_work.items()
            if expected and key in self._at_work
        )

    def _save_now_and_then(self) -> None:
        """Save the rows, in a twentieth of the time at most."""
        now_s = time.monotonic()
        if now_s > self._save_at_s:
            self.table.save()
            self._save_at_s = time.monotonic() + max(_SAVE_EVERY_S, 20 * (time.monotonic() - now_s))

    def _write(self, item: _Try, outcome: Outcome) -> None:
        """Record the outcome of a log."""
        drive, progress = item.step.drive, self._progress
        before = self.known.get(outcome.log_id or drive.name)
        if not outcome.is_new and before is not None:
            run = replace(before, row=_also_named(before.row, drive))
        else:
            run = BatchRow(_row_of(self.job, drive, outcome, before, item.attempts), outcome.stages_s)
        if outcome.status not in OF_THE_MACHINE:  # otherwise the content of the file is unknown
            for other in self.known.named(drive.name):  # logs that were under this name before
                if other.key != run.key and other.row.log_id:
                    self._add(replace(other, row=_not_named(other.row, drive.name)))
        self._add(run)
        progress.done += 1
        progress.bytes_done += drive.size_bytes
        progress.frames += outcome.frames - outcome.frames_before
        if run.row.status != "done":
            progress.failed.append(run.row)

    def _add(self, run: BatchRow) -> None:
        self.known.add(run)
        self.table.add(run)


def _row_of(job: BatchJob, drive: DriveFiles, outcome: Outcome, before: BatchRow | None, attempts: int) -> RunRow:
    """The row of a log; most columns come from the outcome.

    Args:
        job: what the batch does.
        drive: the log.
        outcome: of its last attempt.
        before: its row in the dataset.
        attempts: how often it was begun.
    """
    how = job.how
    row = RunRow(
        **{name: value for name, value in asdict(outcome).items() if name in _RUN_COLUMNS},
        config=how.name,
        path=drive.name,
        names=before.row.names if before else (),
        fingerprints=before.row.fingerprints if before else (),
        size_bytes=drive.size_bytes,
        version=__version__,
        code=code_digest(),
        libraries=libraries(),
        config_digest=config_digest(how.cfg),
        settings=how.settings,
        options=how.options,
        recover=job.recover,
        logs=job.keep_logs,
        digest_algorithm=DIGEST_ALGORITHM,
        attempts=attempts,
        finished_ns=before.row.finished_ns if before else 0,
    )
    return _also_named(row, drive)


def _also_named(row: RunRow, drive: DriveFiles) -> RunRow:
    """The row of a log that has been seen under this name."""
    seen = dict(zip(row.names, row.fingerprints, strict=True)) | {drive.name: drive.fingerprint}
    return _with_names(row, seen)


def _not_named(row: RunRow, name: str) -> RunRow:
    """The row of a log that is under this name no more."""
    seen = {n: print_ for n, print_ in zip(row.names, row.fingerprints, strict=True) if n != name}
    return _with_names(row, seen)


def _with_names(row: RunRow, seen: Mapping[str, str]) -> RunRow:
    """The row with the fingerprints of a log's files by their names, newer than it was; its path is one of those."""
    path = row.path if row.path in seen or not seen else next(iter(seen))
    finished_ns = max(time.time_ns(), row.finished_ns + 1)
    return replace(row, path=path, names=tuple(seen), fingerprints=tuple(seen.values()), finished_ns=finished_ns)


@dataclass(frozen=True)
class BatchSummary:
    """What a batch came to: logs done, left and not begun, frames computed, rows of logs that failed, now or before."""

    done: int
    left: int
    frames: int
    failed: tuple[RunRow, ...]
    undone: int = 0


StartBackend = Callable[[], Backend]
Display = Callable[[], AbstractContextManager[Watch]]


class BatchRun:
    """A batch: its logs, what it does with each, and the doing."""

    def __init__(self, job: BatchJob, arguments: Sequence[str], parts: re.Pattern[str] | None) -> None:
        """Find the logs.

        Raises:
            StorageError: an argument names no log.
        """
        self._job, self._table = job, RunsTable(job.out)
        self.drives = find_drives_in(arguments, job.out, parts)

    def plan(self) -> tuple[Step, ...]:
        """What is to be done with each log.

        Raises:
            StorageError: the dataset cannot be read.
            TableError: its list of runs cannot be read.
        """
        self._known = KnownRuns(self._table.read().values(), self._job.how.name)
        planner = Planner(self._known, self._job)
        return tuple(planner.step(drive) for drive in self.drives)

    def run(self, start: StartBackend, display: Display) -> BatchSummary:
        """Do what is to be done, as the one batch that writes the dataset.

        Args:
            start: gives the back end; called only where anything is to be done.
            display: shows the progress.

        Raises:
            StorageError: the dataset cannot be written, or another batch is writing it.
        """
        with DatasetLock(self._job.out) as lock:
            steps = self.plan()
            progress = BatchProgress(0, 0)
            try:
                if any(step.action != "leave" for step in steps):
                    progress = self._driven(steps, lock, start, display)
            finally:
                if lock.is_held:
                    self._table.fold()
        before = [step.before.row for step in steps if step.is_failed and step.before is not None]
        left = sum(step.action == "leave" for step in steps) - len(before)
        undone = progress.logs - progress.done
        failed = (*before, *progress.failed)
        return BatchSummary(progress.done - len(progress.failed), left, progress.frames, failed, undone)

    def _driven(self, steps: Sequence[Step], lock: DatasetLock, start: StartBackend, display: Display) -> BatchProgress:
        with start() as backend, display() as watch:

            def watch_and_hold(progress: BatchProgress) -> None:
                lock.require_held()
                watch(progress)

            return Driver(self._job, backend, self._table, self._known, watch_and_hold).run(steps)
