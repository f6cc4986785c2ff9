"""Synchronises the messages of several sensors to frames, with bounded memory.

Messages are sorted by stamp, then synchronised. Each message of the reference role makes one frame. The reference
role is ``image``, else the first of ``REFERENCE_ROLES`` in the log. From each other role a frame takes the message with
the nearest stamp, within the tolerance. Calibrations and transforms hold until they are replaced.
"""

from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Generic, TypeVar

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig, SyncConfig
from roadperc_stream.geometry import Camera
from roadperc_stream.input.order import Drop, OrderConfig, OrderState, StampOrder
from roadperc_stream.input.stream import Problems, Stamped
from roadperc_stream.input.transforms import TransformTree
from roadperc_stream.model import Transform
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES
from roadperc_stream.system.time import seconds_to_ns

_MOST_EDGES_NAMED: Final = 3
"""Transforms that a problem text lists."""
T = TypeVar("T")
U = TypeVar("U")


@dataclass(frozen=True)
class LatchedState:
    """The camera of each calibration role and the transform tree at one instant."""

    cameras: Mapping[str, Camera] = field(default_factory=dict)
    tree: TransformTree = field(default_factory=TransformTree)

    def updated(self, item: Stamped) -> "LatchedState":
        """The state after a calibration or transforms message."""
        if isinstance(item.payload, Camera):
            return LatchedState({**self.cameras, item.role: item.payload}, self.tree)
        return LatchedState(self.cameras, self.tree.updated(item.edges))


def without_loops(
    items: Iterable[Stamped],
    tree: TransformTree,
    topics: Mapping[str, str],
    problems: Problems,
    limits: LimitsConfig = DEFAULT_LIMITS,
) -> Iterator[Stamped]:
    """Leave out and report transforms that close a loop or exceed the limit.

    ``items`` are in the order in which they take effect; ``tree`` are the transforms before the first one.
    """
    for item in items:
        edges = item.edges
        if not edges:
            yield item
            continue
        fitting = tree.fitting(edges, limits.transforms)
        looping = tree.looping(fitting)
        kept = tuple(edge for edge in fitting if edge.child not in looping)
        topic = topics[item.role]
        at = f"{topic}: message at {item.log_time_ns} ns"
        if len(fitting) < len(edges):
            beyond = {edge.child for edge in edges} - {edge.child for edge in fitting}
            problems.report(topic, f"{at}: {len(beyond)} transforms to more frames than {limits.transforms}: left out")
        if looping:
            problems.report(topic, f"{at}: {_loop_in_words(fitting, looping)}")
        if kept:
            tree = tree.updated(kept)
            yield item if len(kept) == len(edges) else replace(item, payload=kept)


def _loop_in_words(edges: Iterable[Transform], children: Collection[str]) -> str:
    names = [f"{edge.parent!r} to {edge.child!r}" for edge in edges if edge.child in children]
    some = ", ".join(names[:_MOST_EDGES_NAMED]) + ", ..." * (len(names) > _MOST_EDGES_NAMED)
    return f"a loop of transforms ({some}), expected a tree: left out"


@dataclass(frozen=True)
class SyncedMessages:
    """The messages of one instant by role, including the reference, and the latched state."""

    reference: Stamped
    messages: Mapping[str, Stamped]
    latched: LatchedState
    skew_ns: int | None


@dataclass(frozen=True)
class PairingState(Generic[T]):
    """The state of the pairing between messages; ``T`` is any type that represents a message.

    ``streams`` has the messages of each role that no frame has taken yet. ``waiting`` has the reference messages of
    incomplete frames, each with the latched state at its arrival.
    """

    order: OrderState[T] = field(default_factory=OrderState)
    latched: LatchedState = field(default_factory=LatchedState)
    segment: int = 0
    streams: Mapping[str, tuple[T, ...]] = field(default_factory=dict)
    waiting: tuple[tuple[T, LatchedState], ...] = ()

    def mapped(self, function: Callable[[T], U]) -> "PairingState[U]":
        """The same state with ``function`` applied to each message."""
        streams = {role: tuple(map(function, items)) for role, items in self.streams.items()}
        waiting = tuple((function(item), latched) for item, latched in self.waiting)
        return PairingState(self.order.mapped(function), self.latched, self.segment, streams, waiting)

    @property
    def items(self) -> Iterator[T]:
        """All messages in the state."""
        yield from self.order.held
        yield from self.order.waiting
        for stream in self.streams.values():
            yield from stream
        yield from (item for item, _ in self.waiting)


