"""The input state between a log and its continuation: messages of incomplete frames, and frame numbers."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from roadperc_stream.config import LimitsConfig
from roadperc_stream.errors import DecodeError, StateError
from roadperc_stream.formats.images import require_pixels
from roadperc_stream.geometry import Camera
from roadperc_stream.input.decoding import Payload
from roadperc_stream.input.stream import Problems, RoleAssignment, Stamped, decoded_messages, numbered
from roadperc_stream.input.sync import PairingState, without_loops
from roadperc_stream.input.transforms import TransformTree
from roadperc_stream.log import Message
from roadperc_stream.model import Transform
from roadperc_stream.schemas.roles import ROLES


@dataclass(frozen=True)
class FrameNumbers:
    """The number of the next written frame, and the log time of the last one.

    Frames whose message arrived before ``written_from_ns`` only warm up the chain and are not written.
    """

    next: int = 0
    log_time_ns: int = 0
    written_from_ns: int | None = None

    def is_written(self, reference: Stamped) -> bool:
        """Whether the frame of a reference message is written."""
        return self.written_from_ns is None or reference.log_time_ns >= self.written_from_ns

    def after(self, reference: Stamped) -> "FrameNumbers":
        """The numbers after the frame of a reference message."""
        if not self.is_written(reference):
            return self
        return FrameNumbers(self.next + 1, max(self.log_time_ns, reference.log_time_ns))


@dataclass(frozen=True)
class PendingMessage:
    """A pending message. Calibrations and transforms have their content, others are in ``message`` or in the log."""

    role: str
    log_time_ns: int
    stamp_ns: int
    segment: int
    number: int = 0
    message: Message | None = None
    camera: Camera | None = None
    edges: tuple[Transform, ...] | None = None

    @property
    def is_in_log(self) -> bool:
        """Whether only the log has the content, at this log time and number."""
        return self.message is None and self.camera is None and self.edges is None


@dataclass(frozen=True)
class InputState:
    """The state of the arrived messages that later frames need.

    It assumes the full wait for every message, so it depends neither on the cut nor on the lateness of the messages.
    """

    from_ns: int
    """Log time of the first messages that have not been read."""
    reference: str
    topics: Mapping[str, str]
    """Topic of each role of the log."""
    tag_table: str
    parent_of: Mapping[str, str]
    """The last parent of every frame that a transform has placed."""
    arrived: TransformTree
    """Tree of all transforms that have arrived; a later one that closes a loop is left out."""
    pairing: PairingState[PendingMessage]
    numbers: FrameNumbers = field(default_factory=FrameNumbers)

    @property
    def frames_waiting(self) -> int:
        """Number of reference messages whose frames are incomplete."""
        return sum(item.role == self.reference for item in self.pairing.items)

    @property
    def next_ns(self) -> int:
        """The first log time without a processed message: after the last message, or at a cut."""
        return self.from_ns + any(item.message and item.log_time_ns == self.from_ns for item in self.pairing.items)

    def to_come(
        self, messages: Iterable[Stamped], topics: Mapping[str, str], problems: Problems, limits: LimitsConfig
    ) -> Iterator[Stamped]:
        """The messages that have not been read, without transforms that close a loop."""
        new = (item for item in messages if item.log_time_ns >= self.from_ns)
        return without_loops(new, self.arrived, topics, problems, limits)

    def require_usable(self, limits: LimitsConfig) -> None:
        """Check the roles, cameras and transforms of a decoded state, like those of a log's messages.

        Raises:
            StateError: a role is unknown, a camera or tree exceeds the limits, or the transforms are not a tree.
        """
        latched = (self.pairing.latched, *(held for _, held in self.pairing.waiting))
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
        """The same state including the messages that it refers to by log time and number.

        Args:
            messages: of their log, at least from ``first_pending_ns`` on.

        Raises:
            StateError: a message is missing.
        """
        needed = {(item.log_time_ns, item.number) for item in self.pairing.items if item.is_in_log}
        found = {
            key: replace(message, channel=replace(message.channel, source_id=0))
            for message, number in numbered(messages, set(self.topics.values()))
            if (key := (message.log_time_ns, number)) in needed
        }
        if len(found) < len(needed):
            raise StateError(f"{len(needed) - len(found)} of {len(needed)} messages it needs are not in its log")

        def with_message(item: PendingMessage) -> PendingMessage:
            return replace(item, message=found[item.log_time_ns, item.number]) if item.is_in_log else item

        return replace(self, pairing=self.pairing.mapped(with_message))

    @property
    def first_pending_ns(self) -> int | None:
        """Log time of the first message that only the log has; None without one."""
        return min((item.log_time_ns for item in self.pairing.items if item.is_in_log), default=None)


def pending(item: Stamped) -> PendingMessage:
    """The pending form of a message."""
    kept = PendingMessage(item.role, item.log_time_ns, item.stamp_ns, item.segment)
    if isinstance(item.payload, Camera):
        return replace(kept, camera=item.payload)
    return (
        replace(kept, edges=item.edges) if item.is_latched else replace(kept, number=item.number, message=item.carried)
    )


def restored(state: InputState, roles: RoleAssignment, tag_table: str) -> PairingState[Stamped]:
    """The pending messages of a state, decoded again.

    ``state`` includes all messages that it needs; ``tag_table`` is the configured table, or ``auto``.

    Raises:
        StateError: a message contradicts the state.
    """

    def decoded(item: PendingMessage) -> Stamped:
        content: Payload | None = item.edges if item.camera is None else item.camera
        payload = _decoded(item, roles, tag_table).payload if content is None else content
        times = item.log_time_ns, item.stamp_ns
        return Stamped(item.role, *times, payload, item.segment, item.number, item.message)

    return state.pairing.mapped(decoded)


def _decoded(item: PendingMessage, roles: RoleAssignment, tag_table: str) -> Stamped:
    if item.message is None:
        raise StateError(f"it names a message of role {item.role} that it does not hold")
    for found in decoded_messages([item.message], roles, tag_table, Problems()):
        if found.role == item.role and found.log_time_ns == item.log_time_ns and found.stamp_ns == item.stamp_ns:
            return found
    raise StateError(f"a message on {item.message.channel.topic} is not the one of role {item.role}")
