"""Assigns the channels of a log to roles: a named or known topic, else the only one that fits."""

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final, Literal

from roadperc_stream.errors import ChannelError
from roadperc_stream.input.decoding import schemas_of_kind
from roadperc_stream.input.decoding.pictures import CONVERT_VIDEO
from roadperc_stream.input.earlier_replay import is_result, recorded_tag_table, recorded_topics
from roadperc_stream.input.stream import RoleAssignment
from roadperc_stream.input.topics import CAMERA_OF, could_serve, distinct, fits, known_elsewhere, nearest
from roadperc_stream.log import Channel, LogSummary
from roadperc_stream.schemas.record import TAG_TABLE_KEY
from roadperc_stream.schemas.roles import REFERENCE_ROLES, ROLES, SHARED_KINDS, Role
from roadperc_stream.schemas.topics import VIDEO_SCHEMAS

_GUESSED_ROLES: Final = ("image", "calibration", "depth", "segmentation", "detections", "lidar", "tf")
"""Roles that take a topic of another name if it is the only one that fits."""
NOTHING_TO_REPLAY: Final = f"no channel for any of the roles {', '.join(REFERENCE_ROLES)}: nothing to replay"
_MOST_CANDIDATES_NAMED: Final = 3
"""Candidates of a role that a note lists."""


class SeveralTopicsError(ChannelError):
    """Several topics fit a role that is needed. ``options`` are topics by role with which the log can be replayed."""

    def __init__(self, role: str, topics: Sequence[str], options: Mapping[str, str], command: str = "") -> None:
        """``command`` replays the log, without the options."""
        self.options = options
        chosen = (f"--topic {shlex.quote(f'{name}={topic}')}" for name, topic in options.items())
        how = " ".join((f"with: {command}" if command else "with", *chosen))
        super().__init__(f"{len(topics)} topics fit role {role}: {', '.join(topics)}; choose one {how}")


RoleFilling = Literal["filled", "missing", "wrong schema", "several channels"]


def assignment_of_log(summary: LogSummary, overrides: Mapping[str, str]) -> RoleAssignment:
    """The roles of a log's channels that have messages; a result keeps its recorded topics.

    Raises:
        ChannelError: as ``assign_roles``; the message names the log.
    """
    present = [channel for channel in summary.channels if summary.counts.get(channel.source_id)]
    named = {**recorded_topics(summary.metadata, present), **overrides}
    files = (str(file.path) for file in summary.files or (summary,))
    try:
        roles = assign_roles(present, named, shlex.join(("roadperc-replay", *files, "OUT.mcap")))
    except ChannelError as error:
        raise ChannelError(f"{summary.path}: {with_path(str(error), summary)}") from error
    chosen = _choices(present, named) if named else {}
    return replace(roles, chosen=chosen, tag_table=recorded_tag_table(summary.metadata))


def with_path(text: str, summary: LogSummary) -> str:
    """The text with the path of a log in the command that converts it."""
    command = f"roadperc-convert {shlex.quote(str(summary.path))}"
    return text if len(summary.files) > 1 else text.replace("roadperc-convert LOG", command)


def _choices(channels: Sequence[Channel], named: Mapping[str, str]) -> dict[str, str]:
    """The named topics that differ from the automatic assignment."""
    try:
        unasked: Mapping[str, str] = assign_roles(channels, {}).topics
    except ChannelError:
        unasked = {}
    return {role: topic for role, topic in named.items() if unasked.get(role) != topic}


def tag_table_to_record(channels: Iterable[Channel], roles: RoleAssignment, configured: str) -> str:
    """The table that the user named, now or earlier, if a channel of tags names none; else empty.

    ``configured`` is the table of this replay, or ``auto``.
    """
    tags = (c for c in channels if any(role.kind == "tags" for role in roles.roles_of(c.topic)) and not is_result(c))
    if all(channel.label(TAG_TABLE_KEY) for channel in tags):
        return ""
    return roles.tag_table if configured == "auto" else configured


