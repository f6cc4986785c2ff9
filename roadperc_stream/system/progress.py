"""Callbacks for the progress of long jobs, and a timer for the stages of a frame."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import monotonic, perf_counter, thread_time

Progress = Callable[[int, int], None]
"""Takes the frames done and the frames expected."""


def no_progress(_done: int, _expected: int) -> None:
    """Ignore the progress."""


def at_most_every(every_s: float, progress: Progress) -> Progress:
    """A callback that calls another one at most once in ``every_s`` seconds."""
    next_s = 0.0

    def call(done: int, expected: int) -> None:
        nonlocal next_s
        if monotonic() >= next_s:
            next_s = monotonic() + every_s
            progress(done, expected)

    return call


@dataclass
class StageTimer:
    """The milliseconds of each stage of one frame.

    ``clock`` returns seconds: wall time, or, if several threads work on a frame, the time of the thread
    (``thread_time``).
    """

    clock: Callable[[], float] = perf_counter
    elapsed_ms: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Start the frame."""
        self._started = self.clock()

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Add the time of the block to a stage."""
        started = self.clock()
        try:
            yield
        finally:
            self.elapsed_ms[name] = self.elapsed_ms.get(name, 0.0) + (self.clock() - started) * 1000

    def end(self) -> None:
        """End the frame: ``total`` is the time since its start, or the sum of the stages for ``thread_time``."""
        if self.clock is thread_time:
            self.elapsed_ms["total"] = sum(self.elapsed_ms.values())
        else:
            self.elapsed_ms["total"] = (self.clock() - self._started) * 1000

    def columns(self) -> dict[str, float]:
        """The time columns of a row; stages without a run are left out."""
        return {f"{name}_ms": value for name, value in self.elapsed_ms.items()}
