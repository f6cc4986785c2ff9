"""Plans a replay: finds the requested part of a log, and reads it once to check it.

This first reading checks every CRC, counts the messages, and measures how late they are. It pairs nothing.
"""

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from math import inf

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import ChannelError, NoFrameError, StateError
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.earlier_replay import is_result, replay_record
from roadperc_stream.input.order import OrderConfig, StampOrder
from roadperc_stream.input.replaced import given_for
from roadperc_stream.input.roles import NOTHING_TO_REPLAY, assignment_of_log, with_path
from roadperc_stream.input.source import ReplaySource
from roadperc_stream.input.stream import Problems, RoleAssignment, decoded_messages
from roadperc_stream.input.transforms import NOTHING_LATCHED, LatchedState
from roadperc_stream.input.window import LeadIn, WindowMessages, on_channels_of
from roadperc_stream.log import LogSummary, Message, MessageDigest
from roadperc_stream.schemas.record import END_KEY
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES
from roadperc_stream.system.text import whole_number
from roadperc_stream.system.time import TimeRange, ns_to_seconds, seconds_to_ns


@dataclass
class FirstReading:
    """The findings of the first reading.

    ``digest`` and ``counts`` (by topic) are those of the output's copy.
    """

    digest: MessageDigest = field(default_factory=MessageDigest)
    counts: Counter[str] = field(default_factory=Counter)
    parent_of: dict[str, str] = field(default_factory=dict)
    """The last parent of each frame that a transform places, in this log or an earlier one."""
    frames: int = 0
    """Number of reference messages that are not left out, after those that the lead has already."""
    lateness_ns: int = 0
    settled: tuple[int, float] = 0, -inf
    """No later message can change frames whose segment and stamp are before this."""


def first_reading(
    reader: WindowMessages, order: OrderConfig, latched: LatchedState, problems: Problems
) -> FirstReading:
    """Read all messages once.

    ``latched`` holds at the beginning. ``problems`` are those of unreadable messages.

    Raises:
        LogError: the log is damaged.
    """
    cfg, lead, cut_ns = reader.cfg, reader.lead, reader.cut_ns
    found = FirstReading(parent_of={edge.child: edge.parent for edge in latched.tree.edges.values()})
    known_ns = -1 if lead is None else lead.known_ns
    tolerance_ns, now_ns = seconds_to_ns(cfg.sync.tolerance_s), 0

    def counted(messages: Iterable[Message]) -> Iterator[Message]:
        for message in messages:
            found.digest.update(message)
            found.counts[message.channel.topic] += 1
            yield message

    def messages() -> Iterator[Message]:
        nonlocal now_ns
        deque(counted(reader.latched), maxlen=0)
        before = reader.before()
        yield from counted(before) if lead is not None and lead.continues else before
        for message in counted(reader.inside()):
            now_ns = message.log_time_ns
            yield message

    def without_content() -> Iterator[Stamped]:
        for item in decoded_messages(messages(), reader.roles, cfg, problems, latched.tree):
            found.parent_of |= {edge.child: edge.parent for edge in item.edges}
            found.frames += item.role == order.reference and item.log_time_ns > known_ns
            yield item if item.is_latched else replace(item, payload=())

    def leave_out(item: Stamped) -> None:
        found.frames -= item.role == order.reference and item.log_time_ns > known_ns

    patient = StampOrder(replace(order, lateness_ns=order.max_wait_ns), leave_out)
    for item in patient.through(without_content()):
        if cut_ns is None or now_ns < cut_ns:  # later messages only count, and tell how late messages are
            found.settled = max(found.settled, (item.segment, item.stamp_ns - tolerance_ns))
    found.lateness_ns = patient.lateness_ns
    return found


