"""Runs a batch: submits logs to a back end, retries, and records the outcomes in the list of runs."""

import re
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Final

from roadperc_stream import __version__
from roadperc_stream.batch.backend import Backend
from roadperc_stream.batch.lock import dataset_lock
from roadperc_stream.batch.plan import Planner, Step, find_logs
from roadperc_stream.batch.runs import BatchRow, KnownRuns, RunsTable
from roadperc_stream.batch.task import RESULTS_VERSION, BatchJob, LogFiles, Outcome, Task, libraries
from roadperc_stream.log import DIGEST_ALGORITHM
from roadperc_stream.output.tables import config_digest
from roadperc_stream.schemas.columns.runs import OF_THE_MACHINE, RunRow

_WAIT_S: Final = 0.2
_SAVE_EVERY_S: Final = 1.0
_RETRY_AFTER_S: Final = 1.0
"""Wait before the first retry of a log; each further retry waits this much longer."""
_RETRIED: Final = frozenset({"killed", "unreachable"})
"""Outcomes that a retry may avoid."""
_RUN_COLUMNS = frozenset(item.name for item in fields(RunRow))


@dataclass
class BatchProgress:
    """The progress of a batch; ``frames`` counts the computed frames of the finished logs."""

    logs: int
    bytes_expected: int
    done: int = 0
    failed: list[RunRow] = field(default_factory=list)
    broken: list[RunRow] = field(default_factory=list)
    bytes_done: int = 0
    bytes_running: int = 0
    frames: int = 0
    frames_running: int = 0


@dataclass(frozen=True)
class _Attempt:
    """A waiting or running log."""

    step: Step
    number: int = 1
    not_before_s: float = 0.0


OnProgress = Callable[[BatchProgress], None]
"""Takes the progress several times a second."""


@dataclass
class Driver:
    """Runs the steps of one batch."""

    job: BatchJob
    backend: Backend
    table: RunsTable
    known: KnownRuns
    on_progress: OnProgress
    _waiting: deque[_Attempt] = field(default_factory=deque)
    _running: dict[str, _Attempt] = field(default_factory=dict)
    _save_at_s: float = 0.0

    def run(self, steps: Sequence[Step]) -> BatchProgress:
        """Run all steps, the longest logs first for load balance."""
        todo = sorted((step for step in steps if step.action != "skip"), key=lambda step: -step.log.size_bytes)
        self._waiting.extend(_Attempt(step) for step in todo)
        self._progress = BatchProgress(len(todo), sum(step.log.size_bytes for step in todo))
        try:
            while self._waiting or self._running:
                self._submit()
                self._collect()
                if self._progress.failed and self.job.fail_fast:
                    break
        finally:
            self.table.save()
        return self._progress

    def _submit(self) -> None:
        """Give the back end as many tasks as it can run."""
        for _ in range(len(self._waiting)):
            if len(self._running) >= max(self.backend.slots, 1):  # a cluster grows when a task waits
                return
            item = self._waiting.popleft()
            previous = item.step.previous
            was_recovered = previous is not None and previous.row.recover
            task = Task(item.step.log, self.job, item.step.known_ids, was_recovered)
            if item.not_before_s > time.monotonic() or task.key in self._running:
                self._waiting.append(item)
            else:
                self._running[task.key] = item
                self.backend.submit(task)

    def _collect(self) -> None:
        """Record the ended tasks and the progress of the others, and save the rows from time to time."""
        for task, outcome in self.backend.wait(_WAIT_S):
            item = self._running.pop(task.key)
            if outcome.status in _RETRIED and item.number <= self.job.retries:
                not_before_s = time.monotonic() + _RETRY_AFTER_S * item.number
                self._waiting.append(replace(item, number=item.number + 1, not_before_s=not_before_s))
            else:
                self._record(item, outcome)
        self._measure_running()
        self.on_progress(self._progress)
        now_s = time.monotonic()
        if now_s > self._save_at_s:  # saving takes at most a twentieth of the time
            self.table.save()
            self._save_at_s = time.monotonic() + max(_SAVE_EVERY_S, 20 * (time.monotonic() - now_s))

    def _measure_running(self) -> None:
        progress, running = self._progress, self.backend.running
        progress.frames_running = sum(done for done, _ in running.values())
        progress.bytes_running = sum(
            self._running[key].step.log.size_bytes * min(done, expected) // expected
            for key, (done, expected) in running.items()
            if expected and key in self._running
        )

    def _record(self, item: _Attempt, outcome: Outcome) -> None:
        """Record the outcome of a log."""
        log, progress = item.step.log, self._progress
        previous = self.known.get(outcome.log_id or log.name)
        if not outcome.is_new and previous is not None:
            row = _with_name(previous.row, log)
            if outcome.contract is not None:
                row = replace(row, contract=outcome.contract, broken=outcome.broken)
            run = replace(previous, row=row)
        else:
            run = BatchRow(_row_of(self.job, log, outcome, previous, item.number), outcome.stages_s)
        if outcome.status not in OF_THE_MACHINE:  # otherwise the content of the file is unknown
            for other in self.known.named(log.name):  # earlier logs of this name
                if other.key != run.key and other.row.log_id:
                    self._add(replace(other, row=_without_name(other.row, log.name)))
        self._add(run)
        progress.done += 1
        progress.bytes_done += log.size_bytes
        progress.frames += outcome.frames - outcome.frames_before
        if run.row.status != "done":
            progress.failed.append(run.row)
        if outcome.broken:
            progress.broken.append(run.row)

    def _add(self, run: BatchRow) -> None:
        self.known.add(run)
        self.table.add(run)


