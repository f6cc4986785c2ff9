"""How far a long job has come."""

from collections.abc import Callable
from time import monotonic

Progress = Callable[[int, int], None]
"""Takes the frames done and the frames expected."""


def no_progress(_done: int, _expected: int) -> None:
    """Nobody wants to know."""


def now_and_then(progress: Progress, every_s: float) -> Progress:
    """The same at most once in so many seconds, for what takes long to tell."""
    next_s = 0.0

    def told(done: int, expected: int) -> None:
        nonlocal next_s
        if monotonic() >= next_s:
            next_s = monotonic() + every_s
            progress(done, expected)

    return told
