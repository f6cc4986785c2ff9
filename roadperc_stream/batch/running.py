"""A batch from its arguments to its list of runs: which logs, where they are worked on, what is said of them."""

import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from roadperc_stream.batch.backend import Backend
from roadperc_stream.batch.driver import BatchProgress, Driver, Failed
from roadperc_stream.batch.inputs import find_drives_in
from roadperc_stream.batch.job import BatchJob
from roadperc_stream.batch.plan import Again, Planner
from roadperc_stream.batch.runs import KnownRuns, RunsTable
from roadperc_stream.core.files import target_errors
from roadperc_stream.schemas.columns.runs import RunRow


@dataclass(frozen=True)
class BatchSummary:
    """What a batch came to: logs done, left and not begun, frames computed, rows of logs that failed, now or before."""

    done: int
    left: int
    frames: int
    failed: tuple[RunRow, ...]
    undone: int = 0


StartBackend = Callable[[], Backend]
Display = Callable[[], AbstractContextManager[tuple[Callable[[BatchProgress], None], Failed]]]


class BatchRun:
    """A batch that has been planned."""

    def __init__(self, job: BatchJob, arguments: Sequence[str], parts: re.Pattern[str] | None, again: Again) -> None:
        """Find the logs, and decide what to do with each.

        Raises:
            StorageError: an argument names no log, or the dataset cannot be read.
            TableError: its list of runs cannot be read.
        """
        self._job, self._table = job, RunsTable(job.out)
        drives = find_drives_in(arguments, job.out, parts)
        self._known = KnownRuns(self._table.read().values(), job.how.name)
        planner = Planner(self._known, job.out, again)
        self.steps = tuple(planner.step(drive) for drive in drives)

    def run(self, start: StartBackend, display: Display) -> BatchSummary:
        """Do what is to be done.

        Args:
            start: gives the back end; called only where anything is to be done.
            display: shows the progress, and the logs that fail.

        Raises:
            StorageError: the dataset cannot be written.
        """
        before = [step.before.row for step in self.steps if step.is_failed and step.before is not None]
        left = sum(step.action == "leave" for step in self.steps) - len(before)
        if left + len(before) == len(self.steps):
            self._table.fold_left_over()
            return BatchSummary(0, left, 0, tuple(before))
        if self._job.out.is_local:
            with target_errors(Path(self._job.out.address)):
                Path(self._job.out.address).mkdir(parents=True, exist_ok=True)
        try:
            with start() as backend, display() as (watch, failed):
                driver = Driver(self._job, backend, self._table, self._known, watch, failed)
                progress, rows = driver.run(self.steps)
        finally:
            self._table.fold()
        undone = progress.logs - progress.done
        return BatchSummary(progress.done - progress.failed, left, progress.frames, (*before, *rows), undone)
