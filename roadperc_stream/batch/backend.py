"""What works on tasks: the driver knows no more of it than this."""

from collections.abc import Mapping
from types import TracebackType
from typing import Protocol, Self

from roadperc_stream.batch.task import Outcome, Task

Frames = tuple[int, int]
"""Frames done of a task, and frames expected."""


class Backend(Protocol):
    """Works on tasks; a context manager, and leaving it ends all that still runs."""

    @property
    def slots(self) -> int:
        """How many tasks to give it at a time; a cluster grows and shrinks."""
        ...

    def submit(self, task: Task) -> None:
        """Begin with a task."""
        ...

    def wait(self, timeout_s: float) -> list[tuple[Task, Outcome]]:
        """The tasks that have ended since, after so many seconds at most."""
        ...

    @property
    def at_work(self) -> Mapping[str, Frames]:
        """How far the tasks at work are, by their keys, as far as that is known."""
        ...

    def __enter__(self) -> Self:
        """Start."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all that still runs."""
        ...