@dataclass(frozen=True)
class InputPlan:
    """The plan of a replay: its part of the log, and the findings of the first reading.

    ``latched`` holds at the beginning. ``messages`` are those of the part, and the calibrations and transforms from
    before it that hold in it: a replay of the output needs them.
    """

    roles: RoleAssignment
    order: OrderConfig
    """The role that makes the frames, and how late messages are."""
    lead: LeadIn | None
    latched: LatchedState
    messages: WindowMessages
    problems: Problems
    first: FirstReading
    given: LatchedState = NOTHING_LATCHED
    """The cameras and mountings that replace those of the log."""
    most_frames: int | None = None
    """Largest number of frames: the first ones by stamp among those that arrive in the time range."""

    @property
    def continues(self) -> bool:
        """Whether the replay continues an earlier result."""
        return self.lead is not None and self.lead.continues


def plan_input(summary: LogSummary, cfg: ReplayConfig, asked: ReplaySource, lead: LeadIn | None = None) -> InputPlan:
    """Assign the roles, find the part to replay, and read it once: every CRC is checked before work starts.

    ``asked`` is in seconds from the first message of ``summary``; ``lead`` is read before it.

    Raises:
        ChannelError: the channels do not fit the roles.
        DumpError: the given calibration does not fit the log.
        LogError: the log is damaged.
        NoFrameError: the requested part has no frame.
        StateError: the log cannot continue the result of ``lead``.
    """
    part, continues = asked.time_range, lead is not None and lead.continues
    roles, reference = _roles(summary, asked.overrides, lead)
    problems = Problems(summary.path if asked.strict else None)
    messages = _messages_of(summary, cfg, part, (roles, reference), lead)
    own = summary, messages.start_ns, messages.end_ns
    parts = [own] if lead is None else [(lead.summary, lead.start_ns, lead.end_ns), own]
    latched, before = latched_at(parts, cfg, roles, problems)
    if continues:
        before = tuple(on_channels_of(summary, before))
    elif lead is not None:
        _, before = latched_at([own], cfg, roles, Problems())
    order = OrderConfig(reference, seconds_to_ns(cfg.sync.max_wait_s))
    messages = replace(messages, latched=before)
    found = first_reading(messages, order, latched, problems)
    topic = roles.topics[reference]
    if not continues and not found.counts[topic]:
        length_s = ns_to_seconds((summary.last_ns or 0) - (summary.first_ns or 0))
        lasts = f"the log lasts {length_s:.3f} s"
        raise NoFrameError(f"{summary.path}: no message on {topic} in the requested part; {lasts}")
    order = replace(order, lateness_ns=found.lateness_ns)
    given = given_for(summary, roles, cfg)
    return InputPlan(roles, order, lead, latched, messages, problems, found, given, part.frames)


def _roles(summary: LogSummary, overrides: Mapping[str, str], lead: LeadIn | None) -> tuple[RoleAssignment, str]:
    """The topic of each role, including those of the continued result, and the role whose messages make the frames."""
    if lead is None or not lead.continues:
        roles = assignment_of_log(summary, overrides)
    else:
        roles = _roles_so_far(summary, overrides, assignment_of_log(lead.summary, {}))
    if roles.reference is None:
        text = "; ".join((NOTHING_TO_REPLAY, *roles.unassigned))
        raise ChannelError(f"{summary.path}: {with_path(text, summary)}")
    return roles, roles.reference


def _roles_so_far(summary: LogSummary, overrides: Mapping[str, str], before: RoleAssignment) -> RoleAssignment:
    there = {c.topic for c in summary.channels if summary.counts.get(c.source_id) and not is_result(c)}
    known = {role: topic for role, topic in before.topics.items() if topic in there}
    roles = assignment_of_log(summary, {**known, **overrides})
    topics = {**roles.topics, **before.topics, **overrides}
    in_order = {role: topics[role] for role in ROLES if role in topics}
    roles = replace(roles, topics=in_order, tag_table=roles.tag_table or before.tag_table)
    if before.reference != roles.reference:
        raise StateError(
            f"{summary.path}: role {roles.reference} would make the frames: expected role {before.reference}, "
            "as in the continued result"
        )
    return roles


