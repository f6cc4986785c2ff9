"""Messages in the order of their arrival to frames in the order of their stamps: ordered first, then synchronised."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from roadperc_stream.core.config import SyncConfig
from roadperc_stream.core.time import seconds_to_ns
from roadperc_stream.input.order import Drop, OrderConfig, OrderState, StampOrder
from roadperc_stream.input.stream import Stamped
from roadperc_stream.input.sync import SyncedMessages, Synchroniser, SyncState

T = TypeVar("T")
U = TypeVar("U")


@dataclass(frozen=True)
class PairingState(Generic[T]):
    """What is remembered of the messages that have arrived, for the frames to come."""

    order: OrderState[T] = field(default_factory=OrderState)
    sync: SyncState[T] = field(default_factory=SyncState)

    def mapped(self, function: Callable[[T], U]) -> "PairingState[U]":
        """The same state with other things in place of the messages."""
        return PairingState(self.order.mapped(function), self.sync.mapped(function))

    @property
    def items(self) -> Iterator[T]:
        """All that stands for a message."""
        yield from self.order.held
        yield from self.order.waiting
        for stream in self.sync.streams.values():
            yield from stream
        yield from (item for item, _ in self.sync.waiting)


class StampPairing:
    """Makes the frames of one pass over a log."""

    def __init__(
        self, cfg: SyncConfig, order: OrderConfig, roles: Mapping[str, str], state: PairingState[Stamped], drop: Drop
    ) -> None:
        """Begin, or go on.

        Args:
            cfg: how far the stamps of a frame's messages may differ.
            order: which role makes the frames, and how long messages are waited for.
            roles: topic of each role that the log has.
            state: what an earlier pass had come to; at the beginning what is latched.
            drop: called with each message that belongs to no frame.
        """
        self._order = StampOrder(order, drop, state.order)
        self._synchroniser = Synchroniser(seconds_to_ns(cfg.tolerance_s), order, roles, state.sync, drop)

    def frames_of(self, items: Iterable[Stamped]) -> Iterator[SyncedMessages]:
        """The frames of all messages of a log."""
        yield from self.through(items)
        yield from self.rest()

    def through(self, items: Iterable[Stamped]) -> Iterator[SyncedMessages]:
        """The frames that some more messages, in the order of the log, show to be complete."""
        return self._synchroniser.through(self._order.through(items))

    def rest(self) -> Iterator[SyncedMessages]:
        """The frames of all that still waits."""
        yield from self._synchroniser.through(self._order.rest())
        yield from self._synchroniser.rest()

    @property
    def state(self) -> PairingState[Stamped]:
        """What is remembered, all frames that ``through`` gives having been consumed."""
        return PairingState(self._order.state, self._synchroniser.state)

    @property
    def frames(self) -> int:
        """Frames made so far."""
        return self._synchroniser.frames

    @property
    def nearest_ns(self) -> Mapping[str, int]:
        """How near the messages of each role that belong to no frame came to one, at best: differences of stamps."""
        return self._synchroniser.nearest_ns

    @property
    def lateness_ns(self) -> int:
        """By how much messages trailed the reference sensor's latest stamp, at most the wait."""
        return self._order.lateness_ns
