"""The state of the input between a log and its continuation: messages of incomplete frames, frame numbers."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from roadperc_stream.config import LimitsConfig
from roadperc_stream.errors import DecodeError, StateError
from roadperc_stream.formats.images import require_pixels
from roadperc_stream.geometry import Camera
from roadperc_stream.input.stream import (
    MessagePlace,
    Problems,
    RoleAssignment,
    Stamped,
    decoded_messages,
    in_their_places,
)
from roadperc_stream.input.sync import PairingState
from roadperc_stream.input.transforms import TransformTree
from roadperc_stream.log import Message
from roadperc_stream.model import Transform
from roadperc_stream.schemas.roles import ROLES


@dataclass(frozen=True)
class FrameNumbers:
    """The number of the next frame that is written, and the log time of the last one.

    Until a frame comes whose message arrived at ``written_from_ns`` or later the chain only warms up, and nothing is
    written.
    """

    next: int = 0
    log_time_ns: int = 0
    written_from_ns: int | None = None

    def is_written(self, reference: Stamped) -> bool:
        """Whether the frame of a reference message is written."""
        return self.written_from_ns is None or reference.log_time_ns >= self.written_from_ns

    def after(self, reference: Stamped) -> "FrameNumbers":
        """The numbers after its frame."""
        if not self.is_written(reference):
            return self
        return FrameNumbers(self.next + 1, max(self.log_time_ns, reference.log_time_ns))


@dataclass(frozen=True)
class PendingMessage:
    """A message that waits: of calibrations and transforms the content, of any other its place."""

    role: str
    log_time_ns: int
    stamp_ns: int
    segment: int
    place: MessagePlace
    camera: Camera | None = None
    edges: tuple[Transform, ...] | None = None


@dataclass(frozen=True)
class InputState:
    """All that the frames still to come need of the messages that have arrived.

    As if every message were waited for as long as a message may be late: so what it holds depends neither on where the
    log was cut nor on how late its messages happened to be.
    """

    from_ns: int
    """Log time from which on messages are still to come."""
    reference: str
    topics: Mapping[str, str]
    """Of each role of the log."""
    tag_table: str
    parent_of: Mapping[str, str]
    """The last parent of every frame that a transform has placed."""
    arrived: TransformTree
    """Of all transforms that have arrived: a later one that closes a loop is left out."""
    pairing: PairingState[PendingMessage]
    numbers: FrameNumbers = field(default_factory=FrameNumbers)
    carried: tuple[Message, ...] = ()
    """Messages that no log of the next part holds."""

    @property
    def frames_waiting(self) -> int:
        """Reference messages whose frames are still to come."""
        return sum(item.role == self.reference for item in self.pairing.items)

    @property
    def next_ns(self) -> int:
        """The first log time of which no message has had its effect yet: behind the last message, or at a cut."""
        return self.from_ns + any(message.log_time_ns == self.from_ns for message in self.carried)

    def require_usable(self, limits: LimitsConfig) -> None:
        """Check a state that was read as a log's own messages are checked: roles, cameras and transforms.

        Raises:
            StateError: one is beyond the limits, unknown, or the transforms are no tree.
        """
        latched = (self.pairing.sync.latched, *(held for _, held in self.pairing.sync.waiting))
        cameras = [camera for held in latched for camera in held.cameras.values()]
        cameras += [item.camera for item in self.pairing.items if item.camera is not None]
        unknown = {self.reference, *self.topics, *(item.role for item in self.pairing.items)} - ROLES.keys()
        if unknown:
            raise StateError(f"damaged: unknown roles {', '.join(sorted(unknown))}")
        try:
            for camera in cameras:
                require_pixels(f"camera {camera.frame_id!r}", camera.width, camera.height, limits)
        except DecodeError as error:
            raise StateError(f"damaged: {error}") from error
        for tree in (self.arrived, *(held.tree for held in latched)):
            if len(tree.edges) > limits.transforms or TransformTree().looping(tree.edges.values()):
                raise StateError(f"damaged: transforms: expected a tree of at most {limits.transforms}")

    def carrying(self, messages: Iterable[Message]) -> "InputState":
        """The same state with the messages in it that it names by their places.

        Args:
            messages: of the log that the places are in, at least from ``first_pending_ns`` on.

        Raises:
            StateError: one is not there.
        """
        carried = list(self.carried)
        numbers = {place: k for k, place in enumerate(_places_in_log(self.pairing.items), start=len(carried))}
        found = {
            key: message
            for message, place in in_their_places(messages, set(self.topics.values()))
            if (key := (message.log_time_ns, place.number)) in numbers
        }
        if len(found) < len(numbers):
            raise StateError(f"{len(numbers) - len(found)} of {len(numbers)} messages it needs are not in its log")
        carried += [replace(found[key], channel=replace(found[key].channel, source_id=0)) for key in numbers]

        def moved(item: PendingMessage) -> PendingMessage:
            if item.place.carried or _has_content(item):
                return item
            return replace(item, place=MessagePlace(numbers[item.log_time_ns, item.place.number], carried=True))

        return replace(self, pairing=self.pairing.mapped(moved), carried=tuple(carried))

    @property
    def first_pending_ns(self) -> int | None:
        """Log time of the first message that it names by its place; None without one."""
        return min((time_ns for time_ns, _ in _places_in_log(self.pairing.items)), default=None)


def pending(item: Stamped) -> PendingMessage:
    """What is kept of a message that waits."""
    kept = PendingMessage(item.role, item.log_time_ns, item.stamp_ns, item.segment, item.place)
    if isinstance(item.payload, Camera):
        return replace(kept, camera=item.payload, place=MessagePlace())
    return replace(kept, edges=item.edges, place=MessagePlace()) if item.is_latched else kept


_Needed = tuple[tuple[Message, ...], PairingState[PendingMessage]]
"""Messages that are carried, and the state that names them."""


def only_needed(carried: tuple[Message, ...], state: PairingState[PendingMessage]) -> _Needed:
    """The carried messages that a state still names, and the state that names them by their new places."""
    used = sorted({item.place.number for item in state.items if item.place.carried})
    numbers = {old: new for new, old in enumerate(used)}

    def renumbered(item: PendingMessage) -> PendingMessage:
        return (
            replace(item, place=MessagePlace(numbers[item.place.number], carried=True)) if item.place.carried else item
        )

    return tuple(carried[k] for k in used), state.mapped(renumbered)


def restored(state: InputState, roles: RoleAssignment, tag_table: str) -> PairingState[Stamped]:
    """The messages that wait, decoded as when they arrived.

    Args:
        state: carrying all messages that it names.
        roles: the topic of each role.
        tag_table: configured table, or ``auto``.

    Raises:
        StateError: a message is not what the state says.
    """

    def decoded(item: PendingMessage) -> Stamped:
        content = item.edges if item.camera is None else item.camera
        payload = _message_of(state, item, roles, tag_table).payload if content is None else content
        return Stamped(item.role, item.log_time_ns, item.stamp_ns, payload, item.segment, item.place)

    return state.pairing.mapped(decoded)


def _message_of(state: InputState, item: PendingMessage, roles: RoleAssignment, tag_table: str) -> Stamped:
    if not (item.place.carried and 0 <= item.place.number < len(state.carried)):
        raise StateError(f"it names a message of role {item.role} that it does not hold")
    message = state.carried[item.place.number]
    for found in decoded_messages([message], roles, tag_table, Problems()):
        if found.role == item.role and found.log_time_ns == item.log_time_ns and found.stamp_ns == item.stamp_ns:
            return found
    raise StateError(f"message {item.place.number} on {message.channel.topic} is not the one of role {item.role}")


def _has_content(item: PendingMessage) -> bool:
    return item.camera is not None or item.edges is not None


def _places_in_log(items: Iterable[PendingMessage]) -> Iterator[tuple[int, int]]:
    """Log time and place of the messages that are to be found in the log."""
    places = ((item.log_time_ns, item.place.number) for item in items if not (item.place.carried or _has_content(item)))
    yield from sorted(set(places))
