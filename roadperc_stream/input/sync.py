"""Synchronises the messages of several sensors to frames, with bounded memory.

Messages are sorted by stamp, then synchronised. Each message of the reference role makes one frame. The reference
role is ``image``, else the first of ``REFERENCE_ROLES`` in the log. From each other role a frame takes the message with
the nearest stamp, within the tolerance. Calibrations and transforms hold until they are replaced.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain

from roadperc_stream.config import SyncConfig
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.order import Drop, OrderConfig, StampOrder
from roadperc_stream.input.transforms import LatchedState
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES
from roadperc_stream.system.time import seconds_to_ns

Paired = Mapping[str, Stamped]
"""The messages of one instant by role; the first one is the reference message, which has the latched state."""


def reference_of(paired: Paired) -> Stamped:
    """The reference message of an instant."""
    return next(iter(paired.values()))


def skew_ns(paired: Paired) -> int | None:
    """The largest distance of another message's stamp to that of the reference; None without another one."""
    stamp_ns, *others = (item.stamp_ns for item in paired.values())
    return max((abs(other_ns - stamp_ns) for other_ns in others), default=None)


class StampPairing:
    """Makes the frames of one pass over a log: sorts the messages by stamp, then synchronises them."""

    def __init__(
        self, cfg: SyncConfig, order: OrderConfig, roles: Iterable[str], latched: LatchedState, drop: Drop
    ) -> None:
        """Start with the calibrations and transforms that hold at the beginning.

        ``drop`` is called with each message that belongs to no frame.
        """
        self._order = StampOrder(order, drop)
        self._tolerance_ns, self._reference, self._drop = seconds_to_ns(cfg.tolerance_s), order.reference, drop
        self._forget_after_ns = 4 * order.max_wait_ns
        self._latched, self._segment = latched, 0
        others = (role for role in roles if role != order.reference and ROLES[role].kind not in LATCHED_KINDS)
        self._streams = {role: deque[Stamped]() for role in others}
        self._waiting = deque[Stamped]()
        self._last_ns: int | None = None  # stamp of the latest frame of this segment
        self.nearest_ns = dict[str, int]()
        """Smallest distance of each role's dropped messages to a frame, as difference of stamps."""

    def frames_of(self, items: Iterable[Stamped]) -> Iterator[Paired]:
        """The frames of messages in log order."""
        yield from self._synced(self._order.through(items))
        yield from self._synced(self._order.rest())
        yield from self._rest()

    def since_ns(self, frame: Paired) -> int:
        """The earliest log time of the messages of the latest frame, and of those that later frames may take."""
        items = chain(frame.values(), *self._streams.values(), self._waiting, self._order.waiting)
        return min(item.log_time_ns for item in items)

    def _synced(self, items: Iterable[Stamped]) -> Iterator[Paired]:
        """Take more messages, sorted by segment and stamp; give the frames that are then complete."""
        for item in items:
            if item.segment != self._segment:
                yield from self._rest()
                self._segment, self._last_ns = item.segment, None
            while self._waiting and item.stamp_ns > self._waiting[0].stamp_ns + self._tolerance_ns:
                yield self._frame(self._waiting.popleft())
            self._add(item)

    def _rest(self) -> Iterator[Paired]:
        """The frames of all pending messages, at the end of a segment."""
        while self._waiting:
            yield self._frame(self._waiting.popleft())
        self._drop_before(None)

    def _add(self, item: Stamped) -> None:
        if item.is_latched:
            self._latched = self._latched.updated(item.role, item.payload)
            return
        if item.role == self._reference:
            self._waiting.append(replace(item, latched=self._latched))
        elif item.role in self._streams:
            self._streams[item.role].append(item)
        if self._waiting:
            next_ns = self._waiting[0].stamp_ns
            self._drop_before(next_ns - self._tolerance_ns, next_ns)
        self._forget(item.log_time_ns)

    def _forget(self, now_ns: int) -> None:
        """Drop old messages, so that memory stays bounded when the images stop."""
        for stream in self._streams.values():
            while stream and stream[0].log_time_ns < now_ns - self._forget_after_ns:
                self._left_out(stream.popleft())

    def _frame(self, reference: Stamped) -> Paired:
        self._drop_before(reference.stamp_ns - self._tolerance_ns, reference.stamp_ns)
        messages = {reference.role: reference}
        for role, stream in self._streams.items():
            nearest = min(stream, key=lambda part: abs(part.stamp_ns - reference.stamp_ns), default=None)
            if nearest is not None and abs(nearest.stamp_ns - reference.stamp_ns) <= self._tolerance_ns:
                messages[role] = nearest
                stream.remove(nearest)
        self._last_ns = reference.stamp_ns
        return messages

    def _drop_before(self, limit_ns: int | None, next_ns: int | None = None) -> None:
        """Drop messages before a limit, or all without one; ``next_ns`` is the next frame's stamp."""
        for stream in self._streams.values():
            while stream and (limit_ns is None or stream[0].stamp_ns < limit_ns):
                self._left_out(stream.popleft(), next_ns)

    def _left_out(self, item: Stamped, next_ns: int | None = None) -> None:
        """Drop a message, and record its distance to the previous or next frame."""
        for frame_ns in (self._last_ns, next_ns):
            if frame_ns is not None:
                off_ns = abs(item.stamp_ns - frame_ns)
                self.nearest_ns[item.role] = min(off_ns, self.nearest_ns.get(item.role, off_ns))
        self._drop(item)
