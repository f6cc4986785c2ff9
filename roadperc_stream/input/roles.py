"""Assigns the channels of a log to roles: a named or known topic, else the only one that fits."""

import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, Literal

from roadperc_stream.errors import ChannelError
from roadperc_stream.input.decoding import schemas_of_kind
from roadperc_stream.input.decoding.pictures import CONVERT_VIDEO
from roadperc_stream.input.earlier_replay import is_result, recorded_tag_table, recorded_topics
from roadperc_stream.input.stream import RoleAssignment
from roadperc_stream.input.topics import (
    CAMERA_OF,
    ContentProbe,
    beside_camera,
    distinct,
    fits,
    fitting,
    known_elsewhere,
    nearest,
    other_side,
    preferred,
    probe_first_message,
    shared_parts,
    without_a_word,
)
from roadperc_stream.log import Channel, LogSummary
from roadperc_stream.schemas.record import TAG_TABLE_KEY
from roadperc_stream.schemas.roles import REFERENCE_ROLES, ROLES, SHARED_KINDS, Role
from roadperc_stream.schemas.topics import VIDEO_SCHEMAS

_GUESSED_ROLES: Final = ("image", "calibration", "depth", "segmentation", "detections", "lidar", "tf")
"""Roles that take a topic of another name if it is the only one that fits."""
_NEEDED_ROLES: Final = ("image", "calibration")
"""Roles that every frame needs: if several topics fit, the user must choose."""
NOTHING_TO_REPLAY: Final = f"no channel for any of the roles {', '.join(REFERENCE_ROLES)}: nothing to replay"
_UNNAMED_ROLES: Final = ("depth", "segmentation")
"""Roles whose images are recognised by their contents if no name matches."""
_MOST_CANDIDATES_NAMED: Final = 3
"""Candidates of a role that a note lists."""


class SeveralTopicsError(ChannelError):
    """Several topics fit a role that is needed. ``options`` are topics by role with which the log can be replayed."""

    def __init__(self, role: str, topics: Sequence[str], options: Mapping[str, str] | None = None) -> None:
        """Make the message; of ``topics`` the best one is the first."""
        self.role, self.topics, self.options = role, topics, options or {role: topics[0]}
        chosen = " ".join(f"--topic {shlex.quote(f'{name}={topic}')}" for name, topic in self.options.items())
        super().__init__(f"{len(topics)} topics fit role {role}: {', '.join(topics)}; choose one with {chosen}")


RoleFilling = Literal["filled", "missing", "wrong schema", "several channels"]


def guess(role: Role, inputs: Collection[Channel], topics: Mapping[str, str]) -> str | None:
    """The topic of another name for a role; None without one, or if it is ambiguous.

    Stereo images are only guessed without another image, because other cameras look to the left and right, too.

    Raises:
        SeveralTopicsError: several topics fit, and the role is needed.
    """
    if CAMERA_OF.get(role.name) in topics:
        return _calibration(role, inputs, topics)
    if role.name == "right" and "left" in topics:
        return other_side(topics["left"], unassigned(inputs, topics))
    is_guessed = role.name in _GUESSED_ROLES or (role.name == "left" and "image" not in topics)
    could = fitting(role, unassigned(inputs, topics)) if is_guessed else ()
    return choice(role, preferred(could, role, inputs), topics)


def _calibration(role: Role, inputs: Collection[Channel], topics: Mapping[str, str]) -> str | None:
    """The only calibration in the namespace of a camera's images, else the one whose name matches.

    A calibration in another camera's namespace does not count. A depth camera may share the image's calibration.

    Raises:
        ChannelError: several topics fit, and the role is needed.
    """
    others = {name: CAMERA_OF[name] for name in CAMERA_OF if name != role.name and CAMERA_OF[name] in topics}
    if role.name == "calibration":
        others.pop("depth_calibration", None)
    theirs = {t for name, camera in others.items() for t in beside_camera(ROLES[name], topics[camera], inputs)}
    beside = beside_camera(role, topics[CAMERA_OF[role.name]], inputs)
    elsewhere = fitting(role, (c for c in unassigned(inputs, topics) if c.topic not in theirs))
    found = choice(role, beside or elsewhere, topics)
    return None if found in theirs or found in topics.values() else found


def choice(role: Role, could: tuple[str, ...], topics: Mapping[str, str]) -> str | None:
    """The only topic for a role, or the only one nearest to its camera's namespace; None if ambiguous.

    Raises:
        SeveralTopicsError: several topics fit, and the role is needed.
    """
    camera_topic = topics.get(CAMERA_OF.get(role.name, "image"), "")
    near = nearest(could, camera_topic) if len(could) > 1 else could
    is_left_needed = role.name == "left" and not topics.keys() & set(REFERENCE_ROLES)
    if len(near) > 1 and (role.name in _NEEDED_ROLES or is_left_needed):
        raise SeveralTopicsError(role.name, near)
    return near[0] if len(near) == 1 else None


def could_serve(role: Role, unused: Collection[Channel], assigned: Mapping[str, str]) -> tuple[str, ...]:
    """A role's candidates by name. For a present camera also all unassigned calibrations, the nearest first.

    The depth calibration is optional, so another camera's calibration is not a candidate for it.
    """
    camera_topic = assigned.get(CAMERA_OF.get(role.name, ""))
    named = fitting(role, unused)
    if camera_topic is None:
        return named
    beside = beside_camera(role, camera_topic, unused)
    left_over = distinct(c for c in unused if fits(role, c)) if role.name != "depth_calibration" else ()
    found = dict.fromkeys((*beside, *(named or left_over)))
    return tuple(sorted(found, key=lambda topic: -shared_parts(topic, camera_topic)))