def _messages_of(
    summary: LogSummary, cfg: ReplayConfig, part: TimeRange, assigned: tuple[RoleAssignment, str], lead: LeadIn | None
) -> WindowMessages:
    """The messages of a part of a log; ``assigned`` are its roles, and the one that makes the frames."""
    roles, reference = assigned
    first_ns, topic = summary.first_ns or 0, roles.topics[reference]
    alone = replace(roles, topics={reference: topic})

    def references(start_ns: int | None, end_ns: int | None = None) -> Iterator[Stamped]:
        return decoded_messages(log.read(summary, topics=[topic], start_ns=start_ns, end_ns=end_ns), alone, cfg)

    start_ns = None if part.start_s is None else first_ns + seconds_to_ns(part.start_s)
    end_ns = None if part.end_s is None else first_ns + seconds_to_ns(part.end_s)
    if part.frames is not None:
        wait_ns = seconds_to_ns(cfg.sync.max_wait_s)
        beyond = next(islice(_with_own_stamps(references(start_ns, end_ns), wait_ns), part.frames, None), None)
        end_ns = beyond.log_time_ns if beyond else end_ns
    first_after = None if end_ns is None else next(references(end_ns), None)
    end_stamp_ns = None if first_after is None else first_after.stamp_ns
    return WindowMessages(summary, cfg, roles, start_ns, end_ns, end_stamp_ns, _cut_ns(summary, end_ns), lead)


def _with_own_stamps(items: Iterable[Stamped], wait_ns: int) -> Iterator[Stamped]:
    """The reference messages without those that have the stamp of an earlier one in their segment."""
    stamps, latest_ns = set[int](), 0
    for item in items:
        if item.stamp_ns < latest_ns - wait_ns:
            stamps, latest_ns = set(), 0
        if item.stamp_ns not in stamps:
            yield item
        stamps.add(item.stamp_ns)
        latest_ns = max(latest_ns, item.stamp_ns)


def _cut_ns(summary: LogSummary, end_ns: int | None) -> int | None:
    """The log time from which another replay continues the log: the requested or the recorded end."""
    recorded = replay_record(summary.metadata).get(END_KEY, "")
    known = [] if (stamp_ns := whole_number(recorded)) is None else [stamp_ns]
    asked = [] if end_ns is None or end_ns > (summary.last_ns or 0) else [end_ns]
    return min(known + asked, default=None)


Part = tuple[LogSummary, int | None, int | None]
"""A log and a range of its log times, None without a limit."""


def latched_at(
    parts: Sequence[Part], cfg: ReplayConfig, roles: RoleAssignment, problems: Problems
) -> tuple[LatchedState, tuple[Message, ...]]:
    """Calibrations and transforms that hold at the start of the first part, and the earlier messages with them.

    They are the last ones before that start, else the first later ones.
    """
    waiting = {role for role in roles.topics if ROLES[role].kind in LATCHED_KINDS}
    topics = {roles.topics[role] for role in waiting}
    latched, sources = LatchedState(), dict[tuple[str, str], Message]()
    start_ns = parts[0][1]
    for k, (summary, first_ns, end_ns) in enumerate(parts if topics else ()):
        for message in log.read(summary, topics=topics, start_ns=first_ns if k else None, end_ns=end_ns):
            before = k == 0 and start_ns is not None and message.log_time_ns < start_ns
            if not (before or waiting):
                break
            for item in decoded_messages([message], roles, cfg, problems, latched.tree):
                if before or item.role in waiting:
                    latched = latched.updated(item.role, item.payload)
                    waiting.discard(item.role)
                if before:
                    placed = [edge.child for edge in item.edges] or [""]
                    sources |= dict.fromkeys(((item.role, child) for child in placed), message)
    kept = {id(message): message for message in sources.values()}
    return latched, tuple(sorted(kept.values(), key=lambda message: message.log_time_ns))
