"""Callbacks for the progress of long jobs."""

from collections.abc import Callable
from time import monotonic

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
