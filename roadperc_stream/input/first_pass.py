"""The first pass over what is replayed: what it is, how late it is, and what remains of it for a later part.

The frames are paired as in the replay itself, but every message is waited for as long as one may be late, and without
its content. What is then complete no later message can alter; what waits at the end is left to the next part.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from roadperc_stream.core.config import LimitsConfig
from roadperc_stream.input.latched import LatchedState, without_loops
from roadperc_stream.input.order import OrderConfig
from roadperc_stream.input.pairing import PairingState, StampPairing
from roadperc_stream.input.problems import Problems
from roadperc_stream.input.roles import RoleAssignment
from roadperc_stream.input.state import FrameNumbers, InputState, only_needed, pending, restored
from roadperc_stream.input.stream import Stamped, decoded_messages
from roadperc_stream.input.sync import SyncState
from roadperc_stream.input.transforms import TransformTree
from roadperc_stream.input.window import WindowMessages
from roadperc_stream.log import Message, MessageDigest


@dataclass(frozen=True)
class InputStart:
    """What is known before the first message that is read: latched, or left by an earlier part of the drive."""

    pairing: PairingState[Stamped]
    arrived: TransformTree
    numbers: FrameNumbers = field(default_factory=FrameNumbers)
    parent_of: Mapping[str, str] = field(default_factory=dict)
    from_ns: int = 0
    """Messages of an earlier log time have had their effect."""
    carried: tuple[Message, ...] = ()
    frames_waiting: int = 0
    """Frames of the earlier part that were not complete."""
    is_continuation: bool = False

    def items(
        self, messages: Iterable[Stamped], topics: Mapping[str, str], problems: Problems, limits: LimitsConfig
    ) -> Iterator[Stamped]:
        """Those of the messages that are still to be taken, without transforms that close a loop."""
        new = (item for item in messages if item.log_time_ns >= self.from_ns)
        return without_loops(new, LatchedState(tree=self.arrived), topics, problems, limits)


@dataclass(frozen=True)
class FirstPass:
    """What the first pass found.

    ``counts`` are the messages of each topic, ``parent_of`` the last parent of every frame that a transform places, now
    or in an earlier part; of ``complete_frames`` no later message alters anything, and ``end`` is what the frames after
    them need.
    """

    digest: str
    counts: Counter[str]
    lateness_ns: int
    parent_of: Mapping[str, str]
    complete_frames: int
    end: InputState


def drive_start(latched: LatchedState) -> InputStart:
    """The start of a drive, where some calibrations and transforms hold."""
    return InputStart(PairingState(sync=SyncState(latched)), latched.tree)


def continued_start(state: InputState, roles: RoleAssignment, tag_table: str) -> InputStart:
    """The start of a part that goes on from another.

    Raises:
        StateError: a message that the state carries is not what it says.
    """
    pairing, waiting = restored(state, roles, tag_table), state.frames_waiting
    return InputStart(
        pairing, state.arrived, state.numbers, state.parent_of, state.from_ns, state.carried, waiting, True
    )


@dataclass
class _Tally:
    """What is counted as messages pass by."""

    arrived: TransformTree
    parent_of: dict[str, str]
    digest: MessageDigest = field(default_factory=MessageDigest)
    counts: Counter[str] = field(default_factory=Counter)
    last_ns: int | None = None

    def counted(self, messages: Iterable[Message]) -> Iterator[Message]:
        for message in messages:
            self.digest.update(message)
            self.counts[message.channel.topic] += 1
            self.last_ns = message.log_time_ns
            yield message

    def with_parents(self, items: Iterable[Stamped]) -> Iterator[Stamped]:
        for item in items:
            self.parent_of |= {edge.child: edge.parent for edge in item.edges}
            yield item

    def light(self, items: Iterable[Stamped]) -> Iterator[Stamped]:
        """The items without what is not needed to pair them."""
        for item in items:
            self.arrived = self.arrived.updated(item.edges) if item.edges else self.arrived
            yield item if item.is_latched else replace(item, payload=())


def first_pass(
    reader: WindowMessages, order: OrderConfig, start: InputStart, strict_in: Path | None = None
) -> FirstPass:
    """Read all messages once.

    Args:
        reader: reads them.
        order: which role makes the frames, and how late messages may be.
        start: what is known before the first of them.
        strict_in: names the log, where the first message that cannot be read is an error.

    Raises:
        LogError: the log is damaged.
    """
    roles, cfg = reader.roles, reader.cfg
    tally = _Tally(start.arrived, dict(start.parent_of))
    patient = replace(order, lateness_ns=order.max_wait_ns)
    pairing = StampPairing(cfg.sync, patient, roles.topics, start.pairing, lambda _: None)

    def items(messages: Iterable[Message]) -> Iterator[Stamped]:
        decoded = decoded_messages(tally.counted(messages), roles, cfg.tag_table, Problems(strict_in), cfg.limits)
        known = replace(start, arrived=tally.arrived)
        return tally.light(known.items(tally.with_parents(decoded), roles.topics, Problems(), cfg.limits))

    numbers = start.numbers
    for synced in pairing.through(items(reader.inside())):
        numbers = numbers.after(synced.reference)
    complete_frames, last_ns = pairing.frames, tally.last_ns
    carried, waiting = only_needed(start.carried, pairing.state.mapped(pending))
    end = InputState(
        _from_ns(reader, start, last_ns),
        order.reference,
        roles.topics,
        roles.tag_table,
        dict(tally.parent_of),
        tally.arrived,
        waiting,
        numbers,
        carried,
    )
    for _ in pairing.through(items(reader.late())):
        pass  # only how late they are
    return FirstPass(tally.digest.hexdigest(), tally.counts, pairing.lateness_ns, tally.parent_of, complete_frames, end)


def _from_ns(reader: WindowMessages, start: InputStart, last_ns: int | None) -> int:
    """From where on a later part's messages are new: where this one was cut, else the last message's time."""
    cut_ns = reader.window.cut_ns
    return max(start.from_ns, (last_ns or 0) if cut_ns is None else cut_ns)
