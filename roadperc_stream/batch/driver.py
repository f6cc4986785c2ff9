"""The loop over many logs: gives them to a back end, tries again where a worker died, writes down what came of each."""

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from roadperc_stream.batch.backend import Backend
from roadperc_stream.batch.configuration import code_digest
from roadperc_stream.batch.job import BatchJob, also_named, but_for_names, not_named
from roadperc_stream.batch.plan import Step
from roadperc_stream.batch.runs import BatchRow, KnownRuns, RunsTable
from roadperc_stream.batch.splitting import SplitPart
from roadperc_stream.batch.task import (
    BUSY,
    CutLog,
    DriveFiles,
    EndedPart,
    EndedParts,
    Outcome,
    Task,
)
from roadperc_stream.batch.worker import discard
from roadperc_stream.schemas.columns.runs import OF_THE_MACHINE, RunRow

_WAIT_S: Final = 0.2
_SAVE_EVERY_S: Final = 1.0
_BUSY_AGAIN_S: Final = 1.0
_UNREACHED_AGAIN_S: Final = 1.0
"""How long a log waits that is tried again, and each time so much longer."""
_TRIED_AGAIN: Final = frozenset({"killed", "unreachable"})
"""What another attempt may not meet again."""


@dataclass
class BatchProgress:
    """How far a batch is; ``frames`` are those it has computed itself, of the logs done."""

    logs: int
    bytes_expected: int
    done: int = 0
    failed: int = 0
    bytes_done: int = 0
    bytes_at_work: int = 0
    frames: int = 0
    frames_at_work: int = 0


@dataclass
class _SplitLog:
    """A log that is replayed in parts: how it was cut, and what came of its parts by number."""

    cut: CutLog
    ended: dict[int, EndedPart] = field(default_factory=dict)
    most_attempts: int = 1
    frames: int = 0
    bytes_done: int = 0
    has_failed: bool = False

    @property
    def is_replayed(self) -> bool:
        """Whether all parts are."""
        return len(self.ended) == len(self.cut.parts)

    @property
    def ended_parts(self) -> EndedParts:
        """All parts in their order."""
        return EndedParts(self.cut, tuple(self.ended[part.index] for part in self.cut.parts))


@dataclass(frozen=True)
class _Try:
    """A log, or a part of one, that is to be done or is at work; ``split`` without a part is to be joined."""

    step: Step
    attempts: int = 1
    not_before_s: float = 0.0
    split: _SplitLog | None = None
    part: SplitPart | None = None

    @property
    def attempts_of_log(self) -> int:
        """How often it was begun, or of a log in parts the one that was begun most often."""
        return max(self.attempts, self.split.most_attempts if self.split is not None else 1)

    @property
    def bytes(self) -> int:
        """Of the log, or the part."""
        size = self.step.drive.size_bytes
        if self.split is None:
            return size
        return size // len(self.split.cut.parts) if self.part is not None else size - self.split.bytes_done


Watch = Callable[[BatchProgress], None]
Failed = Callable[[RunRow], None]


