"""A batch from its arguments to its list of runs: gives logs to a back end, retries, writes down the outcomes."""

import re
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Final

from roadperc_stream.batch.backend import Backend
from roadperc_stream.batch.dataset_lock import DatasetLock
from roadperc_stream.batch.plan import Again, Planner, Step, find_drives_in
from roadperc_stream.batch.rows import also_named, not_named, row_of
from roadperc_stream.batch.runs import BatchRow, KnownRuns, RunsTable
from roadperc_stream.batch.task import BatchJob, DriveFiles, Outcome, Task
from roadperc_stream.schemas.columns.runs import OF_THE_MACHINE, RunRow

_WAIT_S: Final = 0.2
_SAVE_EVERY_S: Final = 1.0
_AGAIN_S: Final = 1.0
"""How long a log waits for another attempt, and each time so much longer."""
_TRIED_AGAIN: Final = frozenset({"killed", "unreachable"})
"""What another attempt may not meet again."""


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
            task = self._task(item.step)
            is_early = item.not_before_s > time.monotonic()
            if is_early or task.key in self._at_work:
                self._waiting.append(item)
                continue
            self._at_work[task.key] = item
            self.backend.submit(task)

    def _task(self, step: Step) -> Task:
        was_recovered = step.before is not None and step.before.row.recover
        return Task(step.drive, self.job, step.same_ids, was_recovered)

    def _take(self) -> None:
        """Write down what has ended, and look at what is at work."""
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
        """Write down what came of a log."""
        drive, progress = item.step.drive, self._progress
        before = self.known.get(outcome.log_id or drive.name)
        if not outcome.is_new and before is not None:
            run = replace(before, row=also_named(before.row, drive))
        else:
            run = BatchRow(row_of(self.job, drive, outcome, before, item.attempts), outcome.stages_s)
        if outcome.status not in OF_THE_MACHINE:  # else nobody knows what is in the file
            for other in self._no_longer_there(drive, run):
                self._add(other)
        self._add(run)
        progress.done += 1
        progress.bytes_done += drive.size_bytes
        progress.frames += outcome.frames - outcome.frames_before
        if run.row.status != "done":
            progress.failed.append(run.row)

    def _add(self, run: BatchRow) -> None:
        self.known.add(run)
        self.table.add(run)

    def _no_longer_there(self, drive: DriveFiles, run: BatchRow) -> list[BatchRow]:
        """Rows of other logs that were under this name before; one without a digest goes by itself."""
        return [
            replace(other, row=not_named(other.row, drive.name))
            for other in self.known.named(drive.name)
            if other.key != run.key and other.row.log_id
        ]


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

    def __init__(self, job: BatchJob, arguments: Sequence[str], parts: re.Pattern[str] | None, again: Again) -> None:
        """Find the logs.

        Raises:
            StorageError: an argument names no log.
        """
        self._job, self._again, self._table = job, again, RunsTable(job.out)
        self.drives = find_drives_in(arguments, job.out, parts)

    def plan(self) -> tuple[Step, ...]:
        """What is to be done with each log.

        Raises:
            StorageError: the dataset cannot be read.
            TableError: its list of runs cannot be read.
        """
        self._known = KnownRuns(self._table.read().values(), self._job.how.name)
        planner = Planner(self._known, self._job, self._again)
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
