"""Logs over processes: each log is one stream, so that nothing finer can be shared out."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event
from typing import Final

from roadperc_stream.errors import RoadpercError

from .sweep_log import Job, sweep_log

# A forked process inherits the locks of polars' and OpenCV's threads, but not the threads that would open them.
_CONTEXT: Final = multiprocessing.get_context("spawn")
_PROGRESS_EVERY_S: Final = 0.2
Bar = Callable[[int, int], None]
"""Called with frames done and frames expected, of all logs together."""


@dataclass
class FrameTally:
    """Frames of all logs, as the one process that works, or all of them, count them up."""

    bar: Bar
    done: int = 0
    expected: int = 0

    def count(self, done: int, expected: int) -> None:
        """Count the progress of a log."""
        self.done, self.expected = self.done + done, self.expected + expected
        self.bar(self.done, self.expected)


@dataclass(frozen=True)
class Shared:
    """What the processes share: frames done and expected, and whether to stop."""

    done: "Synchronized[int]"
    expected: "Synchronized[int]"
    stop: Event

    def count(self, done: int, expected: int) -> None:
        """Count the progress of a log.

        Raises:
            KeyboardInterrupt: the sweep has ended elsewhere.
        """
        if self.stop.is_set():
            raise KeyboardInterrupt
        for counter, more in ((self.done, done), (self.expected, expected)):
            with counter.get_lock():
                counter.value += more


def sweep_logs(jobs: Sequence[Job], processes: int, bar: Bar) -> list[tuple[str, ...]]:
    """Do every job, in as many processes.

    Returns:
        The notes of each job, in their order.

    Raises:
        RoadpercError: a log could not be replayed; the others are given up.
    """
    if min(processes, len(jobs)) == 1:
        tally = FrameTally(bar)
        return [sweep_log(job, tally.count) for job in jobs]
    shared = Shared(_CONTEXT.Value("q"), _CONTEXT.Value("q"), _CONTEXT.Event())
    workers = min(processes, len(jobs))
    with ProcessPoolExecutor(workers, mp_context=_CONTEXT, initializer=_join, initargs=(shared,)) as pool:
        try:
            with _interrupt_held():
                futures = [pool.submit(_do, job) for job in jobs]
            _wait_for(futures, shared, bar)
            return [future.result() for future in futures]
        except BrokenProcessPool as error:
            raise RoadpercError("a process of the sweep was killed; with --jobs 1 it takes less memory") from error
        finally:
            shared.stop.set()
            pool.shutdown(cancel_futures=True)


def _wait_for(futures: Sequence[Future[tuple[str, ...]]], shared: Shared, bar: Bar) -> None:
    """Return when all are done, or raise what the first that failed raised."""
    pending = set(futures)
    while pending:
        done, pending = wait(pending, _PROGRESS_EVERY_S, FIRST_EXCEPTION)
        bar(shared.done.value, shared.expected.value)
        for future in done:
            future.result()


@contextmanager
def _interrupt_held() -> Iterator[None]:
    """Keep Ctrl-C waiting while processes start: they inherit that, for it is this one that tells them to stop."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


_shared: Shared


def _join(shared: Shared) -> None:
    """Begin as one of the processes."""
    global _shared  # noqa: PLW0603 - handed over once, when the process starts
    _shared = shared


def _do(job: Job) -> tuple[str, ...]:
    return sweep_log(job, _shared.count)
