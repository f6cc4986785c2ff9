"""Which channel of a log is assigned to which role: a named or known topic, else the only one that fits."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, Literal

from roadperc_stream.errors import ChannelError
from roadperc_stream.input.decoding import schemas_of_kind
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
    probe_first_message,
    shared_parts,
    without_a_word,
)
from roadperc_stream.log import Channel, LogSummary
from roadperc_stream.schemas.record import TAG_TABLE_KEY
from roadperc_stream.schemas.roles import REFERENCE_ROLES, ROLES, SHARED_KINDS, Role

_GUESSED_ROLES: Final = ("image", "calibration", "depth", "segmentation", "detections", "tf")
"""Roles that a topic of another name is assigned to, where only one fits."""
_NEEDED_ROLES: Final = ("image", "calibration")
"""Roles without which no frame can be made: where several topics fit, somebody must choose."""
NOTHING_TO_REPLAY: Final = f"no channel for any of the roles {', '.join(REFERENCE_ROLES)}: nothing to replay"
_UNNAMED_ROLES: Final = ("depth", "segmentation")
"""Roles whose images any name may have: what is in them says so, where no name does."""
_MOST_CANDIDATES_NAMED: Final = 3
"""Candidates of a role, in notes."""
RoleFilling = Literal["filled", "missing", "wrong schema", "several channels"]


def guess(role: Role, inputs: Collection[Channel], topics: Mapping[str, str]) -> str | None:
    """The topic of another name that is assigned to a role; None where there is none, or it is ambiguous.

    Points and a pair's images are not guessed, for those of a radar, or of another camera, are of the same schema.

    Raises:
        ChannelError: there are several, and the role is needed.
    """
    if CAMERA_OF.get(role.name) in topics:
        return _calibration(role, inputs, topics)
    return choice(role, fitting(role, unassigned(inputs, topics)), topics) if role.name in _GUESSED_ROLES else None


def _calibration(role: Role, inputs: Collection[Channel], topics: Mapping[str, str]) -> str | None:
    """The only calibration beside a camera's images, else the one whose name says so; never one beside another's.

    Where the only one beside both an image and its depth is the image's, the depth goes with it.

    Raises:
        ChannelError: there are several, and the role is needed.
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
    """The one of a role's topics, in its camera's namespace where there are several; None where that is ambiguous.

    Raises:
        ChannelError: there are several, and the role is needed.
    """
    camera_topic = topics.get(CAMERA_OF.get(role.name, "image"), "")
    near = nearest(could, camera_topic) if len(could) > 1 else could
    if len(near) > 1 and role.name in _NEEDED_ROLES:
        raise ChannelError(
            f"{len(near)} topics fit role {role.name}: {', '.join(near)}; choose one with --topic {role.name}={near[0]}"
        )
    return near[0] if len(near) == 1 else None


