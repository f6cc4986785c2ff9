"""The messages of a log as payloads of the roles they are assigned to, and what is wrong with single ones."""

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import DecodeError, LogError
from roadperc_stream.input.decoding import Context, Payload, context_of_channel, decode
from roadperc_stream.log.records import Channel, Message
from roadperc_stream.model import Transform
from roadperc_stream.schemas.roles import LATCHED_KINDS, REFERENCE_ROLES, ROLES, Role


@dataclass
class Problems:
    """Messages that could not be read: how many of each topic, and the first of each in words.

    Args:
        strict_in: the log whose first such message is an error; None where it costs that message alone.
    """

    strict_in: Path | None = None
    counts: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def add(self, topic: str, time_ns: int, error: DecodeError) -> None:
        """Count one more, by its log time or by the stamp of its frame.

        Raises:
            LogError: the replay is strict.
        """
        self.require_lenient(f"{topic}: message at {time_ns} ns: {error}")
        self.counts[topic] += 1
        self.first.setdefault(topic, f"{topic}: message at {time_ns} ns: {error}")

    def report(self, topic: str, text: str) -> None:
        """Keep the first such text about messages of a topic that are read, but not used as they are.

        Raises:
            LogError: the replay is strict.
        """
        self.require_lenient(text)
        self.first.setdefault(f"{topic}, in part", text)

    def require_lenient(self, text: str) -> None:
        """Raise an error of a message, if the replay is strict.

        Raises:
            LogError: it is.
        """
        if self.strict_in is not None:
            raise LogError(f"{self.strict_in}: {text}; --strict stops there")


@dataclass(frozen=True, eq=False)
class Stamped:
    """One decoded message of a role.

    ``segment`` counts how often the stamps before it began again. ``number`` is its place among the messages of
    assigned roles with equal log time. ``carried`` is the message itself if an earlier log handed it on.
    """

    role: str
    log_time_ns: int
    stamp_ns: int
    payload: Payload
    segment: int = 0
    number: int = 0
    carried: Message | None = None

    @property
    def is_latched(self) -> bool:
        """Whether it holds until it is replaced."""
        return ROLES[self.role].kind in LATCHED_KINDS

    @property
    def edges(self) -> tuple[Transform, ...]:
        """The transforms of a transforms message; none of any other."""
        parts = self.payload if isinstance(self.payload, tuple) else ()
        return tuple(part for part in parts if isinstance(part, Transform))


@dataclass(frozen=True)
class RoleAssignment:
    """The roles that a log has channels for, each with its topic."""

    topics: Mapping[str, str]
    notes: tuple[str, ...] = ()
    """What was guessed and what is left unassigned, to be reported to the user."""
    unassigned: tuple[str, ...] = ()
    """Of these the roles that some topic of the log could serve, with the topics."""
    guessed: frozenset[str] = frozenset()
    """Roles whose topic is only the one that fits."""
    chosen: Mapping[str, str] = field(default_factory=dict)
    """Topics that were chosen because the user named them, in this replay or in the one that made the log."""
    tag_table: str = ""
    """Table of tags whose channel names none, as the user of the replay named it that made the log; empty: nobody."""

    @property
    def reference(self) -> str | None:
        """The role whose messages make the frames; None where no topic has any."""
        return next((role for role in REFERENCE_ROLES if role in self.topics), None)

    def roles_of(self, topic: str) -> list[Role]:
        """Roles that a topic is assigned to."""
        return [ROLES[name] for name, known in self.topics.items() if known == topic]


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
    for message, number in numbered(messages, roles_by_topic):
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
            yield Stamped(role.name, message.log_time_ns, decoded.stamp_ns, decoded.payload, number=number)


def numbered(messages: Iterable[Message], topics: Container[str]) -> Iterator[tuple[Message, int]]:
    """The messages on some topics, each with its place among those of equal log time.

    Args:
        messages: in log-time order.
        topics: those that are assigned to roles.
    """
    log_time_ns, number = None, 0
    for message in messages:
        if message.channel.topic in topics:
            number = number + 1 if message.log_time_ns == log_time_ns else 0
            log_time_ns = message.log_time_ns
            yield message, number
