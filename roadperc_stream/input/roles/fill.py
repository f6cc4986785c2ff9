"""Which channel of a log fills which role, and the messages of the filled roles, decoded."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

from roadperc_stream.core.semantics import TABLES
from roadperc_stream.errors import ChannelError, DecodeError
from roadperc_stream.input.decoding import Context, context_of_channel, decode, schemas_of_kind
from roadperc_stream.input.roles.guess import choice, could_fill, free, guess
from roadperc_stream.input.roles.probe import holds
from roadperc_stream.input.roles.topic_names import distinct, fits, known_elsewhere, without_a_word
from roadperc_stream.input.sync import Stamped
from roadperc_stream.log import Channel, LogSummary, Message, Metadata
from roadperc_stream.schemas.record import METADATA_RECORD, PRODUCER, TAG_TABLE_KEY, TOPIC_KEY
from roadperc_stream.schemas.roles import REFERENCE_ROLES, ROLES, Kind, Role
from roadperc_stream.schemas.topics import ON_REQUEST, result_schemas

_UNNAMED_ROLES = ("depth", "segmentation")
"""Roles whose images any name may have: what is in them tells, where no name does."""
_MOST_TOLD = 3
"""Candidates of a role, in notes."""
_SHARED_KINDS = ("tf",)
"""Kinds whose topic may carry several channels."""
_SCHEMAS: Final = result_schemas(tuple(ON_REQUEST.values()))
"""Of every result, by topic."""
Looks = Callable[[Kind, Channel], bool]
"""Whether what is in a channel is of a kind."""


def _unseen(_kind: Kind, _channel: Channel) -> bool:
    """Nobody looks what is in the channels."""
    return False


@dataclass(frozen=True)
class Filled:
    """The roles a log fills, each with its topic."""

    topics: Mapping[str, str]
    notes: tuple[str, ...] = ()
    """What was guessed and what is left unfilled, to be told to the user."""
    unfilled: tuple[str, ...] = ()
    """Of these the roles that some topic of the log could fill, with the topics."""
    chosen: Mapping[str, str] = field(default_factory=dict)
    """Topics that are taken because the user named them, in this replay or in the one that made the log."""
    tag_table: str = ""
    """Table of tags whose channel names none, as the user of the replay named it that made the log; empty: nobody."""

    def roles_of(self, topic: str) -> list[Role]:
        """Roles a topic fills."""
        return [ROLES[name] for name, known in self.topics.items() if known == topic]


@dataclass
class Problems:
    """Messages that could not be read: how many of each topic, and the first of each in words."""

    counts: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def add(self, topic: str, time_ns: int, error: DecodeError) -> None:
        """Count one more, by its log time or by the stamp of its frame."""
        self.counts[topic] += 1
        self.first.setdefault(topic, f"{topic}: message at {time_ns} ns: {error}")

    def tell(self, topic: str, text: str) -> None:
        """Keep the first of these words of a topic's messages that are read, but not as they stand."""
        self.first.setdefault(f"{topic}, in part", text)


def is_result(channel: Channel) -> bool:
    """Whether an earlier replay wrote this channel."""
    return PRODUCER in channel.metadata


def is_result_of(channel: Channel, topic: str) -> bool:
    """Whether a replay wrote this channel: others call topics so as well, and fill them with messages of their own."""
    return channel.topic == topic and is_result(channel) and channel.schema_name == _SCHEMAS.get(topic)


def roles_of_log(summary: LogSummary, overrides: Mapping[str, str]) -> Filled:
    """The roles of a log's channels that have messages; a result keeps to the topics it was made with.

    Raises:
        ChannelError: as ``fill_roles``; the message names the log.
    """
    present = [channel for channel in summary.channels if summary.counts.get(channel.source_id)]
    named = {**chosen_topics(summary.metadata, present), **overrides}
    try:
        filled = fill_roles(present, named, partial(holds, summary.path))
    except ChannelError as error:
        raise ChannelError(f"{summary.path}: {error}") from error
    chosen = _choices(present, named) if named else {}
    return replace(filled, chosen=chosen, tag_table=chosen_tag_table(summary.metadata))


def _choices(channels: Sequence[Channel], named: Mapping[str, str]) -> dict[str, str]:
    """The named topics without which other ones, or none, would have been taken."""
    try:
        unasked: Mapping[str, str] = fill_roles(channels, {}).topics
    except ChannelError:
        unasked = {}
    return {role: topic for role, topic in named.items() if unasked.get(role) != topic}


def chosen_topics(metadata: Iterable[Metadata], channels: Iterable[Channel]) -> dict[str, str]:
    """Topics by role that the user of an earlier replay named, as its result records them; those that are there."""
    record = _record(metadata)
    named = {key.removeprefix(TOPIC_KEY): topic for key, topic in record.items() if key.startswith(TOPIC_KEY)}
    there = {channel.topic for channel in channels if not is_result(channel)}
    return {role: topic for role, topic in named.items() if role in ROLES and topic in there}


def chosen_tag_table(metadata: Iterable[Metadata]) -> str:
    """The tag table that the user of an earlier replay named, as its result records it; empty where none is known."""
    name = _record(metadata).get(TAG_TABLE_KEY, "")
    return name if name in TABLES else ""


