"""How far a long job has come."""

from collections.abc import Callable

Progress = Callable[[int, int], None]
"""Takes the frames done and the frames expected."""


def no_progress(_done: int, _expected: int) -> None:
    """Nobody wants to know."""
