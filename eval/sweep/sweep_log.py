"""Replays a log under many configurations at once: it is read and decoded once, and each gets a metrics table.

Processes share the logs. One log stays in one process, because each frame depends on the previous one.
"""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Final

from roadperc_stream.chain.own_stage import OwnStages, own_stages
from roadperc_stream.chain.prepare import prepare
from roadperc_stream.chain.step import step
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import RoadpercError
from roadperc_stream.input import ReplaySource
from roadperc_stream.metrics import frame_metrics
from roadperc_stream.model import Sample
from roadperc_stream.output.tables import TableWriter, table_facts
from roadperc_stream.resume.opening import open_log
from roadperc_stream.resume.state import ReplayState
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics
from roadperc_stream.system.pipeline import PATIENCE_S, Pipeline
from roadperc_stream.system.process import ending_signals
from roadperc_stream.system.progress import StageTimer
from roadperc_stream.system.threads import one_thread
from roadperc_stream.system.time import TimeRange

from .settings import Combination, passes

Progress = Callable[[int, int], None]
"""Called with numbers of frames: those done and those expected."""


@dataclass(frozen=True)
class Job:
    """A log to replay; ``table`` is the file name of its tables in each combination's folder."""

    source: Path
    table: str
    folder: Path
    combinations: tuple[Combination, ...]
    overrides: Mapping[str, str]
    time_range: TimeRange
    degrade: Callable[[Path, Path], object] | None = None
    """Writes the log that is replayed instead of ``source``, which is removed afterwards; None to replay ``source``."""


@dataclass
class Candidate:
    """A configuration, its own stages, its state in the log, and its table."""

    cfg: ReplayConfig
    own: OwnStages
    table: TableWriter
    state: ReplayState

    def replay(self, log_id: str, sample: Sample) -> None:
        """Run the chain on a sample and add its row, the same as in a replay with this configuration."""
        timer = StageTimer()
        with timer("total"):
            frame = prepare(self.cfg, sample.frame, timer, own=self.own)
            chain, result = step(self.cfg, self.state.chain, frame, timer, self.own)
            with timer("metrics"):
                row = frame_metrics(self.cfg, log_id, sample, result, self.state.earlier)
        self.state = ReplayState(chain, sample.as_earlier)
        if sample.is_written:
            self.table.append(row, **timer.columns())


def sweep_log(job: Job, progress: Progress) -> tuple[str, ...]:
    """Replay a log under every combination; ``progress`` gets the changes of both numbers.

    Returns:
        Notes on the log: roles that were guessed or have no channel, messages that could not be read.

    Raises:
        RoadpercError: the log cannot be read or replayed, or a table cannot be written.
    """
    with _replayed(job) as path:
        notes = [note for group in passes(job.combinations) for note in _one_pass(job, path, group, progress)]
    return tuple(dict.fromkeys(notes))


@contextmanager
def _replayed(job: Job) -> Iterator[Path]:
    """The log to replay."""
    if job.degrade is None:
        yield job.source
        return
    copy = (job.folder / job.combinations[0].folder / job.table).with_suffix(".mcap")
    try:
        job.degrade(job.source, copy)
        yield copy
    finally:
        copy.unlink(missing_ok=True)


def _one_pass(job: Job, path: Path, group: Sequence[Combination], progress: Progress) -> tuple[str, ...]:
    """Replay a log under a group of combinations that use the same samples."""
    opened = open_log(ReplaySource(path, job.overrides, job.time_range), group[0].cfg)
    log_in = opened.input
    progress(0, log_in.expected_frames)
    candidates = []
    for item in group:
        facts = table_facts(job.source, job.source, item.cfg)
        table = TableWriter(job.folder / item.folder / job.table, FrameMetrics, facts, TIME_COLUMNS, item.settings)
        candidates.append(Candidate(item.cfg, own_stages(item.cfg)[1], table, opened.initial))
    with one_thread(), ExitStack() as tables:
        for candidate in candidates:
            tables.enter_context(candidate.table)
        samples = Pipeline[Sample](log_in.samples(), apart=any(candidate.own for candidate in candidates))
        samples.then(partial(_replay, candidates, log_in.log_id)).then(lambda _: progress(1, 0)).run(1)
    return log_in.notes


def _replay(candidates: Sequence[Candidate], log_id: str, sample: Sample) -> None:
    """Replay a sample; the first candidate decodes for all, so each takes its turn for comparable times."""
    first = sample.index % len(candidates)
    for candidate in (*candidates[first:], *candidates[:first]):
        candidate.replay(log_id, sample)


# A forked process inherits the locks of polars' and OpenCV's threads, but not the threads that release them.
_CONTEXT: Final = multiprocessing.get_context("spawn")
_PROGRESS_EVERY_S: Final = 0.2


@dataclass(frozen=True)
class Shared:
    """Shared by all processes: frames done and expected, and whether to stop."""

    done: "Synchronized[int]"
    expected: "Synchronized[int]"
    stop: Event

    def count(self, done: int, expected: int) -> None:
        """Add the progress of a log.

        Raises:
            KeyboardInterrupt: the sweep was stopped.
        """
        if self.stop.is_set():
            raise KeyboardInterrupt
        for counter, more in ((self.done, done), (self.expected, expected)):
            with counter.get_lock():
                counter.value += more


def sweep_logs(jobs: Sequence[Job], processes: int, progress: Progress) -> list[tuple[str, ...]]:
    """Run all jobs in at most ``processes`` processes; ``progress`` gets the numbers over all logs.

    Returns:
        The notes of each job, in their order.

    Raises:
        RoadpercError: a log could not be replayed; the other jobs are cancelled.
    """
    workers = min(processes, len(jobs))
    if workers == 1:
        counted = [0, 0]

        def count(*more: int) -> None:
            counted[:] = (before + new for before, new in zip(counted, more, strict=True))
            progress(*counted)

        return [sweep_log(job, count) for job in jobs]
    with _signals_held():
        shared = Shared(_CONTEXT.Value("q"), _CONTEXT.Value("q"), _CONTEXT.Event())
    with ProcessPoolExecutor(workers, mp_context=_CONTEXT, initializer=_join, initargs=(shared,)) as pool:
        pending = set[Future[tuple[str, ...]]]()
        try:
            with _signals_held():
                futures = [pool.submit(_work, job) for job in jobs]
            pending = set(futures)
            while pending:
                done, pending = wait(pending, _PROGRESS_EVERY_S, FIRST_EXCEPTION)
                progress(shared.done.value, shared.expected.value)
                for future in done:
                    future.result()
            return [future.result() for future in futures]
        except BrokenProcessPool as error:
            raise RoadpercError("a process of the sweep was killed; pass --jobs 1 to use less memory") from error
        finally:
            shared.stop.set()
            started = [future for future in pending if not future.cancel()]
            if wait(started, PATIENCE_S).not_done:
                for process in multiprocessing.active_children():  # a stage of the user's own may never return
                    process.kill()


@contextmanager
def _signals_held() -> Iterator[None]:
    """Block signals while processes start; they inherit the mask, and ``Shared.stop`` stops them instead."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ending_signals())
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_shared: Shared


def _join(shared: Shared) -> None:
    """Initialise a process of the pool."""
    global _shared  # noqa: PLW0603 - set once, when the process starts
    _shared = shared


def _work(job: Job) -> tuple[str, ...]:
    return sweep_log(job, _shared.count)