class StampPairing:
    """Makes the frames of one pass over a log: sorts the messages by stamp, then synchronises them."""

    def __init__(
        self, cfg: SyncConfig, order: OrderConfig, roles: Iterable[str], state: PairingState[Stamped], drop: Drop
    ) -> None:
        """Start, or continue from a state.

        ``state`` is that of an earlier pass, at the beginning only the latched state. ``drop`` is called with each
        message that belongs to no frame.
        """
        self._order = StampOrder(order, drop, state.order)
        self._tolerance_ns, self._reference, self._drop = seconds_to_ns(cfg.tolerance_s), order.reference, drop
        self._forget_after_ns = 4 * order.max_wait_ns
        self._latched, self._segment = state.latched, state.segment
        others = (role for role in roles if role != order.reference and ROLES[role].kind not in LATCHED_KINDS)
        self._streams = {role: deque[Stamped](state.streams.get(role, ())) for role in others}
        self._waiting = deque[tuple[Stamped, LatchedState]](state.waiting)
        self._last_ns: int | None = None  # stamp of the latest frame of this segment
        self.frames = 0
        """Number of frames until now."""
        self.nearest_ns = dict[str, int]()
        """Smallest distance of each role's dropped messages to a frame, as difference of stamps."""

    def frames_of(self, items: Iterable[Stamped]) -> Iterator[SyncedMessages]:
        """The frames of all messages of a log."""
        yield from self.through(items)
        yield from self._synced(self._order.rest())
        yield from self._rest()

    def through(self, items: Iterable[Stamped]) -> Iterator[SyncedMessages]:
        """Take more messages in log order; give the frames that are then complete."""
        return self._synced(self._order.through(items))

    @property
    def state(self) -> PairingState[Stamped]:
        """The current state; consume all of ``through`` first."""
        streams = {role: tuple(items) for role, items in self._streams.items() if items}
        return PairingState(self._order.state, self._latched, self._segment, streams, tuple(self._waiting))

    @property
    def lateness_ns(self) -> int:
        """The largest lag behind the reference sensor's latest stamp, at most the wait."""
        return self._order.lateness_ns

    def _synced(self, items: Iterable[Stamped]) -> Iterator[SyncedMessages]:
        """Take more messages, sorted by segment and stamp; give the frames that are then complete."""
        for item in items:
            if item.segment != self._segment:
                yield from self._rest()
                self._segment, self._last_ns = item.segment, None
            while self._waiting and item.stamp_ns > self._waiting[0][0].stamp_ns + self._tolerance_ns:
                yield self._frame(*self._waiting.popleft())
            self._add(item)

    def _rest(self) -> Iterator[SyncedMessages]:
        """The frames of all pending messages, at the end of a segment."""
        while self._waiting:
            yield self._frame(*self._waiting.popleft())
        self._drop_before(None)

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
        """Drop old messages, so that memory stays bounded when the images stop."""
        for stream in self._streams.values():
            while stream and stream[0].log_time_ns < now_ns - self._forget_after_ns:
                self._left_out(stream.popleft())

    def _frame(self, reference: Stamped, latched: LatchedState) -> SyncedMessages:
        self._drop_before(reference.stamp_ns - self._tolerance_ns, reference.stamp_ns)
        messages = {reference.role: reference}
        for role, stream in self._streams.items():
            nearest = min(stream, key=lambda part: abs(part.stamp_ns - reference.stamp_ns), default=None)
            if nearest is not None and abs(nearest.stamp_ns - reference.stamp_ns) <= self._tolerance_ns:
                messages[role] = nearest
                stream.remove(nearest)
        self.frames += 1
        self._last_ns = reference.stamp_ns
        skews = [abs(part.stamp_ns - reference.stamp_ns) for part in messages.values() if part is not reference]
        return SyncedMessages(reference, messages, latched, max(skews, default=None))

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
