"""What of a log is replayed: a first pass that checks it, and the messages of the part that is asked for."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final

from roadperc_stream import log
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.time import TimeRange, ns_to_seconds, seconds_to_ns
from roadperc_stream.errors import ChannelError, NoFrameError, StateError
from roadperc_stream.input.earlier_replay import is_result, replay_record
from roadperc_stream.input.first_pass import FirstPass, InputStart, continued_start, drive_start, first_pass
from roadperc_stream.input.latched import LatchedState, without_loops
from roadperc_stream.input.order import OrderConfig
from roadperc_stream.input.problems import Problems
from roadperc_stream.input.roles import NOTHING_TO_REPLAY, RoleAssignment, assignment_of_log
from roadperc_stream.input.source import ReplaySource
from roadperc_stream.input.state import InputState
from roadperc_stream.input.stream import decoded_messages
from roadperc_stream.input.window import Window, WindowMessages
from roadperc_stream.log import LogSummary, Message
from roadperc_stream.schemas.record import END_KEY
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES

_MOST_DIGITS: Final = 19
"""Of a log time that is recorded."""


@dataclass(frozen=True)
class InputPlan:
    """What a first pass over the log finds: the part to replay, its digest, and what is latched at its start.

    ``latched_messages`` are the calibrations and transforms from before the window that hold in it. They are part of
    the input: without them the output could not be replayed.
    """

    roles: RoleAssignment
    order: OrderConfig
    """Which role's messages make the frames, and how late messages are."""
    window: Window
    start: InputStart
    latched_messages: tuple[Message, ...]
    problems: Problems
    first_pass: FirstPass
    most_frames: int | None = None
    """How many frames are asked for at most: of those that arrive in the part, the first ones by their stamps."""

    @property
    def expected_frames(self) -> int:
        """Messages of the reference role; one that cannot be read makes no frame."""
        there = self.first_pass.counts[self.roles.topics[self.order.reference]] + self.start.frames_waiting
        return there if self.most_frames is None else min(there, self.most_frames)


def plan_input(
    summary: LogSummary, cfg: ReplayConfig, asked: ReplaySource, begin: InputState | None = None
) -> InputPlan:
    """Assign the roles, find the part to replay, and read it once: every CRC is checked before work starts.

    Args:
        summary: of the log.
        cfg: how messages are decoded, paired and waited for.
        asked: what of the log to replay, in seconds from the first message of ``summary``.
        begin: what an earlier part of the drive left; None where the log begins by itself.

    Raises:
        ChannelError: the channels do not fit the roles.
        LogError: the log is damaged.
        NoFrameError: the part asked for holds no frame.
        StateError: the log cannot go on from ``begin``.
    """
    part = asked.time_range
    roles, reference = _roles(summary, asked.overrides, begin)
    problems = Problems(summary.path if asked.strict else None)
    window = _window(summary, cfg, part, roles, reference)
    latched, latched_messages = _latched_at_start(summary, cfg, roles, window, problems)
    order = OrderConfig(reference, seconds_to_ns(cfg.sync.max_wait_s))
    start = drive_start(latched) if begin is None else continued_start(begin, roles, cfg.tag_table)
    messages = WindowMessages(summary, cfg, roles, window, latched_messages).with_late()
    found = first_pass(messages, order, start, problems.strict_in)
    topic = roles.topics[reference]
    if begin is None and not found.counts[topic]:
        length_s = ns_to_seconds((summary.last_ns or 0) - (summary.first_ns or 0))
        lasts = f"the log lasts {length_s:.3f} s"
        raise NoFrameError(f"{summary.path}: no message on {topic} in the part asked for; {lasts}")
    most = None if part.frames is None else part.frames + start.frames_waiting
    order = replace(order, lateness_ns=found.lateness_ns)
    return InputPlan(roles, order, messages.window, start, latched_messages, problems, found, most)


def _roles(summary: LogSummary, overrides: Mapping[str, str], begin: InputState | None) -> tuple[RoleAssignment, str]:
    """The topic of each role, those of earlier parts included, and the role whose messages make the frames."""
    roles = assignment_of_log(summary, overrides) if begin is None else _roles_so_far(summary, overrides, begin)
    if roles.reference is None:
        raise ChannelError("; ".join((f"{summary.path}: {NOTHING_TO_REPLAY}", *roles.unassigned)))
    if begin is not None and roles.reference != begin.reference:
        known, found = begin.reference, roles.reference
        raise StateError(f"{summary.path}: role {found} would make the frames, those before were made by role {known}")
    return roles, roles.reference