@dataclass
class Driver:
    """One batch at work."""

    job: BatchJob
    backend: Backend
    table: RunsTable
    known: KnownRuns
    watch: Watch = lambda _: None
    failed: Failed = lambda _: None
    _waiting: deque[_Try] = field(default_factory=deque)
    _at_work: dict[str, _Try] = field(default_factory=dict)
    _save_at_s: float = 0.0
    _from_elsewhere: set[tuple[str, str]] = field(default_factory=set)
    _since_planned: set[tuple[str, str]] = field(default_factory=set)
    """Keys of the rows that other batches have written meanwhile, and of all that are new: clocks do not tell."""

    def run(self, steps: Sequence[Step]) -> tuple[BatchProgress, list[RunRow]]:
        """Do all steps that are to be done; the longest logs first, lest one of them is all that is left at the end.

        Returns:
            How far it came, and the rows of the logs that failed.
        """
        todo = sorted((step for step in steps if step.action != "leave"), key=lambda step: -step.drive.size_bytes)
        self._waiting.extend(_Try(step) for step in todo)
        self._progress = BatchProgress(len(todo), sum(step.drive.size_bytes for step in todo))
        failed: list[RunRow] = []
        try:
            while self._waiting or self._at_work:
                self._give()
                for row in self._taken():
                    failed.append(row)
                    self.failed(row)
                if failed and self.job.fail_fast:
                    break
        finally:
            self.table.save()
        return self._progress, failed

    def _give(self) -> None:
        """Keep the back end busy."""
        for _ in range(len(self._waiting)):
            is_full = len(self._at_work) >= max(self.backend.slots, 1)  # a cluster may grow only once it is asked to
            if is_full or not self._waiting:  # with a part that is done elsewhere all others go
                return
            item = self._waiting.popleft()
            if self._is_done_elsewhere(item):
                discard(self._task(item))
                self._end_split(item, has_failed=True)
                self._count(item)
                continue
            task = self._task(item)
            if item.not_before_s > time.monotonic() or task.key in self._at_work or self._has_twin_at_work(item):
                self._waiting.append(item)
                continue
            self._at_work[task.key] = item
            self.backend.submit(task)

    def _is_done_elsewhere(self, item: _Try) -> bool:
        """Whether another batch on the same dataset has replayed the log meanwhile."""
        drive = item.step.drive
        return any(
            self._is_as_asked(run.row) and run.row.fingerprints[run.row.names.index(drive.name)] == drive.fingerprint
            for run in self.known.named(drive.name)
            if run.key in self._from_elsewhere
        )

    def _is_as_asked(self, row: RunRow) -> bool:
        """Whether this batch would have come to the same row."""
        has_log = self.job.keep_logs in {"no", row.logs}
        return (row.status, row.code) == ("done", code_digest()) and has_log

    def _task(self, item: _Try) -> Task:
        if item.split is None:
            before = item.step.before
            task = self.job.task(item.step.drive, self._same_ids(item.step))
            return replace(task, was_recovered=before is not None and before.row.recover)
        piece, is_audited = item.part or item.split.ended_parts, item.split.cut.is_audited
        return replace(self.job.task(item.step.drive), piece=piece, is_audited=is_audited)

    def _same_ids(self, step: Step) -> tuple[str, ...]:
        """Logs that were done since the batch was planned may be this one, too."""
        if step.before is not None:
            return step.same_ids
        done = (run for run in self.known.done_of_size(step.drive.size_bytes) if run.key in self._since_planned)
        new = (run.row.log_id for run in done if self._is_as_asked(run.row))
        return (*step.same_ids, *filter(None, new))

    def _has_twin_at_work(self, item: _Try) -> bool:
        """Whether a file of the same size is: it may be the same log, and then this one need not be replayed."""
        size = item.step.drive.size_bytes
        others = (other.step.drive for other in self._at_work.values() if other.step.drive != item.step.drive)
        return bool(self._waiting) and item.split is None and any(other.size_bytes == size for other in others)

    def _taken(self) -> Iterable[RunRow]:
        for task, outcome in self.backend.wait(_WAIT_S):
            item = self._at_work.pop(task.key)
            if item.split is not None and item.split.has_failed:
                continue
            if outcome.status == BUSY:
                self._wait_with(self._anew(item), _BUSY_AGAIN_S)
            elif outcome.status in _TRIED_AGAIN and item.attempts <= self.job.retries:
                self._wait_with(replace(item, attempts=item.attempts + 1), _UNREACHED_AGAIN_S * item.attempts)
            elif outcome.cut is not None:
                split = _SplitLog(outcome.cut)
                self._waiting.extendleft(_Try(item.step, split=split, part=part) for part in reversed(split.cut.parts))
            elif item.split is not None and item.part is not None and outcome.status == "done":
                self._part_done(item, item.split, item.part, outcome)
            else:
                row = self._written(item, outcome)
                if row.status != "done":
                    yield row
        self._look_at_work()
        self.watch(self._progress)
        self._save_now_and_then()

    def _anew(self, item: _Try) -> _Try:
        """What waits for another batch; where that has joined a log's parts, and removed them, the log as a whole."""
        if item.split is None or item.part is not None:
            return item
        self._progress.bytes_done -= item.split.bytes_done
        self._progress.frames -= item.split.frames
        return _Try(item.step)

    def _look_at_work(self) -> None:
        progress, at_work = self._progress, self.backend.at_work
        progress.frames_at_work = sum(done for done, _ in at_work.values())
        progress.bytes_at_work = sum(
            self._at_work[key].bytes * min(done, expected) // expected
            for key, (done, expected) in at_work.items()
            if expected and key in self._at_work
        )

    def _wait_with(self, item: _Try, seconds: float) -> None:
        self._waiting.append(replace(item, not_before_s=time.monotonic() + seconds))

    def _end_split(self, item: _Try, *, has_failed: bool) -> None:
        """Have nothing more to do with the parts of a log."""
        if item.split is not None:
            item.split.has_failed = has_failed
            self._waiting = deque(other for other in self._waiting if other.split is not item.split)

    def _part_done(self, item: _Try, split: _SplitLog, part: SplitPart, outcome: Outcome) -> None:
        frames = outcome.frames - outcome.frames_before
        self._progress.frames += frames
        self._progress.bytes_done += item.bytes
        split.frames += frames
        split.bytes_done += item.bytes
        split.ended[part.index] = EndedPart(part, outcome)
        split.most_attempts = max(split.most_attempts, item.attempts)
        if split.is_replayed:
            self._waiting.appendleft(_Try(item.step, split=split))

    def _save_now_and_then(self) -> None:
        """Save what was done here and read what was done elsewhere, in a twentieth of the time at most."""
        now_s = time.monotonic()
        if now_s > self._save_at_s:
            self.table.save()
            for run in self.table.news().values():
                if run.row.config == self.job.how.name:
                    self._take_news(run)
            self._save_at_s = time.monotonic() + max(_SAVE_EVERY_S, 20 * (time.monotonic() - now_s))

    def _take_news(self, run: BatchRow) -> None:
        """Take in a row that may be another batch's, and may be known already."""
        before = self.known.get(*run.key)
        if before is not None and run.row.finished_ns <= before.row.finished_ns:
            return
        self.known.add(run)
        self._since_planned.add(run.key)
        if before is None or but_for_names(run.row) != but_for_names(before.row):
            self._from_elsewhere.add(run.key)

    def _written(self, item: _Try, outcome: Outcome) -> RunRow:
        """Write down what came of a log."""
        drive, progress = item.step.drive, self._progress
        if item.part is not None and item.split is not None:
            text = f"part {item.part.index + 1} of {len(item.split.cut.parts)}: {outcome.error}"
            outcome = replace(outcome, error=text)
        self._end_split(item, has_failed=outcome.status != "done")
        before = self.known.get(outcome.log_id or drive.name, self.job.how.name)
        if not outcome.is_new and before is not None:
            run = replace(before, row=also_named(before.row, drive))
        else:
            run = BatchRow(self.job.row(drive, outcome, before, item.attempts_of_log), outcome.stages_s)
        if outcome.status not in OF_THE_MACHINE:  # else nobody knows what is in the file
            for other in self._no_longer_there(drive, run):
                self._add(other)
        self._add(run)
        self._count(item)
        if item.split is None:
            progress.frames += outcome.frames - outcome.frames_before
        elif run.row.status == "done":  # some were in two parts
            progress.frames += min(0, outcome.frames - item.split.frames)
        progress.failed += run.row.status != "done"
        return run.row

    def _count(self, item: _Try) -> None:
        self._progress.done += 1
        self._progress.bytes_done += item.step.drive.size_bytes - (item.split.bytes_done if item.split else 0)

    def _add(self, run: BatchRow) -> None:
        self.known.add(run)
        self.table.add(run)
        self._since_planned.add(run.key)

    def _no_longer_there(self, drive: DriveFiles, run: BatchRow) -> list[BatchRow]:
        """Rows of other logs that were under this name before; one without a digest goes by itself."""
        return [
            replace(other, row=not_named(other.row, drive.name))
            for other in self.known.named(drive.name)
            if other.key != run.key and other.row.log_id
        ]
