"""Messages of several sensors to frames: bounded, and it counts what it drops.

Every message of the reference role (``image``, else the first of ``REFERENCE_ROLES`` that the log has) makes one frame.
Of each other role it takes the message whose own stamp is nearest, within the tolerance. Messages come in log-time
order and may arrive late: a frame waits until every stream has passed its stamp, at most ``max_wait_s`` of log time.
"""

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from roadperc_stream.core.config import SyncConfig
from roadperc_stream.core.time import seconds_to_ns
from roadperc_stream.input.latched import LatchedState
from roadperc_stream.input.stream import Stamped
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES

_MOST_WAITING: Final = 100
"""Frames that may wait for a silent sensor where all log times are equal."""


@dataclass(frozen=True)
class SyncedMessages:
    """The messages of one instant by role, the reference among them, and what was latched then."""

    reference: Stamped
    parts: Mapping[str, Stamped]
    latched: LatchedState
    skew_ns: int | None


class Synchroniser:
    """Groups messages into frames, in the order of the reference messages; made for one pass over a log."""

    def __init__(self, cfg: SyncConfig, reference: str, roles: Iterable[str], latched: LatchedState) -> None:
        """Prepare for a pass.

        Args:
            cfg: tolerance and longest wait.
            reference: role whose messages make the frames.
            roles: all roles that the log has.
            latched: calibrations and transforms known before the first message.
        """
        self._tolerance_ns, self._max_wait_ns = seconds_to_ns(cfg.tolerance_s), seconds_to_ns(cfg.max_wait_s)
        self._forget_after_ns = seconds_to_ns(2 * cfg.max_wait_s)
        self._reference = reference
        others = (role for role in roles if role != reference and ROLES[role].kind not in LATCHED_KINDS)
        self._streams = {role: deque[Stamped]() for role in others}
        self._latched = latched
        self.frames = 0
        """Frames made so far."""
        self.dropped = Counter[str]()
        """Messages per role that belong to no frame."""

    def synced(self, items: Iterable[Stamped]) -> Iterator[SyncedMessages]:
        """The frames of messages in log-time order."""
        waiting: deque[tuple[Stamped, LatchedState]] = deque()
        for item in items:
            if ROLES[item.role].kind in LATCHED_KINDS:
                self._latched = self._latched.updated(item)
            elif item.role == self._reference:
                waiting.append((item, self._latched))
            elif item.role in self._streams:
                self._streams[item.role].append(item)
            while waiting and (len(waiting) > _MOST_WAITING or self._complete(waiting[0][0], item.log_time_ns)):
                yield self._frame(*waiting.popleft())
            self._forget(item.log_time_ns)
        while waiting:
            yield self._frame(*waiting.popleft())
        self.dropped.update({role: len(stream) for role, stream in self._streams.items() if stream})

    def _complete(self, reference: Stamped, now_ns: int) -> bool:
        """Whether nothing that could still come would fit the frame better."""
        if now_ns - reference.log_time_ns > self._max_wait_ns:
            return True
        return all(stream and stream[-1].stamp_ns >= reference.stamp_ns for stream in self._streams.values())

    def _frame(self, reference: Stamped, latched: LatchedState) -> SyncedMessages:
        parts = {reference.role: reference}
        for role, stream in self._streams.items():
            self._drop_older(role, reference.stamp_ns - self._tolerance_ns)
            nearest = min(stream, key=lambda part: abs(part.stamp_ns - reference.stamp_ns), default=None)
            if nearest is not None and abs(nearest.stamp_ns - reference.stamp_ns) <= self._tolerance_ns:
                parts[role] = nearest
                stream.remove(nearest)
        self.frames += 1
        skews = [abs(part.stamp_ns - reference.stamp_ns) for part in parts.values() if part is not reference]
        return SyncedMessages(reference, parts, latched, max(skews, default=None))

    def _forget(self, now_ns: int) -> None:
        """Drop what no frame can use any more, so that a log whose images stop does not fill the memory."""
        for role, stream in self._streams.items():
            while stream and stream[0].log_time_ns < now_ns - self._forget_after_ns:
                stream.popleft()
                self.dropped[role] += 1

    def _drop_older(self, role: str, limit_ns: int) -> None:
        stream = self._streams[role]
        while stream and stream[0].stamp_ns < limit_ns:
            stream.popleft()
            self.dropped[role] += 1
