"""Limits the answers to viewers' requests, so that a flood of requests closes no other viewer's connection.

The SDK sends each answer to all viewers, and closes the connection of one with more waiting answers than its backlog.
While it reads the requests of a viewer that came together, it sends nothing.
"""

from collections import deque
from typing import Final

from foxglove.websocket import PlaybackState

from roadperc_stream.system.time import NS_PER_S

QUIET_S: Final = 0.1
"""A flood is over if no request came for this long."""
_AT_ONCE: Final = 210
_PER_S: Final = 70
"""A person who moves a slider makes 60 requests a second."""
_LATE: Final = 32


class Answers:
    """Counts requests; beyond ``_PER_S`` of them, the newest answers wait until the flood is over."""

    def __init__(self, clock_ns: int) -> None:
        self._left, self._asked_ns = float(_AT_ONCE), clock_ns
        self._late = deque[PlaybackState](maxlen=_LATE)

    def now(self, answer: PlaybackState, clock_ns: int) -> PlaybackState | None:
        """The answer if it may be sent at once; else None, and it waits."""
        elapsed_s = (clock_ns - self._asked_ns) / NS_PER_S
        self._left, self._asked_ns = min(self._left + elapsed_s * _PER_S, _AT_ONCE), clock_ns
        if self._left >= 1:
            self._left -= 1
            return answer
        self._late.append(answer)
        return None

    @property
    def are_late(self) -> bool:
        """Whether answers wait."""
        return bool(self._late)

    def late(self, clock_ns: int) -> list[PlaybackState]:
        """Take the waiting answers; empty during the flood."""
        if clock_ns - self._asked_ns < QUIET_S * NS_PER_S:
            return []
        found = list(self._late)
        self._late.clear()
        return found
