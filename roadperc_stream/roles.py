"""Which channel of a log fills which role, and the messages of the filled roles, decoded."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from roadperc_stream.channels import PRODUCER, ROLES, Role
from roadperc_stream.decoding import Context, context_of, decode, schemas_of_kind
from roadperc_stream.errors import ChannelError, DecodeError
from roadperc_stream.log import Channel, Message
from roadperc_stream.sync import Stamped

_GUESSED_ROLES = ("image", "calibration", "depth", "segmentation", "detections", "tf")
"""Roles that a topic of another name may fill, where only one fits."""
_WORDS = {
    "depth": ("depth",),
    "segmentation": ("seg", "semantic", "label"),
    "left": ("left",),
    "right": ("right",),
    "truth": ("truth",),
}
_MOST_TOLD = 3
"""Topics that could be used but are not, in notes."""
_SHARED_KINDS = ("tf",)
"""Kinds whose topic may carry several channels."""


@dataclass(frozen=True)
class Filled:
    """The roles a log fills, each with its topic."""

    topics: Mapping[str, str]
    notes: tuple[str, ...] = ()
    """What was guessed, to be told to the user."""

    def roles_of(self, topic: str) -> list[Role]:
        """Roles a topic fills."""
        return [ROLES[name] for name, known in self.topics.items() if known == topic]


@dataclass
class Problems:
    """Messages that could not be read: how many of each topic, and the first of each in words."""

    counts: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def add(self, topic: str, text: str) -> None:
        """Count one more."""
        self.counts[topic] += 1
        self.first.setdefault(topic, text)

    def tell(self, topic: str, text: str) -> None:
        """Keep the first of these words of a topic's messages that are read, but not as they stand."""
        self.first.setdefault(f"{topic}, in part", text)


def is_result(channel: Channel) -> bool:
    """Whether an earlier replay wrote this channel."""
    return PRODUCER in channel.metadata


def fill_roles(channels: Iterable[Channel], overrides: Mapping[str, str]) -> Filled:
    """Match channels to roles: by the user's word, by the contract's topic, else by the only topic that fits.

    Raises:
        ChannelError: a topic asked for is not there or has the wrong schema, or several topics fit one role.
    """
    inputs = [channel for channel in channels if not is_result(channel)]
    topics: dict[str, str] = {}
    for role in ROLES.values():
        topic = overrides.get(role.name, role.topic)
        named = [channel for channel in inputs if channel.topic == topic]
        if role.name in overrides and not named:
            there = ", ".join(sorted({channel.topic for channel in inputs})) or "none"
            raise ChannelError(f"--topic {role.name}={topic}: no such topic; topics in the log: {there}")
        if named:
            _require_one_fitting(role, named)
            topics[role.name] = topic
    notes = []
    for name in _GUESSED_ROLES:
        if name not in topics and (guess := _guess(ROLES[name], inputs, set(topics.values()))):
            topics[name] = guess
            notes.append(f"role {name}: {guess}, the only topic that fits")
    notes += _unused_points(inputs, topics)
    return Filled({name: topics[name] for name in ROLES if name in topics}, tuple(notes))


def _unused_points(inputs: list[Channel], topics: Mapping[str, str]) -> list[str]:
    """What to tell of clouds of points that nobody asked for; a few of them where there are many.

    None is guessed: points of a radar, or of another sensor's own making, are of the same schema as a lidar's.
    """
    role = ROLES["lidar"]
    if role.name in topics:
        return []
    unused = sorted({c.topic for c in inputs if _fits(role, c)} - set(topics.values()))
    return [f"{topic} holds {role.schema}; --topic {role.name}={topic} would use it" for topic in unused[:_MOST_TOLD]]


def _fits(role: Role, channel: Channel) -> bool:
    return (channel.schema_name, channel.message_encoding) in schemas_of_kind(role.kind)


def _require_one_fitting(role: Role, channels: list[Channel]) -> None:
    for channel in channels:
        if not _fits(role, channel):
            expected = " or ".join(f"{schema} ({encoding})" for schema, encoding in schemas_of_kind(role.kind))
            found = f"{channel.schema_name or 'no schema'} ({channel.message_encoding})"
            raise ChannelError(f"{channel.topic}: role {role.name} expects {expected}, found {found}")
    if len(channels) > 1 and role.kind not in _SHARED_KINDS:
        raise ChannelError(f"{role.topic}: {len(channels)} channels carry this topic, role {role.name} takes one")


def _guess(role: Role, inputs: list[Channel], taken: set[str]) -> str | None:
    """The only topic that could fill a role; None where there is none.

    Raises:
        ChannelError: there are several.
    """
    candidates = sorted({c.topic for c in inputs if c.topic not in taken and _fits(role, c) and _sounds_like(role, c)})
    if len(candidates) > 1:
        raise ChannelError(
            f"{len(candidates)} topics fit role {role.name}: {', '.join(candidates)}; "
            f"choose one with --topic {role.name}={candidates[0]}"
        )
    return candidates[0] if candidates else None


def _sounds_like(role: Role, channel: Channel) -> bool:
    """Whether a topic's name speaks of this role and not of another one of the same schema."""
    topic = channel.topic.lower()
    spoken = {word for word, parts in _WORDS.items() if any(part in topic for part in parts)}
    return spoken == ({role.name} if role.name in _WORDS else set())


def stamped_messages(
    messages: Iterable[Message], filled: Filled, tag_table: str, problems: Problems
) -> Iterator[Stamped]:
    """Decode the messages of filled roles; one that cannot be decoded is counted and left out.

    Args:
        messages: in log-time order.
        filled: roles and topics.
        tag_table: configured table, or ``auto``.
        problems: filled in.
    """
    contexts: dict[Channel, Context] = {}
    roles = {topic: filled.roles_of(topic) for topic in set(filled.topics.values())}
    for message in messages:
        channel = message.channel
        if channel not in contexts:
            contexts[channel] = context_of(dict(channel.metadata), tag_table)
        for role in roles.get(channel.topic, ()):
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
                problems.add(channel.topic, f"{channel.topic}: message at {message.log_time_ns} ns: {error}")
                continue
            yield Stamped(role.name, message.log_time_ns, decoded.stamp_ns, decoded.payload)