def tag_table_needed(channels: Iterable[Channel], filled: Filled, configured: str) -> str:
    """The table to be recorded: what the user named, now or earlier, where a channel of tags names none; else empty.

    Args:
        channels: of the log.
        filled: roles and topics.
        configured: table of this replay, or ``auto``.
    """
    tags = (c for c in channels if any(role.kind == "tags" for role in filled.roles_of(c.topic)) and not is_result(c))
    if all(channel.label(TAG_TABLE_KEY) for channel in tags):
        return ""
    return filled.tag_table if configured == "auto" else configured


def _record(metadata: Iterable[Metadata]) -> dict[str, str]:
    """What a result says of how it came about; empty of other logs."""
    return next((dict(record.values) for record in metadata if record.name == METADATA_RECORD), {})


def fill_roles(channels: Iterable[Channel], overrides: Mapping[str, str], looks: Looks = _unseen) -> Filled:
    """Match channels to roles: by the user's word, by topics that are known, else by the only topic that fits.

    Where several fit, those in the namespace of the role's camera come first; a role that is not needed stays unfilled
    where they still are several.

    Args:
        channels: of the log; results of earlier replays do not count.
        overrides: topic by role, from ``--topic``.
        looks: tells candidates whose names do not.

    Raises:
        ChannelError: a topic asked for is not there or has the wrong schema, or several fit a role that is needed.
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
    for role in ROLES.values():
        if role.name not in topics and (known := choice(role, known_elsewhere(role, free(inputs, topics)), topics)):
            topics[role.name] = known
    notes = []
    for role in ROLES.values():
        if role.name not in topics and (guessed := guess(role, inputs, topics)):
            topics[role.name] = guessed
            notes.append(f"role {role.name}: {guessed}, the only topic that fits")
    unfilled = _unfilled_in_words(candidates(inputs, topics, looks), inputs)
    return Filled({name: topics[name] for name in ROLES if name in topics}, (*notes, *unfilled), unfilled)


def candidates(
    channels: Iterable[Channel], filled: Mapping[str, str], looks: Looks = _unseen
) -> Mapping[str, tuple[str, ...]]:
    """Topics that could fill the roles a log leaves unfilled, by role; roles without any, and truths, are left out.

    Args:
        channels: of the log; results of earlier replays do not count.
        filled: topic of each role that is filled; these topics are nobody's candidates.
        looks: tells depth and tags whose names do not, where no better name is there.
    """
    unused = free((channel for channel in channels if not is_result(channel)), filled)
    unfilled = [role for role in ROLES.values() if role.name not in filled and not role.truth]
    found = {role.name: could_fill(role, unused, filled) for role in unfilled}
    if not (filled.keys() | {name for name, topics in found.items() if topics}) & set(REFERENCE_ROLES):
        found["image"] = distinct(c for c in unused if fits(ROLES["image"], c))
    for name in _UNNAMED_ROLES:
        if name in found and not found[name]:
            found[name] = distinct(c for c in without_a_word(ROLES[name], unused) if looks(ROLES[name].kind, c))
    return {name: topics for name, topics in found.items() if topics}


def _unfilled_in_words(found: Mapping[str, tuple[str, ...]], channels: Iterable[Channel]) -> tuple[str, ...]:
    """A line for each role that some topic could fill; a few of the topics where there are many."""
    schemas = {channel.topic: channel.schema_name for channel in channels}
    lines = []
    for name, topics in found.items():
        some = ", ".join(f"{topic} ({schemas[topic]})" for topic in topics[:_MOST_TOLD])
        more = ", ..." if len(topics) > _MOST_TOLD else ""
        lines.append(f"role {name}: not filled; candidates: {some}{more}: --topic {name}={topics[0]}")
    return tuple(lines)


def _require_one_fitting(role: Role, channels: list[Channel]) -> None:
    for channel in channels:
        if not fits(role, channel):
            expected = " or ".join(f"{schema} ({encoding})" for schema, encoding in schemas_of_kind(role.kind))
            found = f"{channel.schema_name or 'no schema'} ({channel.message_encoding})"
            raise ChannelError(f"{channel.topic}: role {role.name} expects {expected}, found {found}")
    if len(channels) > 1 and role.kind not in _SHARED_KINDS:
        raise ChannelError(f"{role.topic}: {len(channels)} channels carry this topic, role {role.name} takes one")


def stamped_messages(
    messages: Iterable[Message], filled: Filled, tag_table: str, problems: Problems
) -> Iterator[Stamped]:
    """Decode the messages of filled roles; one that cannot be decoded is counted and left out.

    Args:
        messages: in log-time order.
        filled: roles and topics.
        tag_table: configured table, or ``auto``: the channel's, else the one an earlier replay was told.
        problems: filled in.
    """
    contexts: dict[Channel, Context] = {}
    roles = {topic: filled.roles_of(topic) for topic in set(filled.topics.values())}
    for message in messages:
        channel = message.channel
        if channel not in contexts:
            contexts[channel] = context_of_channel(channel, tag_table, filled.tag_table)
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
                problems.add(channel.topic, message.log_time_ns, error)
                continue
            yield Stamped(role.name, message.log_time_ns, decoded.stamp_ns, decoded.payload)