def assign_roles(channels: Iterable[Channel], overrides: Mapping[str, str], command: str = "") -> RoleAssignment:
    """Assign topics to roles: topics that the user names, known topics, else the only topic that fits.

    If several fit, those in the namespace of the role's camera come first. If several are left, an optional role stays
    unassigned. Stereo images are only guessed without another image, because other cameras look to the left and right,
    too. Channels with results of earlier replays do not count. ``overrides`` are topics by role, from ``--topic``.
    ``command`` replays the log, for an error.

    Raises:
        SeveralTopicsError: several fit a role that is needed.
        ChannelError: a named topic is missing or has the wrong schema.
    """
    inputs = [channel for channel in channels if not is_result(channel)]
    topics = dict(_named(inputs, overrides))
    guessed, options, several = list[str](), dict[str, str](), dict[str, Sequence[str]]()
    for role in ROLES.values():
        if role.name in topics:
            continue
        known = known_elsewhere(role, (c for c in inputs if c.topic not in topics.values()))
        could = known or (could_serve(role, inputs, topics) if _is_guessed(role, topics) else ())
        near = nearest(could, topics.get(CAMERA_OF.get(role.name, "image"), ""))
        if len(near) > 1 and _is_needed(role, topics):
            several[role.name] = near
            options[role.name] = topics[role.name] = near[0]
        elif len(near) == 1 and near[0] not in topics.values():
            topics[role.name] = near[0]
            guessed += [] if known else [role.name]
    for name, fitting in several.items():
        raise SeveralTopicsError(name, fitting, options, command)
    notes = (f"role {name}: {topics[name]}, the only topic that fits" for name in guessed)
    left = (*_unassigned_in_words(candidates(inputs, topics), inputs), *_videos_in_words(inputs))
    in_order = {name: topics[name] for name in ROLES if name in topics}
    return RoleAssignment(in_order, (*notes, *left), left, frozenset(guessed))


def _named(inputs: Sequence[Channel], overrides: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """The roles and topics that the user or the contract names."""
    for role in ROLES.values():
        topic = overrides.get(role.name, role.topic)
        named = [channel for channel in inputs if channel.topic == topic]
        if role.name in overrides and not named:
            there = ", ".join(distinct(inputs)) or "none"
            raise ChannelError(f"--topic {role.name}={topic}: no such topic; topics in the log: {there}")
        if named:
            state, fault = channel_state(role, named)
            if state != "filled":
                raise ChannelError(f"{topic}: role {role.name}: {fault}")
            yield role.name, topic


def _is_guessed(role: Role, topics: Mapping[str, str]) -> bool:
    if role.name == "left":
        return "image" not in topics
    is_of_camera = CAMERA_OF.get(role.name, "left" if role.name == "right" else "") in topics
    return is_of_camera or role.name in _GUESSED_ROLES


def _is_needed(role: Role, topics: Mapping[str, str]) -> bool:
    """Whether the user must choose if several topics fit: a frame needs an image and its calibration."""
    return role.name in ("image", "calibration") or (role.name == "left" and not topics.keys() & set(REFERENCE_ROLES))


def channel_state(role: Role, named: Sequence[Channel]) -> tuple[RoleFilling, str]:
    """Whether the channels on a topic fit a role, and their fault."""
    if not named:
        return "missing", ""
    for channel in named:
        if not fits(role, channel):
            expected = " or ".join(f"{schema} ({encoding})" for schema, encoding in schemas_of_kind(role.kind))
            found = f"{channel.schema_name or 'no schema'} ({channel.message_encoding or 'no encoding'})"
            hint = f"; {CONVERT_VIDEO}" if channel.schema_name in VIDEO_SCHEMAS else ""
            return "wrong schema", f"found {found}, expected {expected}{hint}"
    if len(named) > 1 and role.kind not in SHARED_KINDS:
        return "several channels", f"{len(named)} channels carry this topic, expected one"
    return "filled", ""


def candidates(channels: Iterable[Channel], topics: Mapping[str, str]) -> Mapping[str, tuple[str, ...]]:
    """Candidate topics of each role without one, the best first; truths have none.

    ``topics`` are those of assigned roles. Without any image or depth, all images are candidates.
    """
    inputs = [channel for channel in channels if not is_result(channel)]
    free = [channel for channel in inputs if channel.topic not in topics.values()]
    left = (role for role in ROLES.values() if role.name not in topics and not role.truth)
    there = set(distinct(free))
    found = {role.name: tuple(t for t in could_serve(role, inputs, topics) if t in there) for role in left}
    if not (topics.keys() | {name for name, could in found.items() if could}) & set(REFERENCE_ROLES):
        found["image"] = distinct(c for c in free if fits(ROLES["image"], c))
    return {name: could for name, could in found.items() if could}


def _videos_in_words(channels: Iterable[Channel]) -> tuple[str, ...]:
    """A line for each topic with video."""
    topics = distinct(channel for channel in channels if channel.schema_name in VIDEO_SCHEMAS)
    return tuple(f"{topic}: video is not read; {CONVERT_VIDEO}" for topic in topics)


def _unassigned_in_words(found: Mapping[str, tuple[str, ...]], channels: Iterable[Channel]) -> tuple[str, ...]:
    """A line for each role with candidates; it lists at most ``_MOST_CANDIDATES_NAMED``."""
    schemas = {channel.topic: channel.schema_name for channel in channels}
    lines = []
    for name, topics in found.items():
        some = ", ".join(f"{topic} ({schemas[topic]})" for topic in topics[:_MOST_CANDIDATES_NAMED])
        more = ", ..." if len(topics) > _MOST_CANDIDATES_NAMED else ""
        lines.append(f"role {name}: not assigned; candidates: {some}{more}: --topic {name}={topics[0]}")
    return tuple(lines)
