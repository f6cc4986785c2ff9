"""Which channel of a log fills which role, and the messages of the filled roles, decoded."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Final

from roadperc_stream.channels import (
    METADATA_RECORD,
    ON_REQUEST,
    PRODUCER,
    REFERENCE_ROLES,
    ROLES,
    TOPIC_KEY,
    Role,
    result_schemas,
)
from roadperc_stream.decoding import Context, context_of_channel, decode, schemas_of_kind
from roadperc_stream.errors import ChannelError, DecodeError
from roadperc_stream.log import Channel, LogSummary, Message, Metadata
from roadperc_stream.sync import Stamped

_GUESSED_ROLES = ("image", "calibration", "depth", "segmentation", "detections", "tf")
"""Roles that a topic of another name may fill, where only one fits."""
_NEEDED_ROLES = ("image", "calibration")
"""Roles without which no frame can be made: where several topics fit, somebody must choose."""
_CAMERA_OF = {"depth_calibration": "depth", "left_calibration": "left", "right_calibration": "right"}
"""Whose images the other calibrations speak of."""
_WORDS = {
    "depth": ("depth",),
    "segmentation": ("seg", "semantic", "label"),
    "left": ("left",),
    "right": ("right",),
    "truth": ("truth",),
    "tf_static": ("static",),
}
_MOST_TOLD = 3
"""Candidates of a role, in notes."""
_SHARED_KINDS = ("tf",)
"""Kinds whose topic may carry several channels."""
_SCHEMAS: Final = result_schemas(tuple(ON_REQUEST.values()))
"""Of every result, by topic."""


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
        filled = fill_roles(present, named)
    except ChannelError as error:
        raise ChannelError(f"{summary.path}: {error}") from error
    return replace(filled, chosen=_choices(present, named)) if named else filled


def _choices(channels: Sequence[Channel], named: Mapping[str, str]) -> dict[str, str]:
    """The named topics without which other ones, or none, would have been taken."""
    try:
        unasked: Mapping[str, str] = fill_roles(channels, {}).topics
    except ChannelError:
        unasked = {}
    return {role: topic for role, topic in named.items() if unasked.get(role) != topic}


def chosen_topics(metadata: Iterable[Metadata], channels: Iterable[Channel]) -> dict[str, str]:
    """Topics by role that the user of an earlier replay named, as its result records them; those that are there."""
    record = next((dict(record.values) for record in metadata if record.name == METADATA_RECORD), {})
    named = {key.removeprefix(TOPIC_KEY): topic for key, topic in record.items() if key.startswith(TOPIC_KEY)}
    there = {channel.topic for channel in channels if not is_result(channel)}
    return {role: topic for role, topic in named.items() if role in ROLES and topic in there}


def fill_roles(channels: Iterable[Channel], overrides: Mapping[str, str]) -> Filled:
    """Match channels to roles: by the user's word, by topics that are known, else by the only topic that fits.

    Where several fit, those in the namespace of the role's camera come first; a role that is not needed stays unfilled
    where they still are several.

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
        if role.name not in topics and (known := _choice(role, _elsewhere(role, inputs, topics), topics)):
            topics[role.name] = known
    notes = []
    for role in ROLES.values():
        if role.name not in topics and (guess := _guess(role, inputs, topics)):
            topics[role.name] = guess
            notes.append(f"role {role.name}: {guess}, the only topic that fits")
    unfilled = _unfilled_in_words(candidates(inputs, topics), inputs)
    return Filled({name: topics[name] for name in ROLES if name in topics}, (*notes, *unfilled), unfilled)


def candidates(channels: Iterable[Channel], filled: Mapping[str, str]) -> Mapping[str, tuple[str, ...]]:
    """Topics that could fill the roles a log leaves unfilled, by role; roles without any, and truths, are left out.

    Args:
        channels: of the log; results of earlier replays do not count.
        filled: topic of each role that is filled; these topics are nobody's candidates.
    """
    unused = [c for c in channels if not is_result(c) and c.topic not in filled.values()]
    found = {role.name: _fitting(role, unused) for role in ROLES.values() if role.name not in filled and not role.truth}
    if not (filled.keys() | {name for name, topics in found.items() if topics}) & set(REFERENCE_ROLES):
        found["image"] = _distinct(c for c in unused if _fits(ROLES["image"], c))
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


def _elsewhere(role: Role, inputs: Iterable[Channel], topics: Mapping[str, str]) -> tuple[str, ...]:
    """Topics of other recorders that are known to be this role's."""
    patterns = [re.compile(re.escape(known).replace(r"\*", "[^/]+")) for known in role.elsewhere]
    matching = (c for c in inputs if any(pattern.fullmatch(c.topic) for pattern in patterns) and _fits(role, c))
    return _distinct(c for c in matching if c.topic not in topics.values())


def _fitting(role: Role, channels: Iterable[Channel]) -> tuple[str, ...]:
    """Topics of the right schema whose names do not speak of another role."""
    return _distinct(c for c in channels if _fits(role, c) and _sounds_like(role, c))


def _distinct(channels: Iterable[Channel]) -> tuple[str, ...]:
    """Topics in alphabetical order."""
    return tuple(sorted({channel.topic for channel in channels}))


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


def _guess(role: Role, inputs: Iterable[Channel], topics: Mapping[str, str]) -> str | None:
    """The topic of another name that fills a role; None where there is none, or nothing tells which.

    A pair's or a depth's calibration is looked for where its images are; points and a pair's images are not guessed,
    for those of a radar, or of another camera, are of the same schema.

    Raises:
        ChannelError: there are several, and the role is needed.
    """
    if role.name not in _GUESSED_ROLES and _CAMERA_OF.get(role.name) not in topics:
        return None
    return _choice(role, _fitting(role, (c for c in inputs if c.topic not in topics.values())), topics)


def _choice(role: Role, fitting: tuple[str, ...], topics: Mapping[str, str]) -> str | None:
    """The one of a role's topics, in its camera's namespace where there are several; None where that does not tell.

    Raises:
        ChannelError: there are several, and the role is needed.
    """
    camera_topic = topics.get(_CAMERA_OF.get(role.name, "image"), "")
    near = _nearest(fitting, camera_topic) if len(fitting) > 1 else fitting
    if len(near) > 1 and role.name in _NEEDED_ROLES:
        raise ChannelError(
            f"{len(near)} topics fit role {role.name}: {', '.join(near)}; choose one with --topic {role.name}={near[0]}"
        )
    return near[0] if len(near) == 1 else None


def _nearest(topics: tuple[str, ...], topic: str) -> tuple[str, ...]:
    """Those that share most of another topic's namespace; all where none shares any."""
    shared = {other: _shared_parts(_namespace(other), _namespace(topic)) for other in topics}
    return tuple(other for other in topics if shared[other] == max(shared.values()))


def _shared_parts(one: list[str], other: list[str]) -> int:
    return len(list(takewhile(lambda pair: pair[0] == pair[1], zip(one, other, strict=False))))


def _namespace(topic: str) -> list[str]:
    return topic.strip("/").split("/")[:-1]


def _sounds_like(role: Role, channel: Channel) -> bool:
    """Whether a topic's name speaks of this role and not of another one of the same schema."""
    topic = channel.topic.lower()
    spoken = {word for word, parts in _WORDS.items() if any(part in topic for part in parts)}
    word = role.name.removesuffix("_calibration")
    return spoken == ({word} if word in _WORDS else set())


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
            contexts[channel] = context_of_channel(channel, tag_table)
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
