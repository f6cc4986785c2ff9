"""Replays logs under the combinations of a sweep, several at a time; each replay gives a metrics table."""

import multiprocessing
import signal
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from roadperc_stream.errors import RoadpercError
from roadperc_stream.input import ReplaySource
from roadperc_stream.output.tables import copy_table
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.system.files import scratch_folder
from roadperc_stream.system.process import ending_signals
from roadperc_stream.system.progress import Progress
from roadperc_stream.system.time import TimeRange

from ..replaying import replay_with
from .combinations import Combination

# A forked process inherits the locks of polars' and OpenCV's threads, but not the threads that release them.
_CONTEXT: Final = multiprocessing.get_context("spawn")


@dataclass(frozen=True)
class Job:
    """A log to replay under a combination, and the table to write."""

    source: Path
    table: Path
    combination: Combination
    overrides: Mapping[str, str]
    time_range: TimeRange
    degrade: Callable[[Path, Path], object] | None = None
    """Writes the log that is replayed instead of ``source``; None to replay ``source``."""


class Replayed(NamedTuple):
    """The number of frames of a replay, and notes on the log."""

    frames: int
    notes: tuple[str, ...]


def run_job(job: Job) -> Replayed:
    """Replay a log under a combination; the table has the settings as columns.

    Raises:
        RoadpercError: the log cannot be read or replayed, or the table cannot be written.
    """
    with scratch_folder(job.table) as folder:
        path, target = job.source, ReplayTarget(folder / "out.mcap", results_only=True)
        if job.degrade is not None:
            path = folder / "degraded.mcap"
            job.degrade(job.source, path)
        source = ReplaySource(path, job.overrides, job.time_range)
        summary = replay_with(source, target, job.combination.cfg, threads=1)
        original = str(job.source.absolute())
        copy_table(target.metrics, job.table, {"source": original, "log": original}, job.combination.settings)
    return Replayed(summary.frames, summary.notes)


def run_jobs(jobs: Sequence[Job], processes: int, progress: Progress) -> list[tuple[str, ...]]:
    """Run all jobs in at most ``processes`` processes; ``progress`` gets the frames done and those expected of all.

    Returns:
        The notes of each job, in their order.

    Raises:
        RoadpercError: a log could not be replayed; the other jobs are stopped.
    """
    found: dict[int, Replayed] = {}

    def done(at: int, result: Replayed) -> None:
        found[at] = result
        frames = sum(one.frames for one in found.values())
        progress(frames, frames * len(jobs) // len(found))

    if min(processes, len(jobs)) == 1:
        for at, job in enumerate(jobs):
            done(at, run_job(job))
    else:
        _in_processes(jobs, min(processes, len(jobs)), done)
    return [found[at].notes for at in range(len(jobs))]


def _in_processes(jobs: Sequence[Job], processes: int, done: Callable[[int, Replayed], None]) -> None:
    with ProcessPoolExecutor(processes, mp_context=_CONTEXT) as pool:
        # The processes inherit the mask, so that a signal ends only this one, which stops them.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, ending_signals())
        try:
            futures = {pool.submit(run_job, job): at for at, job in enumerate(jobs)}
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        try:
            for future in as_completed(futures):
                done(futures[future], future.result())
        except BaseException as error:
            for future in futures:
                future.cancel()
            for process in multiprocessing.active_children():  # a stage of the user's own may never return
                process.kill()
            if isinstance(error, BrokenProcessPool):
                text = "a process of the sweep was killed; pass --jobs 1 to use less memory"
                raise RoadpercError(text) from error
            raise
