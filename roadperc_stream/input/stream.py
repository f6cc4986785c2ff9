"""The messages of a log as payloads of the roles they are assigned to, in the order of the log."""

from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from roadperc_stream.core.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.core.datatypes import Transform
from roadperc_stream.errors import DecodeError
from roadperc_stream.input.decoding import Context, Payload, context_of_channel, decode
from roadperc_stream.input.problems import Problems
from roadperc_stream.input.roles import RoleAssignment
from roadperc_stream.log import Channel, Message
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES


@dataclass(frozen=True)
class MessagePlace:
    """Where a message stands.

    ``number`` is its place among the messages of assigned roles with equal log time; of one that an earlier part of the
    drive handed on (``carried``) its place among those.
    """

    number: int = 0
    carried: bool = False


_FIRST: Final = MessagePlace()


@dataclass(frozen=True, eq=False)
class Stamped:
    """One decoded message of a role; ``segment`` counts how often the stamps before it began anew."""

    role: str
    log_time_ns: int
    stamp_ns: int
    payload: Payload
    segment: int = 0
    place: MessagePlace = _FIRST

    @property
    def is_latched(self) -> bool:
        """Whether it holds until it is replaced."""
        return ROLES[self.role].kind in LATCHED_KINDS

    @property
    def edges(self) -> tuple[Transform, ...]:
        """The transforms of a transforms message; none of any other."""
        parts = self.payload if isinstance(self.payload, tuple) else ()
        return tuple(part for part in parts if isinstance(part, Transform))

    def children(self) -> tuple[str, ...]:
        """Frames that a transforms message places; for other messages one empty name."""
        return tuple(edge.child for edge in self.edges) or ("",)


def decoded_messages(
    messages: Iterable[Message],
    roles: RoleAssignment,
    tag_table: str,
    problems: Problems,
    limits: LimitsConfig = DEFAULT_LIMITS,
) -> Iterator[Stamped]:
    """Decode the messages of assigned roles; one that cannot be decoded is counted and left out.

    Args:
        messages: in log-time order.
        roles: the topic of each role.
        tag_table: configured table, or ``auto``: the channel's, else the one that an earlier replay recorded.
        problems: takes the messages that cannot be decoded.
        limits: of what a message asks for.
    """
    contexts: dict[Channel, Context] = {}
    roles_by_topic = {topic: roles.roles_of(topic) for topic in set(roles.topics.values())}
    for message, place in in_their_places(messages, roles_by_topic):
        channel = message.channel
        if channel not in contexts:
            contexts[channel] = context_of_channel(channel, tag_table, roles.tag_table, limits)
        for role in roles_by_topic[channel.topic]:
            try:
                decoded = decode(
                    role.kind,
                    channel.schema_name,
                    channel.message_encoding,
                    message.data,
                    message.log_time_ns,
                    contexts[channel],
                )
            except DecodeError as error:
                problems.add(channel.topic, message.log_time_ns, error)
                continue
            yield Stamped(role.name, message.log_time_ns, decoded.stamp_ns, decoded.payload, place=place)


def in_their_places(messages: Iterable[Message], topics: Container[str]) -> Iterator[tuple[Message, MessagePlace]]:
    """The messages on some topics, each with its place among those of equal log time.

    Args:
        messages: in log-time order.
        topics: those that are assigned to roles.
    """
    log_time_ns, place = None, _FIRST
    for message in messages:
        if message.channel.topic in topics:
            place = MessagePlace(place.number + 1) if message.log_time_ns == log_time_ns else _FIRST
            log_time_ns = message.log_time_ns
            yield message, place
