"""What runs on the machines of a cluster: an attempt at a log, and a count of the frames done by all of them."""

import time
from typing import Any, Final

from roadperc_stream.batch.attempt import attempt
from roadperc_stream.batch.configuration import code_digest
from roadperc_stream.batch.task import Outcome, Task

_TELL_EVERY_S: Final = 1.0


def code_on_node() -> str:
    """Digest of the code that a machine has."""
    return code_digest()


class FrameCount:
    """How far the tasks at work are, on one machine for all."""

    def __init__(self) -> None:
        self._done: dict[str, int] = {}

    def tell(self, key: str, frames: int) -> None:
        """Take the frames done of a task; 0: none are under way."""
        self._done[key] = frames

    def total(self) -> int:
        """Frames done of all tasks at work."""
        return sum(self._done.values())


def attempt_on_node(task: Task, count: Any) -> Outcome:
    """Replay a log, and tell the count of frames.

    Args:
        task: the log, and what to do with it.
        count: Ray's handle of a ``FrameCount``.
    """
    told_s = 0.0

    def tell(done: int, _expected: int) -> None:
        nonlocal told_s
        if time.monotonic() >= told_s + _TELL_EVERY_S:
            told_s = time.monotonic()
            count.tell.remote(task.key, done)

    try:
        return attempt(task, tell=tell)
    finally:
        count.tell.remote(task.key, 0)
