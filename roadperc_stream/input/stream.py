"""Decodes the messages of a log for their roles, and counts those that cannot be read."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import DecodeError, LogError
from roadperc_stream.input.decoding import Context, Stamped, context_of_channel, decode
from roadperc_stream.log.records import Channel, Message
from roadperc_stream.schemas.roles import REFERENCE_ROLES, ROLES, Role


@dataclass
class Problems:
    """Unreadable messages: the number of each topic, and a text about the first one.

    Args:
        strict_in: the log whose first unreadable message is an error; None to skip unreadable messages.
    """

    strict_in: Path | None = None
    counts: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def add(self, topic: str, time_ns: int, error: DecodeError) -> None:
        """Count one more message; ``time_ns`` is its log time or the stamp of its frame.

        Raises:
            LogError: the replay is strict.
        """
        self.require_lenient(f"{topic}: message at {time_ns} ns: {error}")
        self.counts[topic] += 1
        self.first.setdefault(topic, f"{topic}: message at {time_ns} ns: {error}")

    def report(self, topic: str, text: str) -> None:
        """Keep the first text about messages of a topic that are readable, but not fully used.

        Raises:
            LogError: the replay is strict.
        """
        self.require_lenient(text)
        self.first.setdefault(f"{topic}, in part", text)

    def require_lenient(self, text: str) -> None:
        """Raise an error if the replay is strict.

        Raises:
            LogError: the replay is strict.
        """
        if self.strict_in is not None:
            raise LogError(f"{self.strict_in}: {text}; --strict stops there")


@dataclass(frozen=True)
class RoleAssignment:
    """The roles that a log has channels for, each with its topic."""

    topics: Mapping[str, str]
    notes: tuple[str, ...] = ()
    """Notes for the user on guessed and unassigned roles."""
    unassigned: tuple[str, ...] = ()
    """The notes on unassigned roles that have candidate topics."""
    guessed: frozenset[str] = frozenset()
    """Roles whose topic was chosen because it is the only one that fits."""
    chosen: Mapping[str, str] = field(default_factory=dict)
    """Topics that the user named, in this replay or in the one that wrote the log."""
    tag_table: str = ""
    """Recorded table for channels that name none, from the replay that wrote the log; empty without one."""

    @property
    def reference(self) -> str | None:
        """The role whose messages make the frames; None without a topic for one."""
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
    """Decode the messages of assigned roles; unreadable ones are counted and left out.

    ``messages`` are in log-time order. ``tag_table`` is the configured table, or ``auto`` for the channel's table, else
    the recorded one.
    """
    contexts: dict[Channel, Context] = {}
    roles_by_topic = {topic: roles.roles_of(topic) for topic in set(roles.topics.values())}
    for message in messages:
        channel = message.channel
        if channel.topic not in roles_by_topic:
            continue
        if channel not in contexts:
            contexts[channel] = context_of_channel(channel, tag_table, roles.tag_table, limits)
        for role in roles_by_topic[channel.topic]:
            try:
                content = message.data, message.log_time_ns, contexts[channel]
                decoded = decode(role.kind, channel.schema_name, channel.message_encoding, *content)
            except DecodeError as error:
                problems.add(channel.topic, message.log_time_ns, error)
                continue
            yield replace(decoded, role=role.name, log_time_ns=message.log_time_ns)