def unassigned(channels: Iterable[Channel], topics: Mapping[str, str]) -> list[Channel]:
    """Channels whose topics are assigned to no role."""
    return [channel for channel in channels if channel.topic not in topics.values()]


def assignment_of_log(summary: LogSummary, overrides: Mapping[str, str]) -> RoleAssignment:
    """The roles of a log's channels that have messages; a result keeps its recorded topics.

    Raises:
        ChannelError: as ``assign_roles``; the message names the log.
    """
    present = [channel for channel in summary.channels if summary.counts.get(channel.source_id)]
    named = {**recorded_topics(summary.metadata, present), **overrides}
    try:
        roles = assign_roles(present, named, partial(probe_first_message, summary))
    except ChannelError as error:
        raise ChannelError(f"{summary.path}: {with_paths(str(error), summary)}") from error
    chosen = _choices(present, named) if named else {}
    return replace(roles, chosen=chosen, tag_table=recorded_tag_table(summary.metadata))


def with_paths(text: str, summary: LogSummary) -> str:
    """The text with whole commands for a log, which the parts of a text do not know."""
    files = [str(file.path) for file in summary.files or (summary,)]
    command = shlex.join(("roadperc-replay", *files, "OUT.mcap"))
    text = text.replace("choose one with --topic", f"choose one with: {command} --topic")
    return text if len(files) > 1 else text.replace("roadperc-convert LOG", shlex.join(("roadperc-convert", *files)))


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


def assign_roles(
    channels: Iterable[Channel], overrides: Mapping[str, str], probe: ContentProbe | None = None
) -> RoleAssignment:
    """Assign topics to roles: topics that the user names, known topics, else the only topic that fits.

    If several fit, those in the namespace of the role's camera come first. If several are left, an optional role stays
    unassigned. Channels with results of earlier replays do not count. ``overrides`` are topics by role, from
    ``--topic``.

    Raises:
        SeveralTopicsError: several fit a role that is needed.
        ChannelError: a named topic is missing or has the wrong schema.
    """
    inputs = [channel for channel in channels if not is_result(channel)]
    try:
        return _assigned(inputs, overrides, probe)
    except SeveralTopicsError as error:
        raise SeveralTopicsError(error.role, error.topics, _options(inputs, overrides, error)) from error


def _options(inputs: Sequence[Channel], overrides: Mapping[str, str], error: SeveralTopicsError) -> dict[str, str]:
    """The best topics by role with which no role has several."""
    chosen = {error.role: error.topics[0]}
    try:
        _assigned(inputs, {**overrides, **chosen}, None)
    except SeveralTopicsError as further:
        chosen |= _options(inputs, {**overrides, **chosen}, further)
    except ChannelError:  # an error that no topic mends
        pass
    return chosen


def _assigned(inputs: Sequence[Channel], overrides: Mapping[str, str], probe: ContentProbe | None) -> RoleAssignment:
    topics: dict[str, str] = {}
    for role in ROLES.values():
        topic = overrides.get(role.name, role.topic)
        named = [channel for channel in inputs if channel.topic == topic]
        if role.name in overrides and not named:
            there = ", ".join(sorted({channel.topic for channel in inputs})) or "none"
            raise ChannelError(f"--topic {role.name}={topic}: no such topic; topics in the log: {there}")
        if named:
            state, fault = channel_state(role, named)
            if state != "filled":
                raise ChannelError(f"{topic}: role {role.name}: {fault}")
            topics[role.name] = topic
    for role in ROLES.values():
        elsewhere = known_elsewhere(role, unassigned(inputs, topics))
        if role.name not in topics and (known := choice(role, elsewhere, topics)):
            topics[role.name] = known
    guessed = []
    for role in ROLES.values():
        if role.name not in topics and (only := guess(role, inputs, topics)):
            topics[role.name] = only
            guessed.append(role.name)
    notes = (f"role {name}: {topics[name]}, the only topic that fits" for name in guessed)
    left = (*_unassigned_in_words(candidates(inputs, topics, probe), inputs), *_videos_in_words(inputs))
    in_order = {name: topics[name] for name in ROLES if name in topics}
    return RoleAssignment(in_order, (*notes, *left), left, frozenset(guessed))


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


def candidates(
    channels: Iterable[Channel], assigned: Mapping[str, str], probe: ContentProbe | None = None
) -> Mapping[str, tuple[str, ...]]:
    """Candidate topics of each unassigned role; roles without candidates, and truths, are left out.

    Args:
        channels: of the log; results of earlier replays do not count.
        assigned: topic of each assigned role; these topics are not candidates.
        probe: tells whether a channel has depth or tags if its name does not; None to read no messages.
    """
    channels = [channel for channel in channels if not is_result(channel)]
    unused = unassigned(channels, assigned)
    left = [role for role in ROLES.values() if role.name not in assigned and not role.truth]
    found = {role.name: could_serve(role, unused, assigned) for role in left}
    if not (assigned.keys() | {name for name, topics in found.items() if topics}) & set(REFERENCE_ROLES):
        found["image"] = distinct(c for c in unused if fits(ROLES["image"], c))
    for name in _UNNAMED_ROLES:
        if probe is not None and name in found and not found[name]:
            found[name] = distinct(c for c in without_a_word(ROLES[name], unused) if probe(ROLES[name].kind, c))
    images = {name: preferred(found[name], ROLES[name], channels) for name in found.keys() - CAMERA_OF.keys()}
    return {name: images.get(name, topics) for name, topics in found.items() if topics}


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
