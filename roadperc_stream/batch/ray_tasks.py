"""What runs on the machines of a cluster: an attempt at a log, and a count of the frames that all of them have done."""

import time
from typing import Any, Final

from roadperc_stream.batch.attempt import attempt
from roadperc_stream.batch.backend import Frames
from roadperc_stream.batch.configuration import code_digest
from roadperc_stream.batch.task import Outcome, Task

_TELL_EVERY_S: Final = 1.0


def code_on_node() -> str:
    """Digest of the code that a machine has."""
    return code_digest()


class FrameCount:
    """How far the tasks at work are, on one machine for all."""

    def __init__(self) -> None:
        self._done: dict[str, Frames] = {}

    def tell(self, key: str, frames: Frames) -> None:
        """Take the frames done of a task, and those expected."""
        self._done[key] = frames

    def forget(self, key: str) -> None:
        """Take that a task has ended."""
        self._done.pop(key, None)

    def told(self) -> dict[str, Frames]:
        """How far all tasks at work are."""
        return self._done


def attempt_on_node(task: Task, count: Any) -> Outcome:
    """Replay a log, and tell the count of frames.

    Args:
        task: the log, and what to do with it.
        count: Ray's handle of a ``FrameCount``.
    """
    told_s = 0.0

    def tell(done: int, expected: int) -> None:
        nonlocal told_s
        if time.monotonic() >= told_s + _TELL_EVERY_S:
            told_s = time.monotonic()
            count.tell.remote(task.key, (done, expected))

    try:
        return attempt(task, tell=tell)
    finally:
        count.forget.remote(task.key)
