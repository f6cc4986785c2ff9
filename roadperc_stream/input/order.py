"""Messages in the order of their stamps, whatever the order in which they arrived.

A log stands in the order of arrival: one sensor's messages take longer than another's, and single ones are late. The
chain wants the order in which they were measured. How late messages are is measured in a first pass over the log, so
that where nothing is late only the next frame is waited for. A stamp far before the latest one is a straggler, or the
beginning of another recording: the clock was set back, or a bag was played in a loop. Then a new segment begins.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from typing import Final

from roadperc_stream.input.stream import Stamped

_ROW: Final = 3
"""Reference messages in a row that begin a new segment: fewer are stragglers."""
_MOST_HELD: Final = 10_000
"""Messages that wait at most, where the reference sensor is silent and log times say nothing."""
Drop = Callable[[Stamped], None]
"""Takes a message that is left out."""


@dataclass(frozen=True)
class OrderConfig:
    """How the messages of a log are put in order.

    ``lateness_ns`` is by how much messages trail the reference sensor's latest stamp, at most ``max_wait_ns``.
    """

    reference: str
    max_wait_ns: int
    lateness_ns: int = 0


def lateness_ns(items: Iterable[Stamped], cfg: OrderConfig) -> int:
    """By how much the stamps of messages trail the reference sensor's latest; stragglers do not count.

    Args:
        items: in the order of the log.
        cfg: its ``lateness_ns`` is not used.
    """
    most_ns, segments = 0, _Segments(cfg, lambda _: None)
    for item in segments.numbered(items):
        late_ns = 0 if segments.latest_ns is None else segments.latest_ns - item.stamp_ns
        most_ns = max(most_ns, late_ns if late_ns <= cfg.max_wait_ns else 0)
    return most_ns


def in_stamp_order(items: Iterable[Stamped], cfg: OrderConfig, drop: Drop) -> Iterator[Stamped]:
    """The messages segment by segment, each in the order of its stamps; of equal stamps what is latched comes first.

    A reference message that comes too late for its place is left out; any other comes at once. Where the reference
    sensor is silent for long, the others' messages come without waiting for it.

    Args:
        items: in the order of the log.
        cfg: how far a message may be late.
        drop: called with each message that is left out.
    """
    buffer = _Buffer(cfg)
    for item in _Segments(cfg, drop).numbered(items):
        if item.segment != buffer.segment:
            yield from buffer.rest()
            buffer = _Buffer(cfg, item.segment)
        if buffer.is_too_late(item):
            drop(item)
        else:
            buffer.add(item)
            yield from buffer.due(item.log_time_ns)
    yield from buffer.rest()


class _Segments:
    """Numbers messages by their segment.

    Where three reference messages in a row, ascending among themselves, lie further back than any message is waited
    for, a new segment begins with the first of them. Fewer are left out.
    """

    def __init__(self, cfg: OrderConfig, drop: Drop) -> None:
        self._cfg, self._drop = cfg, drop
        self._segment = 0
        self.latest_ns: int | None = None
        """Latest stamp of the segment's reference messages."""
        self._held: list[Stamped] = []  # from the first message on that lies far back
        self._row: list[Stamped] = []  # the reference messages among them

    def numbered(self, items: Iterable[Stamped]) -> Iterator[Stamped]:
        """The messages with their segments, in the order in which they came."""
        for item in items:
            if self._held or self._is_back(item):
                self._held.append(item)
                yield from self._decided(item)
            else:
                yield self._passed(item)
        yield from self._same_segment()

    def _is_back(self, item: Stamped) -> bool:
        return self.latest_ns is not None and item.stamp_ns < self.latest_ns - self._cfg.max_wait_ns

    def _decided(self, item: Stamped) -> Iterable[Stamped]:
        """What is held, where the last of it shows to which segment it belongs; nothing until then."""
        if item.role != self._cfg.reference:
            return self._same_segment() if len(self._held) > _MOST_HELD else ()
        if not self._is_back(item):
            return self._same_segment()
        if self._row and item.stamp_ns <= self._row[-1].stamp_ns:
            self._drop_row()
        self._row.append(item)
        return self._new_segment() if len(self._row) == _ROW else ()

    def _same_segment(self) -> Iterator[Stamped]:
        self._drop_row()
        held, self._held = self._held, []
        yield from map(self._passed, held)

    def _new_segment(self) -> Iterator[Stamped]:
        old = [item for item in self._held if not self._is_back(item)]
        new = [item for item in self._held if self._is_back(item)]
        self._held, self._row = [], []
        yield from map(self._passed, old)
        self._segment, self.latest_ns = self._segment + 1, None
        yield from map(self._passed, new)

    def _drop_row(self) -> None:
        for item in self._row:
            self._drop(item)
        self._held = [item for item in self._held if not any(item is other for other in self._row)]
        self._row = []

    def _passed(self, item: Stamped) -> Stamped:
        if item.role == self._cfg.reference:
            self.latest_ns = item.stamp_ns if self.latest_ns is None else max(self.latest_ns, item.stamp_ns)
        return replace(item, segment=self._segment) if self._segment else item


class _Buffer:
    """The messages of a segment that wait for earlier ones."""

    def __init__(self, cfg: OrderConfig, segment: int = 0) -> None:
        self._cfg, self.segment = cfg, segment
        self._waiting: list[tuple[int, bool, int, Stamped]] = []
        self._number = 0
        self._latest_ns: int | None = None
        self._given_ns: int | None = None

    def is_too_late(self, item: Stamped) -> bool:
        """Whether the frame of a later stamp was given out already."""
        late = self._given_ns is not None and item.stamp_ns < self._given_ns
        return late and item.role == self._cfg.reference

    def add(self, item: Stamped) -> None:
        """Take one more message."""
        heappush(self._waiting, (item.stamp_ns, not item.is_latched, self._number, item))
        self._number += 1
        if item.role == self._cfg.reference:
            self._latest_ns = item.stamp_ns if self._latest_ns is None else max(self._latest_ns, item.stamp_ns)

    def due(self, now_ns: int) -> Iterator[Stamped]:
        """What no earlier message can follow any more, at a log time."""
        while self._waiting and self._is_due(self._waiting[0][-1], now_ns):
            yield self._next()

    def rest(self) -> Iterator[Stamped]:
        """All that still waits."""
        while self._waiting:
            yield self._next()

    def _is_due(self, item: Stamped, now_ns: int) -> bool:
        if self._latest_ns is not None and item.stamp_ns < self._latest_ns - self._cfg.lateness_ns:
            return True
        is_silent = now_ns - item.log_time_ns > 2 * self._cfg.max_wait_ns
        return is_silent or len(self._waiting) > _MOST_HELD

    def _next(self) -> Stamped:
        item = heappop(self._waiting)[-1]
        if item.role == self._cfg.reference:  # another sensor's clock may be ahead
            self._given_ns = item.stamp_ns
        return item