def _row_of(job: BatchJob, log: LogFiles, outcome: Outcome, previous: BatchRow | None, attempts: int) -> RunRow:
    """The row of a log; most columns come from the outcome of its last attempt.

    ``previous`` is its row in the dataset.
    """
    configuration = job.configuration
    row = RunRow(
        **{name: value for name, value in asdict(outcome).items() if name in _RUN_COLUMNS},
        config=configuration.name,
        path=log.name,
        names=previous.row.names if previous else (),
        fingerprints=previous.row.fingerprints if previous else (),
        size_bytes=log.size_bytes,
        version=__version__,
        code=RESULTS_VERSION,
        libraries=libraries(),
        config_digest=config_digest(configuration.cfg),
        settings=configuration.settings,
        options=configuration.options,
        recover=job.recover,
        logs=job.keep_logs,
        digest_algorithm=DIGEST_ALGORITHM,
        attempts=attempts,
        finished_ns=previous.row.finished_ns if previous else 0,
    )
    return _with_name(row, log)


def _with_name(row: RunRow, log: LogFiles) -> RunRow:
    """The row with the name and the fingerprint of a log."""
    return _with_names(row, dict(zip(row.names, row.fingerprints, strict=True)) | {log.name: log.fingerprint})


def _without_name(row: RunRow, name: str) -> RunRow:
    """The row without a name that another log has now."""
    return _with_names(row, {n: print_ for n, print_ in zip(row.names, row.fingerprints, strict=True) if n != name})


def _with_names(row: RunRow, seen: Mapping[str, str]) -> RunRow:
    """A newer row with the fingerprints by name; its path is one of the names."""
    path = row.path if row.path in seen or not seen else next(iter(seen))
    finished_ns = max(time.time_ns(), row.finished_ns + 1)
    return replace(row, path=path, names=tuple(seen), fingerprints=tuple(seen.values()), finished_ns=finished_ns)


@dataclass(frozen=True)
class BatchSummary:
    """The result of a batch: number of logs, computed frames.

    Rows of failed logs, and of those that break the contract, are also those of earlier runs.
    """

    done: int
    skipped: int
    not_started: int
    frames: int
    failed: tuple[RunRow, ...]
    broken: tuple[RunRow, ...]


StartBackend = Callable[[], Backend]
Display = Callable[[], AbstractContextManager[OnProgress]]


class BatchRun:
    """A batch: its logs, its plan, and its execution."""

    def __init__(self, job: BatchJob, arguments: Sequence[str], join: re.Pattern[str] | None) -> None:
        """Find the logs.

        Raises:
            StorageError: an argument names no log.
        """
        self._job, self._table = job, RunsTable(job.out)
        self.logs = find_logs(arguments, job.out, join)

    def plan(self) -> tuple[Step, ...]:
        """The step for each log.

        Raises:
            StorageError: the dataset cannot be read.
            TableError: its list of runs cannot be read.
        """
        self._known = KnownRuns(self._table.read(), self._job.configuration.name)
        planner = Planner(self._known, self._job)
        return tuple(planner.step(log) for log in self.logs)

    def run(self, start: StartBackend, display: Display) -> BatchSummary:
        """Run all steps while no other batch writes the dataset.

        ``start`` starts the back end; it is called only if a log must be replayed or checked.

        Raises:
            StorageError: the dataset cannot be written, or another batch is writing it.
        """
        with dataset_lock(self._job.out):
            steps = self.plan()
            progress = BatchProgress(0, 0)
            if any(step.action != "skip" for step in steps):
                with start() as backend, display() as show:
                    progress = Driver(self._job, backend, self._table, self._known, show).run(steps)
        earlier = [step.previous.row for step in steps if step.is_failed and step.previous is not None]
        skipped = [step.previous.row for step in steps if step.action == "skip" and step.previous is not None]
        broken = [row for row in skipped if row.broken] if self._job.contract is not None else []
        return BatchSummary(
            done=progress.done - len(progress.failed),
            skipped=sum(step.action == "skip" for step in steps) - len(earlier),
            not_started=progress.logs - progress.done,
            frames=progress.frames,
            failed=(*earlier, *progress.failed),
            broken=(*broken, *progress.broken),
        )
