"""Messages of several sensors to frames: bounded, and it counts what it drops.

Every message of the reference role (``image``, else the first of ``REFERENCE_ROLES`` that the log has) makes one frame.
Of each other role it takes the message whose own stamp is nearest, within the tolerance.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from roadperc_stream.input.latched import LatchedState
from roadperc_stream.input.order import Drop, OrderConfig
from roadperc_stream.input.stream import Stamped
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES

T = TypeVar("T")
U = TypeVar("U")


@dataclass(frozen=True)
class SyncedMessages:
    """The messages of one instant by role, the reference among them, and what was latched then."""

    reference: Stamped
    parts: Mapping[str, Stamped]
    latched: LatchedState
    skew_ns: int | None


@dataclass(frozen=True)
class SyncState(Generic[T]):
    """What is remembered of the messages so far; those that wait are of any type that stands for a message.

    ``streams`` are the messages of each role that no frame has taken yet, ``waiting`` the reference messages of the
    frames to come, each with what was latched when it came.
    """

    latched: LatchedState = field(default_factory=LatchedState)
    segment: int = 0
    streams: Mapping[str, tuple[T, ...]] = field(default_factory=dict)
    waiting: tuple[tuple[T, LatchedState], ...] = ()

    def mapped(self, function: Callable[[T], U]) -> "SyncState[U]":
        """The same state with other things in place of the messages."""
        streams = {role: tuple(map(function, items)) for role, items in self.streams.items()}
        waiting = tuple((function(item), latched) for item, latched in self.waiting)
        return SyncState(self.latched, self.segment, streams, waiting)


class Synchroniser:
    """Groups messages into frames, in the order of the reference messages; made for one pass over a log."""

    def __init__(
        self, tolerance_ns: int, order: OrderConfig, roles: Iterable[str], state: SyncState[Stamped], drop: Drop
    ) -> None:
        """Begin, or go on.

        Args:
            tolerance_ns: largest distance of a message's stamp from its frame's.
            order: the role whose messages make the frames, and how long the others' messages are kept for one.
            roles: all roles that the log has.
            state: what an earlier one had come to; at the beginning the calibrations and transforms that are known.
            drop: called with each message that belongs to no frame.
        """
        self._tolerance_ns, self._reference, self._drop = tolerance_ns, order.reference, drop
        self._forget_after_ns = 4 * order.max_wait_ns
        self._latched, self._segment = state.latched, state.segment
        others = (role for role in roles if role != order.reference and ROLES[role].kind not in LATCHED_KINDS)
        self._streams = {role: deque[Stamped](state.streams.get(role, ())) for role in others}
        self._waiting = deque[tuple[Stamped, LatchedState]](state.waiting)
        self._last_ns: int | None = None  # stamp of the latest frame of this segment
        self.frames = 0
        """Frames made so far."""
        self.nearest_ns = dict[str, int]()
        """How near the messages of each role that were dropped came to a frame, at best: differences of stamps."""

    def through(self, items: Iterable[Stamped]) -> Iterator[SyncedMessages]:
        """The frames that some more messages, in the order of their segments and stamps, show to be complete."""
        for item in items:
            if item.segment != self._segment:
                yield from self.rest()
                self._segment, self._last_ns = item.segment, None
            while self._waiting and item.stamp_ns > self._waiting[0][0].stamp_ns + self._tolerance_ns:
                yield self._frame(*self._waiting.popleft())
            self._add(item)

    def rest(self) -> Iterator[SyncedMessages]:
        """The frames of all that is there; nothing remains for a later segment."""
        while self._waiting:
            yield self._frame(*self._waiting.popleft())
        self._drop_before(None)

    @property
    def state(self) -> SyncState[Stamped]:
        """What is remembered, all that ``through`` gives having been consumed."""
        streams = {role: tuple(items) for role, items in self._streams.items() if items}
        return SyncState(self._latched, self._segment, streams, tuple(self._waiting))

    def _add(self, item: Stamped) -> None:
        if item.is_latched:
            self._latched = self._latched.updated(item)
            return
        if item.role == self._reference:
            self._waiting.append((item, self._latched))
        elif item.role in self._streams:
            self._streams[item.role].append(item)
        if self._waiting:
            next_ns = self._waiting[0][0].stamp_ns
            self._drop_before(next_ns - self._tolerance_ns, next_ns)
        self._forget(item.log_time_ns)

    def _forget(self, now_ns: int) -> None:
        """Drop what is old, so that a log whose images stop does not fill the memory."""
        for stream in self._streams.values():
            while stream and stream[0].log_time_ns < now_ns - self._forget_after_ns:
                self._left_out(stream.popleft())

    def _frame(self, reference: Stamped, latched: LatchedState) -> SyncedMessages:
        self._drop_before(reference.stamp_ns - self._tolerance_ns, reference.stamp_ns)
        parts = {reference.role: reference}
        for role, stream in self._streams.items():
            nearest = min(stream, key=lambda part: abs(part.stamp_ns - reference.stamp_ns), default=None)
            if nearest is not None and abs(nearest.stamp_ns - reference.stamp_ns) <= self._tolerance_ns:
                parts[role] = nearest
                stream.remove(nearest)
        self.frames += 1
        self._last_ns = reference.stamp_ns
        skews = [abs(part.stamp_ns - reference.stamp_ns) for part in parts.values() if part is not reference]
        return SyncedMessages(reference, parts, latched, max(skews, default=None))

    def _drop_before(self, limit_ns: int | None, next_ns: int | None = None) -> None:
        """Drop what no frame can use any more, all where there is no limit; the next frame's stamp is ``next_ns``."""
        for stream in self._streams.values():
            while stream and (limit_ns is None or stream[0].stamp_ns < limit_ns):
                self._left_out(stream.popleft(), next_ns)

    def _left_out(self, item: Stamped, next_ns: int | None = None) -> None:
        """Drop a message, and note how near it came to the frame before or the next one."""
        for frame_ns in (self._last_ns, next_ns):
            if frame_ns is not None:
                off_ns = abs(item.stamp_ns - frame_ns)
                self.nearest_ns[item.role] = min(off_ns, self.nearest_ns.get(item.role, off_ns))
        self._drop(item)