def _roles_so_far(summary: LogSummary, overrides: Mapping[str, str], begin: InputState) -> RoleAssignment:
    there = {c.topic for c in summary.channels if summary.counts.get(c.source_id) and not is_result(c)}
    known = {role: topic for role, topic in begin.topics.items() if topic in there}
    roles = assignment_of_log(summary, {**known, **overrides})
    topics = {**roles.topics, **begin.topics, **overrides}
    in_order = {role: topics[role] for role in ROLES if role in topics}
    return replace(roles, topics=in_order, tag_table=roles.tag_table or begin.tag_table)


def span_ns(summary: LogSummary, window: Window) -> tuple[int, int]:
    """First and last log time of the part to replay; what was latched before and what arrives late lie outside."""
    first_ns, last_ns = summary.first_ns or 0, summary.last_ns or 0
    start_ns = first_ns if window.start_ns is None else max(window.start_ns, first_ns)
    end_ns = last_ns if window.end_ns is None else min(window.end_ns, last_ns)
    return start_ns, max(start_ns, end_ns)


def _window(summary: LogSummary, cfg: ReplayConfig, part: TimeRange, roles: RoleAssignment, reference: str) -> Window:
    first_ns, topic = summary.first_ns or 0, roles.topics[reference]
    start_ns = None if part.start_s is None else first_ns + seconds_to_ns(part.start_s)
    end_ns = None if part.end_s is None else first_ns + seconds_to_ns(part.end_s)
    if part.frames is not None:
        inside = log.read(summary, topics=[topic], start_ns=start_ns, end_ns=end_ns)
        beyond = next(islice(inside, part.frames, None), None)
        end_ns = beyond.log_time_ns if beyond else end_ns
    cut_ns = _cut_ns(summary, end_ns)
    if end_ns is None:
        return Window(start_ns, cut_ns=cut_ns)
    beyond_end = log.read(summary, topics=[topic], start_ns=end_ns)
    after = decoded_messages(beyond_end, roles, cfg.tag_table, Problems(), cfg.limits)
    first_after = next((item for item in after if item.role == reference), None)
    return Window(start_ns, end_ns, first_after.stamp_ns if first_after else None, cut_ns)


def _cut_ns(summary: LogSummary, end_ns: int | None) -> int | None:
    """Where the drive goes on elsewhere: at the end asked for, or where an earlier replay's end was, as it recorded."""
    recorded = replay_record(summary.metadata).get(END_KEY, "")
    known = [int(recorded)] if recorded.isascii() and recorded.isdigit() and len(recorded) <= _MOST_DIGITS else []
    asked = [] if end_ns is None or end_ns > (summary.last_ns or 0) else [end_ns]
    return min(known + asked, default=None)


def _latched_at_start(
    summary: LogSummary, cfg: ReplayConfig, roles: RoleAssignment, window: Window, problems: Problems
) -> tuple[LatchedState, tuple[Message, ...]]:
    """Calibrations and transforms that hold at the start: the last ones before it, else the first ones within.

    Also the messages before it that say so, in their order.
    """
    waiting = {role for role in roles.topics if ROLES[role].kind in LATCHED_KINDS}
    topics = {roles.topics[role] for role in waiting}
    latched, sources = LatchedState(), dict[tuple[str, str], Message]()
    for message in log.read(summary, topics=topics, end_ns=window.end_ns) if topics else ():
        before = window.start_ns is not None and message.log_time_ns < window.start_ns
        if not (before or waiting):
            break
        decoded = decoded_messages([message], roles, cfg.tag_table, problems, cfg.limits)
        for item in without_loops(decoded, latched, roles.topics, problems, cfg.limits):
            if before or item.role in waiting:
                latched = latched.updated(item)
                waiting.discard(item.role)
            if before:
                sources |= dict.fromkeys(((item.role, child) for child in item.children()), message)
    kept = {id(message): message for message in sources.values()}
    return latched, tuple(sorted(kept.values(), key=lambda message: message.log_time_ns))