def could_serve(role: Role, unused: Collection[Channel], assigned: Mapping[str, str]) -> tuple[str, ...]:
    """A role's candidates by name; of a camera that is there every calibration left over, those beside it first.

    The depth's own calibration is not needed, so that another camera's is none of its candidates.
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
    """The roles of a log's channels that have messages; a result keeps to the topics it was made with.

    Raises:
        ChannelError: as ``assign_roles``; the message names the log.
    """
    present = [channel for channel in summary.channels if summary.counts.get(channel.source_id)]
    named = {**recorded_topics(summary.metadata, present), **overrides}
    try:
        roles = assign_roles(present, named, partial(probe_first_message, summary))
    except ChannelError as error:
        raise ChannelError(f"{summary.path}: {error}") from error
    chosen = _choices(present, named) if named else {}
    return replace(roles, chosen=chosen, tag_table=recorded_tag_table(summary.metadata))


def _choices(channels: Sequence[Channel], named: Mapping[str, str]) -> dict[str, str]:
    """The named topics without which other ones, or none, would have been chosen."""
    try:
        unasked: Mapping[str, str] = assign_roles(channels, {}).topics
    except ChannelError:
        unasked = {}
    return {role: topic for role, topic in named.items() if unasked.get(role) != topic}


def tag_table_to_record(channels: Iterable[Channel], roles: RoleAssignment, configured: str) -> str:
    """The table to be recorded: what the user named, now or earlier, where a channel of tags names none; else empty.

    Args:
        channels: of the log.
        roles: the topic of each.
        configured: table of this replay, or ``auto``.
    """
    tags = (c for c in channels if any(role.kind == "tags" for role in roles.roles_of(c.topic)) and not is_result(c))
    if all(channel.label(TAG_TABLE_KEY) for channel in tags):
        return ""
    return roles.tag_table if configured == "auto" else configured


def assign_roles(
    channels: Iterable[Channel], overrides: Mapping[str, str], probe: ContentProbe | None = None
) -> RoleAssignment:
    """Assign topics to roles: those the user names, those that are known, else the only topic that fits.

    Where several fit, those in the namespace of the role's camera come first; a role that is not needed stays
    unassigned where they still are several.

    Args:
        channels: of the log; results of earlier replays do not count.
        overrides: topic by role, from ``--topic``.
        probe: as ``candidates`` takes it.

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
    left = _unassigned_in_words(candidates(inputs, topics, probe), inputs)
    in_order = {name: topics[name] for name in ROLES if name in topics}
    return RoleAssignment(in_order, (*notes, *left), left, frozenset(guessed))


def channel_state(role: Role, named: Sequence[Channel]) -> tuple[RoleFilling, str]:
    """Whether the channels on a topic can serve a role, and what is wrong with them."""
    if not named:
        return "missing", ""
    for channel in named:
        if not fits(role, channel):
            expected = " or ".join(f"{schema} ({encoding})" for schema, encoding in schemas_of_kind(role.kind))
            found = f"{channel.schema_name or 'no schema'} ({channel.message_encoding or 'no encoding'})"
            return "wrong schema", f"found {found}, expected {expected}"
    if len(named) > 1 and role.kind not in SHARED_KINDS:
        return "several channels", f"{len(named)} channels carry this topic, expected one"
    return "filled", ""


def candidates(
    channels: Iterable[Channel], assigned: Mapping[str, str], probe: ContentProbe | None = None
) -> Mapping[str, tuple[str, ...]]:
    """Topics that could serve the unassigned roles, by role; roles without any, and truths, are left out.

    Args:
        channels: of the log; results of earlier replays do not count.
        assigned: topic of each role that has one; these topics are nobody's candidates.
        probe: says which channels hold depth or tags, where no name does; None if nothing may be read.
    """
    unused = unassigned((channel for channel in channels if not is_result(channel)), assigned)
    left = [role for role in ROLES.values() if role.name not in assigned and not role.truth]
    found = {role.name: could_serve(role, unused, assigned) for role in left}
    if not (assigned.keys() | {name for name, topics in found.items() if topics}) & set(REFERENCE_ROLES):
        found["image"] = distinct(c for c in unused if fits(ROLES["image"], c))
    for name in _UNNAMED_ROLES:
        if probe is not None and name in found and not found[name]:
            found[name] = distinct(c for c in without_a_word(ROLES[name], unused) if probe(ROLES[name].kind, c))
    return {name: topics for name, topics in found.items() if topics}


def _unassigned_in_words(found: Mapping[str, tuple[str, ...]], channels: Iterable[Channel]) -> tuple[str, ...]:
    """A line for each role that some topic could serve; a few of the topics where there are many."""
    schemas = {channel.topic: channel.schema_name for channel in channels}
    lines = []
    for name, topics in found.items():
        some = ", ".join(f"{topic} ({schemas[topic]})" for topic in topics[:_MOST_CANDIDATES_NAMED])
        more = ", ..." if len(topics) > _MOST_CANDIDATES_NAMED else ""
        lines.append(f"role {name}: not assigned; candidates: {some}{more}: --topic {name}={topics[0]}")
    return tuple(lines)
