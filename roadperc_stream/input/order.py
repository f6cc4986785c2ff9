"""Messages in the order of their stamps, whatever the order in which they arrived.

A log stands in the order of arrival: one sensor's messages take longer than another's, and single ones are late. The
chain wants the order in which they were measured. How late messages are is measured in a first pass over the log, so
that where nothing is late only the next frame is waited for; the order that comes out is the same however long is
waited, as long as that is not less than they are late. A stamp far before the latest one is a straggler, or the
beginning of another recording: the clock was set back, or a bag was played in a loop. Then a new segment begins.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from typing import Final, Generic, TypeVar

from roadperc_stream.input.stream import Stamped
from roadperc_stream.system.time import NS_PER_S

_ROW: Final = 3
"""Reference messages in a row that begin a new segment: fewer are stragglers."""
_MOST_HELD: Final = 10_000
"""Messages that wait at most, where the reference sensor is silent and log times say nothing."""
_LONGEST_HOLD_NS: Final = 10 * NS_PER_S
"""Log time that other messages wait for the reference sensor to show to which segment they belong."""
T = TypeVar("T")
U = TypeVar("U")
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


@dataclass(frozen=True)
class OrderState(Generic[T]):
    """What is kept of the messages so far; those that wait are of any type that represents a message.

    ``held`` are those from the first message on that lies far back. ``waiting`` are those of the segment
    ``given_segment`` that wait for earlier ones, in the order in which they would be given out.
    """

    segment: int = 0
    latest_ns: int | None = None
    held: tuple[T, ...] = ()
    waiting: tuple[T, ...] = ()
    given_segment: int = 0
    given_ns: int | None = None

    def mapped(self, function: Callable[[T], U]) -> "OrderState[U]":
        """The same state with other things in place of the messages."""
        held, waiting = tuple(map(function, self.held)), tuple(map(function, self.waiting))
        return OrderState(self.segment, self.latest_ns, held, waiting, self.given_segment, self.given_ns)


class StampOrder:
    """Gives messages segment by segment, each in the order of its stamps; of equal stamps what is latched comes first.

    A reference message that comes too late for its place is left out; any other comes at once. Where the reference
    sensor is silent for long, the others' messages come without waiting for it.
    """

    def __init__(self, cfg: OrderConfig, drop: Drop, state: OrderState[Stamped] | None = None) -> None:
        """Begin, or go on.

        Args:
            cfg: how far a message may be late.
            drop: called with each message that is left out.
            state: what an earlier order had come to; None at the beginning.
        """
        state = state or OrderState()
        self._cfg, self._drop = cfg, drop
        self._segments = _Segments(cfg, drop, state)
        self._given_segment, self._given_ns = state.given_segment, state.given_ns  # of the latest reference message
        self._heap: list[tuple[int, bool, int, Stamped]] = []
        self._number = 0
        for item in state.waiting:
            self._add(item)
        self.lateness_ns = 0
        """By how much messages trailed the reference sensor's latest stamp, at most the wait; stragglers among the
        reference messages do not count."""

    def through(self, items: Iterable[Stamped]) -> Iterator[Stamped]:
        """What comes before all that can still follow some more messages, which are in the order of the log."""
        for item in items:
            yield from self._ordered(self._segments.numbered(item))

    def rest(self) -> Iterator[Stamped]:
        """All that still waits: nothing follows."""
        yield from self._ordered(self._segments.rest())
        yield from self._all()

    @property
    def state(self) -> OrderState[Stamped]:
        """What is kept, all that ``through`` gives having been consumed."""
        found = self._segments
        waiting = tuple(entry[-1] for entry in sorted(self._heap, key=lambda entry: entry[:3]))
        given = self._given_segment, self._given_ns
        return OrderState(found.segment, found.latest_ns, tuple(found.held), waiting, *given)

    def _ordered(self, items: Iterable[Stamped]) -> Iterator[Stamped]:
        for item in items:
            if item.segment != self._given_segment:
                yield from self._all()
                self._given_segment, self._given_ns = item.segment, None
            if self._is_too_late(item):
                self._drop(item)
                continue
            latest_ns = self._segments.latest_ns
            if latest_ns is not None:
                self.lateness_ns = max(self.lateness_ns, min(latest_ns - item.stamp_ns, self._cfg.max_wait_ns))
            self._add(item)
            while self._heap and self._is_due(self._heap[0][-1], item.log_time_ns, latest_ns):
                yield self._next()

    def _is_too_late(self, item: Stamped) -> bool:
        """Whether the frame of a later stamp was given out already."""
        late = self._given_ns is not None and item.stamp_ns < self._given_ns
        return late and item.role == self._cfg.reference

    def _is_due(self, item: Stamped, now_ns: int, latest_ns: int | None) -> bool:
        """Whether no earlier message can follow, at a log time and the latest stamp of a reference message."""
        if latest_ns is not None and item.stamp_ns < latest_ns - self._cfg.lateness_ns:
            return True
        is_silent = now_ns - item.log_time_ns > 2 * self._cfg.max_wait_ns
        return is_silent or len(self._heap) > _MOST_HELD

    def _add(self, item: Stamped) -> None:
        heappush(self._heap, (item.stamp_ns, not item.is_latched, self._number, item))
        self._number += 1

    def _next(self) -> Stamped:
        item = heappop(self._heap)[-1]
        if item.role == self._cfg.reference:  # another sensor's clock may be ahead
            self._given_ns = item.stamp_ns
        return item

    def _all(self) -> Iterator[Stamped]:
        while self._heap:
            yield self._next()


class _Segments:
    """Numbers messages by their segment.

    Where three reference messages in a row, ascending among themselves, lie further back than any message is waited
    for, a new segment begins with the first of them. Fewer are left out.
    """

    def __init__(self, cfg: OrderConfig, drop: Drop, state: OrderState[Stamped]) -> None:
        self._cfg, self._drop = cfg, drop
        self.segment = state.segment
        self.latest_ns = state.latest_ns
        """Latest stamp of the segment's reference messages."""
        self.held = list(state.held)  # from the first message on that lies far back
        self.row = [item for item in state.held if item.role == cfg.reference]

    def numbered(self, item: Stamped) -> Iterator[Stamped]:
        """The messages that one more decides about, with their segments, in the order in which they came."""
        is_reference, is_back = item.role == self._cfg.reference, self._is_back(item)
        if not is_back and (is_reference or not self.held):
            yield from self.rest()
            yield self._passed(item)
            return
        if is_reference and self.row and item.stamp_ns <= self.row[-1].stamp_ns:
            self._drop_row()
        self.held.append(item)
        if is_reference:
            self.row.append(item)
            yield from self._new_segment() if len(self.row) == _ROW else ()
        else:
            yield from self.rest() if len(self.held) > _MOST_HELD else self._too_long_held(item.log_time_ns)

    def rest(self) -> Iterator[Stamped]:
        """What is held, where it is of the same segment; its reference messages are too late."""
        self._drop_row()
        held, self.held = self.held, []
        yield from map(self._passed, held)

    def _is_back(self, item: Stamped) -> bool:
        return self.latest_ns is not None and item.stamp_ns < self.latest_ns - self._cfg.max_wait_ns

    def _too_long_held(self, now_ns: int) -> Iterator[Stamped]:
        """The other sensors' messages about which the reference sensor was silent for too long: nothing new begins."""
        while (place := self._first_of_others()) is not None and self._is_given_up(self.held[place], now_ns):
            yield self._passed(self.held.pop(place))

    def _first_of_others(self) -> int | None:
        first = self.held[: len(self.row) + 1]
        return next((k for k, item in enumerate(first) if item.role != self._cfg.reference), None)

    def _is_given_up(self, item: Stamped, now_ns: int) -> bool:
        is_alone = not self.row and not self._is_back(item)
        return is_alone or now_ns - item.log_time_ns > _LONGEST_HOLD_NS

    def _new_segment(self) -> Iterator[Stamped]:
        old = [item for item in self.held if not self._is_back(item)]
        new = [item for item in self.held if self._is_back(item)]
        self.held, self.row = [], []
        yield from map(self._passed, old)
        self.segment, self.latest_ns = self.segment + 1, None
        yield from map(self._passed, new)

    def _drop_row(self) -> None:
        for item in self.row:
            self._drop(item)
        self.held = [item for item in self.held if item.role != self._cfg.reference]
        self.row = []

    def _passed(self, item: Stamped) -> Stamped:
        if item.role == self._cfg.reference:
            self.latest_ns = item.stamp_ns if self.latest_ns is None else max(self.latest_ns, item.stamp_ns)
        return replace(item, segment=self.segment) if self.segment else item
