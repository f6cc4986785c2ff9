"""Plans a replay: finds the requested part of a log, and reads it once to check it.

This first pass measures the lateness of the messages and gives the state for a continued replay. It pairs messages like
the replay, but waits the full ``max_wait`` for each and drops contents. Later messages cannot change frames that are
complete after this pass; a continued replay takes the messages that still wait.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import ChannelError, NoFrameError, StateError
from roadperc_stream.input.earlier_replay import is_result, replay_record
from roadperc_stream.input.order import OrderConfig
from roadperc_stream.input.replaced import rig_of_log
from roadperc_stream.input.rig import NO_RIG, Rig
from roadperc_stream.input.roles import NOTHING_TO_REPLAY, assignment_of_log, with_paths
from roadperc_stream.input.source import ReplaySource
from roadperc_stream.input.state import InputState, PendingMessage, pending, restored
from roadperc_stream.input.stream import Problems, RoleAssignment, Stamped, decoded_messages
from roadperc_stream.input.sync import LatchedState, PairingState, StampPairing, without_loops
from roadperc_stream.input.transforms import TransformTree
from roadperc_stream.input.window import Window, WindowMessages
from roadperc_stream.log import LogSummary, Message, MessageDigest
from roadperc_stream.schemas.record import END_KEY
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES
from roadperc_stream.system.text import whole_number
from roadperc_stream.system.time import TimeRange, ns_to_seconds, seconds_to_ns


@dataclass(frozen=True)
class FirstPass:
    """The findings of the first pass.

    ``counts`` has the messages of each topic. ``parent_of`` has the last parent of each frame that a transform places,
    in this log or an earlier one. No later message can change the first ``complete_frames``; ``end`` is the state after
    them. ``left_out`` is the number of reference messages that are left out.
    """

    digest: str
    counts: Counter[str]
    lateness_ns: int
    parent_of: Mapping[str, str]
    complete_frames: int
    end: InputState
    left_out: int


@dataclass
class _Tally:
    """Counts over the messages of a pass."""

    arrived: TransformTree
    parent_of: dict[str, str]
    digest: MessageDigest = field(default_factory=MessageDigest)
    counts: Counter[str] = field(default_factory=Counter)
    last_ns: int | None = None

    def counted(self, messages: Iterable[Message]) -> Iterator[Message]:
        for message in messages:
            self.digest.update(message)
            self.counts[message.channel.topic] += 1
            self.last_ns = message.log_time_ns
            yield message

    def with_parents(self, items: Iterable[Stamped]) -> Iterator[Stamped]:
        for item in items:
            self.parent_of |= {edge.child: edge.parent for edge in item.edges}
            yield item


def first_pass(
    reader: WindowMessages,
    order: OrderConfig,
    start: InputState,
    begun: PairingState[Stamped],
    strict_in: Path | None = None,
) -> FirstPass:
    """Read all messages once.

    ``begun`` are the pending messages of ``start``. An error at the first unreadable message names the log
    ``strict_in``; None counts such messages.

    Raises:
        LogError: the log is damaged.
    """
    roles, cfg = reader.roles, reader.cfg
    tally = _Tally(start.arrived, dict(start.parent_of))
    patient = replace(order, lateness_ns=order.max_wait_ns)
    left_out = Counter[str]()
    pairing = StampPairing(cfg.sync, patient, roles.topics, begun, lambda item: left_out.update((item.role,)))

    def items(messages: Iterable[Message]) -> Iterator[Stamped]:
        """The messages to pair, without the contents, which pairing does not need."""
        decoded = decoded_messages(tally.counted(messages), roles, cfg.tag_table, Problems(strict_in), cfg.limits)
        known = replace(start, arrived=tally.arrived)
        for item in known.to_come(tally.with_parents(decoded), roles.topics, Problems(), cfg.limits):
            tally.arrived = tally.arrived.updated(item.edges) if item.edges else tally.arrived
            yield item if item.is_latched else replace(item, payload=())

    numbers = start.numbers
    for synced in pairing.through(items(reader.inside())):
        numbers = numbers.after(synced.reference)
    complete_frames, cut_ns = pairing.frames, reader.window.cut_ns
    end = replace(
        start,
        from_ns=max(start.from_ns, (tally.last_ns or 0) if cut_ns is None else cut_ns),
        topics=roles.topics,
        tag_table=roles.tag_table,
        parent_of=dict(tally.parent_of),
        arrived=tally.arrived,
        pairing=pairing.state.mapped(pending),
        numbers=numbers,
    )
    for _ in pairing.through(items(reader.late())):
        pass  # only to measure their lateness
    measured = tally.digest.hexdigest(), tally.counts, pairing.lateness_ns, tally.parent_of
    return FirstPass(*measured, complete_frames, end, left_out[order.reference])


@dataclass(frozen=True)
class InputPlan:
    """The plan of a replay: its part of the log, the findings of the first pass, and the state at its start.

    ``latched_messages`` has the calibrations and transforms from before the window that hold in it. They are part of
    the input, because a replay of the output needs them.
    """

    roles: RoleAssignment
    order: OrderConfig
    """The role that makes the frames, and how late messages are."""
    window: Window
    start: InputState
    """The state before the first message: latched messages, or the end state of an earlier log."""
    begun: PairingState[Stamped]
    """The pending messages of ``start``."""
    is_continuation: bool
    latched_messages: tuple[Message, ...]
    problems: Problems
    first_pass: FirstPass
    rig: Rig = NO_RIG
    """The cameras and mountings that replace those of the log."""
    most_frames: int | None = None
    """Largest number of frames: the first ones by stamp among those that arrive in the time range."""


def plan_input(
    summary: LogSummary, cfg: ReplayConfig, asked: ReplaySource, begin: InputState | None = None
) -> InputPlan:
    """Assign the roles, find the part to replay, and read it once: every CRC is checked before work starts.

    ``asked`` is in seconds from the first message of ``summary``; ``begin`` is the end state of a continued result.

    Raises:
        ChannelError: the channels do not fit the roles.
        DumpError: the given calibration does not fit the log.
        LogError: the log is damaged.
        NoFrameError: the requested part has no frame.
        StateError: the log cannot continue from ``begin``.
    """
    part = asked.time_range
    roles, reference = _roles(summary, asked.overrides, begin)
    problems = Problems(summary.path if asked.strict else None)
    window = _window(summary, cfg, part, roles, reference)
    latched, latched_messages = _latched_at_start(summary, cfg, roles, window, problems)
    order = OrderConfig(reference, seconds_to_ns(cfg.sync.max_wait_s))
    waiting = PairingState[PendingMessage](latched=latched)
    start = begin or InputState(0, reference, roles.topics, roles.tag_table, {}, latched.tree, waiting)
    begun = restored(start, roles, cfg.tag_table)
    messages = WindowMessages(summary, cfg, roles, window, latched_messages).with_late()
    found = first_pass(messages, order, start, begun, problems.strict_in)
    topic = roles.topics[reference]
    if begin is None and not found.counts[topic]:
        length_s = ns_to_seconds((summary.last_ns or 0) - (summary.first_ns or 0))
        lasts = f"the log lasts {length_s:.3f} s"
        raise NoFrameError(f"{summary.path}: no message on {topic} in the requested part; {lasts}")
    most = None if part.frames is None else part.frames + start.frames_waiting
    order = replace(order, lateness_ns=found.lateness_ns)
    read = messages.window, start, begun, begin is not None, latched_messages
    return InputPlan(roles, order, *read, problems, found, rig_of_log(summary, roles, cfg), most)


def _roles(summary: LogSummary, overrides: Mapping[str, str], begin: InputState | None) -> tuple[RoleAssignment, str]:
    """The topic of each role, including those of the continued result, and the role whose messages make the frames."""
    roles = assignment_of_log(summary, overrides) if begin is None else _roles_so_far(summary, overrides, begin)
    if roles.reference is None:
        text = "; ".join((NOTHING_TO_REPLAY, *roles.unassigned))
        raise ChannelError(f"{summary.path}: {with_paths(text, summary)}")
    if begin is not None and roles.reference != begin.reference:
        known, found = begin.reference, roles.reference
        raise StateError(
            f"{summary.path}: role {found} would make the frames: expected role {known}, as in the continued result"
        )
    return roles, roles.reference


def _roles_so_far(summary: LogSummary, overrides: Mapping[str, str], begin: InputState) -> RoleAssignment:
    there = {c.topic for c in summary.channels if summary.counts.get(c.source_id) and not is_result(c)}
    known = {role: topic for role, topic in begin.topics.items() if topic in there}
    roles = assignment_of_log(summary, {**known, **overrides})
    topics = {**roles.topics, **begin.topics, **overrides}
    in_order = {role: topics[role] for role in ROLES if role in topics}
    return replace(roles, topics=in_order, tag_table=roles.tag_table or begin.tag_table)


def _window(summary: LogSummary, cfg: ReplayConfig, part: TimeRange, roles: RoleAssignment, reference: str) -> Window:
    first_ns, topic = summary.first_ns or 0, roles.topics[reference]
    start_ns = None if part.start_s is None else first_ns + seconds_to_ns(part.start_s)
    end_ns = None if part.end_s is None else first_ns + seconds_to_ns(part.end_s)
    if part.frames is not None:
        inside = log.read(summary, topics=[topic], start_ns=start_ns, end_ns=end_ns)
        beyond = next(islice(_with_own_stamps(inside, cfg, roles, reference), part.frames, None), None)
        end_ns = beyond.log_time_ns if beyond else end_ns
    cut_ns = _cut_ns(summary, end_ns)
    if end_ns is None:
        return Window(start_ns, cut_ns=cut_ns)
    beyond_end = log.read(summary, topics=[topic], start_ns=end_ns)
    after = decoded_messages(beyond_end, roles, cfg.tag_table, Problems(), cfg.limits)
    first_after = next((item for item in after if item.role == reference), None)
    return Window(start_ns, end_ns, first_after.stamp_ns if first_after else None, cut_ns)


def _with_own_stamps(
    messages: Iterable[Message], cfg: ReplayConfig, roles: RoleAssignment, reference: str
) -> Iterator[Message]:
    """The reference messages without those that have the stamp of an earlier one in their segment."""
    stamps = set[int]()
    latest_ns, wait_ns = 0, seconds_to_ns(cfg.sync.max_wait_s)
    for message in messages:
        decoded = decoded_messages([message], roles, cfg.tag_table, Problems(), cfg.limits)
        stamp_ns = next((item.stamp_ns for item in decoded if item.role == reference), None)
        if stamp_ns is not None and stamp_ns < latest_ns - wait_ns:
            stamps, latest_ns = set(), stamp_ns
        if stamp_ns is None or stamp_ns not in stamps:
            yield message
        if stamp_ns is not None:
            stamps.add(stamp_ns)
            latest_ns = max(latest_ns, stamp_ns)


def _cut_ns(summary: LogSummary, end_ns: int | None) -> int | None:
    """The log time from which another replay continues the log: the requested or the recorded end."""
    recorded = replay_record(summary.metadata).get(END_KEY, "")
    known = [] if (stamp_ns := whole_number(recorded)) is None else [stamp_ns]
    asked = [] if end_ns is None or end_ns > (summary.last_ns or 0) else [end_ns]
    return min(known + asked, default=None)


def _latched_at_start(
    summary: LogSummary, cfg: ReplayConfig, roles: RoleAssignment, window: Window, problems: Problems
) -> tuple[LatchedState, tuple[Message, ...]]:
    """Calibrations and transforms that hold at the start: the last ones before it, else the first ones within.

    Also the messages before the start that contain them, in order.
    """
    waiting = {role for role in roles.topics if ROLES[role].kind in LATCHED_KINDS}
    topics = {roles.topics[role] for role in waiting}
    latched, sources = LatchedState(), dict[tuple[str, str], Message]()
    for message in log.read(summary, topics=topics, end_ns=window.end_ns) if topics else ():
        before = window.start_ns is not None and message.log_time_ns < window.start_ns
        if not (before or waiting):
            break
        decoded = decoded_messages([message], roles, cfg.tag_table, problems, cfg.limits)
        for item in without_loops(decoded, latched.tree, roles.topics, problems, cfg.limits):
            if before or item.role in waiting:
                latched = latched.updated(item)
                waiting.discard(item.role)
            if before:
                placed = [edge.child for edge in item.edges] or [""]
                sources |= dict.fromkeys(((item.role, child) for child in placed), message)
    kept = {id(message): message for message in sources.values()}
    return latched, tuple(sorted(kept.values(), key=lambda message: message.log_time_ns))
