"""Sorts the messages of a log by stamp.

Messages in a log are in the order of arrival, but the chain needs the order of measurement: some sensors take longer
than others, and single messages are late. A first pass measures the lateness, so a log without late messages waits
only for the next frame. Any wait of at least the lateness gives the same order. A stamp far from the latest one
belongs to a late message or starts a new segment: the clock was set, or a bag was played in a loop. Of reference
messages with equal stamps, as of two recorders, the first one is used.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from typing import Final

from roadperc_stream.input.decoding import Stamped
from roadperc_stream.system.time import LONGEST_PAUSE_NS, NS_PER_S

_ROW: Final = 3
"""Consecutive reference messages that begin a new segment; fewer count as late messages."""
_MOST_HELD: Final = 10_000
"""The most messages that wait while the reference sensor is silent and log times do not advance."""
_LONGEST_HOLD_NS: Final = 10 * NS_PER_S
"""Longest log time that other messages wait for reference messages that determine their segment."""
_TOO_LATE: Final = "too late"
_AHEAD: Final = "its stamp is more than an hour ahead of the messages around it"
_REPEATED: Final = "an earlier message has the same stamp"
Drop = Callable[[Stamped], None]
"""Receives a message that is left out."""


@dataclass(frozen=True)
class OrderConfig:
    """Settings for sorting the messages of a log.

    ``lateness_ns`` is the largest lag behind the reference sensor's latest stamp, at most ``max_wait_ns``.
    """

    reference: str
    max_wait_ns: int
    lateness_ns: int = 0


class StampOrder:
    """Sorts messages by segment and stamp; latched messages come first among equal stamps.

    A reference message that is too late, or has the stamp of an earlier one, is left out; any other late message comes
    at once. While the reference sensor is silent for long, the other messages do not wait for it.
    """

    def __init__(self, cfg: OrderConfig, drop: Drop) -> None:
        """``drop`` is called with each message that is left out."""
        self._cfg, self._drop = cfg, drop
        self._segments = _Segments(cfg, drop)
        self._given_segment = 0
        self._given_ns: int | None = None  # of the latest reference message
        self._heap: list[tuple[int, bool, int, Stamped]] = []
        self._stamps = set[int]()  # of the reference messages in the heap
        self._number = 0
        self.lateness_ns = 0
        """The largest lag behind the reference sensor's latest stamp, at most the wait; late reference messages do
        not count."""

    def through(self, items: Iterable[Stamped]) -> Iterator[Stamped]:
        """Take more messages in log order; give those that no later message can precede."""
        for item in items:
            if not self._segments.is_off(item):
                self._measure(item)  # it may be held, also at the end of the log
            yield from self._ordered(self._segments.numbered(item))

    def rest(self) -> Iterator[Stamped]:
        """All messages that still wait, at the end of the log."""
        self._cfg = replace(self._cfg, lateness_ns=self._cfg.max_wait_ns)  # the lateness of held ones is not measured
        yield from self._ordered(self._segments.rest(at_end=True))
        yield from self._all()

    @property
    def waiting(self) -> Iterator[Stamped]:
        """The messages that wait for earlier ones."""
        yield from self._segments.held
        yield from (entry[-1] for entry in self._heap)

    def _ordered(self, items: Iterable[Stamped]) -> Iterator[Stamped]:
        for item in items:
            if item.segment != self._given_segment:
                yield from self._all()
                self._given_segment, self._given_ns = item.segment, None
            if self._is_too_late(item):
                self._drop(replace(item, fault=_TOO_LATE))
                continue
            self._measure(item)
            if self._is_repeated(item):
                self._drop(replace(item, fault=_REPEATED))
                continue
            self._add(item)
            while self._heap and self._is_due(self._heap[0][-1], item.log_time_ns, self._segments.latest_ns):
                yield self._next()

    def _measure(self, item: Stamped) -> None:
        latest_ns = self._segments.latest_ns
        if latest_ns is not None:
            self.lateness_ns = max(self.lateness_ns, min(latest_ns - item.stamp_ns, self._cfg.max_wait_ns))

    def _is_too_late(self, item: Stamped) -> bool:
        """Whether the frame of a later stamp was already given out."""
        late = self._given_ns is not None and item.stamp_ns < self._given_ns
        return late and item.role == self._cfg.reference

    def _is_repeated(self, item: Stamped) -> bool:
        """Whether an earlier reference message has the same stamp."""
        is_known = item.stamp_ns == self._given_ns or item.stamp_ns in self._stamps
        return is_known and item.role == self._cfg.reference

    def _is_due(self, item: Stamped, now_ns: int, latest_ns: int | None) -> bool:
        """Whether no earlier message can follow, at log time ``now_ns`` and reference stamp ``latest_ns``."""
        if latest_ns is not None and item.stamp_ns < latest_ns - self._cfg.lateness_ns:
            return True
        is_silent = now_ns - item.log_time_ns > 2 * self._cfg.max_wait_ns
        return is_silent or len(self._heap) > _MOST_HELD

    def _add(self, item: Stamped) -> None:
        heappush(self._heap, (item.stamp_ns, not item.is_latched, self._number, item))
        self._number += 1
        if item.role == self._cfg.reference:
            self._stamps.add(item.stamp_ns)

    def _next(self) -> Stamped:
        item = heappop(self._heap)[-1]
        if item.role == self._cfg.reference:  # another sensor's clock may be ahead
            self._given_ns = item.stamp_ns
            self._stamps.discard(item.stamp_ns)
        return item

    def _all(self) -> Iterator[Stamped]:
        while self._heap:
            yield self._next()


class _Segments:
    """Assigns messages to segments.

    Three consecutive, ascending reference messages with stamps further back than the wait, or more than an hour ahead,
    begin a new segment. Fewer are left out; those ahead begin one at the end of the log.
    """

    def __init__(self, cfg: OrderConfig, drop: Drop) -> None:
        self._cfg, self._drop = cfg, drop
        self.segment = 0
        self.latest_ns: int | None = None
        """Latest stamp of the segment's reference messages."""
        self.held: list[Stamped] = []  # from the first message with a stamp far off
        self.row: list[Stamped] = []

    def numbered(self, item: Stamped) -> Iterator[Stamped]:
        """Take one more message; give the messages whose segment is then known, in order of arrival."""
        is_reference = item.role == self._cfg.reference
        if not self.is_off(item) and (is_reference or not self.held):
            yield from self.rest()
            yield self._passed(item)
            return
        if is_reference and any(item.stamp_ns == known.stamp_ns for known in self.row):
            self._drop(replace(item, fault=_REPEATED))
            return
        if is_reference and self.row and not self._continues_row(item):
            self._drop_row()
        self.held.append(item)
        if is_reference:
            self.row.append(item)
            yield from self._new_segment() if len(self.row) == _ROW else ()
        else:
            yield from self.rest() if len(self.held) > _MOST_HELD else self._too_long_held(item.log_time_ns)

    def rest(self, *, at_end: bool = False) -> Iterator[Stamped]:
        """The held messages, without the reference messages, which are left out; no new segment begins.

        At the end of the log, reference messages that are ahead begin one.
        """
        while at_end and self.row and self._is_ahead(self.row[0]):
            yield from self._new_segment()
        self._drop_row()
        held, self.held = self.held, []
        yield from map(self._passed, held)

    def _is_back(self, item: Stamped) -> bool:
        return self.latest_ns is not None and item.stamp_ns < self.latest_ns - self._cfg.max_wait_ns

    def is_off(self, item: Stamped) -> bool:
        """Whether the stamp is further back than the wait, or more than an hour ahead."""
        return self._is_back(item) or self._is_ahead(item)

    def _is_ahead(self, item: Stamped) -> bool:
        return self.latest_ns is not None and item.stamp_ns > self.latest_ns + LONGEST_PAUSE_NS

    def _continues_row(self, item: Stamped) -> bool:
        return item.stamp_ns > self.row[-1].stamp_ns and self._is_ahead(item) == self._is_ahead(self.row[0])

    def _too_long_held(self, now_ns: int) -> Iterator[Stamped]:
        """The other sensors' messages that waited too long for the reference sensor; no new segment begins."""
        while (place := self._first_of_others()) is not None and self._is_given_up(self.held[place], now_ns):
            yield self._passed(self.held.pop(place))

    def _first_of_others(self) -> int | None:
        first = self.held[: len(self.row) + 1]
        return next((k for k, item in enumerate(first) if item.role != self._cfg.reference), None)

    def _is_given_up(self, item: Stamped, now_ns: int) -> bool:
        is_alone = not self.row and not self.is_off(item)
        return is_alone or now_ns - item.log_time_ns > _LONGEST_HOLD_NS

    def _new_segment(self) -> Iterator[Stamped]:
        is_new = self._is_ahead if self._is_ahead(self.row[0]) else self._is_back
        old = [item for item in self.held if not is_new(item)]
        new = [item for item in self.held if is_new(item)]
        self.held, self.row = [], []
        yield from map(self._passed, old)
        self.segment, self.latest_ns = self.segment + 1, None
        for item in new:  # may begin another segment
            yield from self.numbered(item)

    def _drop_row(self) -> None:
        for item in self.row:
            self._drop(replace(item, fault=_AHEAD if self._is_ahead(item) else _TOO_LATE))
        self.held = [item for item in self.held if item.role != self._cfg.reference]
        self.row = []

    def _passed(self, item: Stamped) -> Stamped:
        if item.role == self._cfg.reference:
            self.latest_ns = item.stamp_ns if self.latest_ns is None else max(self.latest_ns, item.stamp_ns)
        return replace(item, segment=self.segment) if self.segment else item
