"""The protocol of back ends, which run tasks, and the back end for this machine."""

import time
from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager
from functools import partial
from threading import Event
from typing import Protocol

from roadperc_stream.batch.attempt import attempt
from roadperc_stream.batch.task import Outcome, Task

Frames = tuple[int, int]
"""Frames done and frames expected of a task."""


class Backend(AbstractContextManager["Backend"], Protocol):
    """Runs tasks. Leaving its context ends the running tasks."""

    @property
    def slots(self) -> int:
        """Number of tasks that run at a time; it changes with the size of a cluster."""
        ...

    def submit(self, task: Task) -> None:
        """Start a task."""
        ...

    def wait(self, timeout_s: float) -> list[tuple[Task, Outcome]]:
        """The tasks that ended since the last call; waits for one at most this long."""
        ...

    @property
    def running(self) -> Mapping[str, Frames]:
        """The known progress of the running tasks, by their keys."""
        ...


class LocalBackend(AbstractContextManager["LocalBackend"]):
    """Runs a fixed number of tasks at a time."""

    def __init__(self, jobs: int) -> None:
        self.slots = jobs
        self._stop = Event()
        self._threads = ThreadPoolExecutor(jobs, thread_name_prefix="batch")
        self._tasks: dict[Future[Outcome], Task] = {}
        self._frames: dict[str, Frames] = {}

    def submit(self, task: Task) -> None:
        """Start a task."""
        self._tasks[self._threads.submit(attempt, task, self._stop, partial(self._note, task.key))] = task

    def _note(self, key: str, done: int, expected: int) -> None:
        self._frames[key] = done, expected

    @property
    def running(self) -> Mapping[str, Frames]:
        """The progress of the running tasks, by their keys."""
        return self._frames.copy()

    def wait(self, timeout_s: float) -> list[tuple[Task, Outcome]]:
        """The tasks that ended since the last call."""
        if not self._tasks:
            time.sleep(timeout_s)
        ended = wait(self._tasks, timeout_s, FIRST_COMPLETED).done
        found = [(self._tasks.pop(future), future.result()) for future in ended]
        for task, _ in found:
            self._frames.pop(task.key, None)
        return found

    def __exit__(self, *raised: object) -> None:
        """End the running tasks."""
        self._stop.set()
        self._threads.shutdown(cancel_futures=True)
