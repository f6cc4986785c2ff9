"""What of a log is replayed: a first pass that checks it, and the messages of the part that is asked for."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

from roadperc_stream import log
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.time import TimeRange, ns_to_seconds, seconds_to_ns
from roadperc_stream.errors import ChannelError, LogError
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.latched import LatchedState, without_loops
from roadperc_stream.input.order import OrderConfig, lateness_ns
from roadperc_stream.input.problems import Problems
from roadperc_stream.input.roles import NOTHING_TO_REPLAY, RoleAssignment, assignment_of_log
from roadperc_stream.input.stream import Stamped, decoded_messages
from roadperc_stream.log import LogSummary, Message, MessageDigest
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES


@dataclass(frozen=True)
class Window:
    """The part of a log, by log time: from ``start_ns`` up to ``end_ns``, None without a limit.

    ``end_stamp_ns`` is the stamp of the first frame beyond: a sensor's message that arrives later than ``end_ns`` but
    belongs to an earlier instant is part of the window still.
    """

    start_ns: int | None = None
    end_ns: int | None = None
    end_stamp_ns: int | None = None


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
    latched: LatchedState
    latched_messages: tuple[Message, ...]
    problems: Problems
    parent_of: Mapping[str, str] = field(default_factory=dict)
    """The last parent of every frame that the transforms of the part place."""
    digest: str = ""
    messages: int = 0
    expected_frames: int = 0
    most_frames: int | None = None
    """How many frames are asked for at most: of those that arrive in the part, the first ones by their stamps."""


def plan_input(
    summary: LogSummary, cfg: ReplayConfig, overrides: Mapping[str, str], part: TimeRange, *, strict: bool = False
) -> InputPlan:
    """Assign the roles, find the part to replay, and read it once: every CRC is checked before work starts.

    Args:
        summary: the log.
        cfg: how messages are decoded.
        overrides: topic of each role that is not on the contract's topic.
        part: what is asked for.
        strict: the first message that cannot be read is an error.

    Raises:
        ChannelError: the channels do not fit the roles.
        LogError: the log is damaged, or the part asked for holds no frame.
    """
    roles = assignment_of_log(summary, overrides)
    if roles.reference is None:
        raise ChannelError("; ".join((f"{summary.path}: {NOTHING_TO_REPLAY}", *roles.unassigned)))
    topic, problems = roles.topics[roles.reference], Problems(summary.path if strict else None)
    window = _window(summary, cfg, part, roles, roles.reference)
    latched, latched_messages = _latched_at_start(summary, cfg, roles, window, problems)
    order = OrderConfig(roles.reference, seconds_to_ns(cfg.sync.max_wait_s))
    plan = InputPlan(roles, order, window, latched, latched_messages, problems)
    digest, counts = MessageDigest(), Counter[str]()
    messages = _counted(input_messages(summary, cfg, plan), digest, counts)
    parent_of: dict[str, str] = {}
    items = _with_parents(
        decoded_messages(messages, roles, cfg.tag_table, Problems(problems.strict_in), cfg.limits), parent_of
    )
    late_ns = lateness_ns(items, plan.order)
    if not counts[topic]:
        length_s = ns_to_seconds((summary.last_ns or 0) - (summary.first_ns or 0))
        lasts = f"the log lasts {length_s:.3f} s"
        raise LogError(f"{summary.path}: no message on {topic} in the part asked for; {lasts}")
    return replace(
        plan,
        parent_of=parent_of,
        digest=digest.hexdigest(),
        messages=counts.total(),
        expected_frames=counts[topic] if part.frames is None else min(counts[topic], part.frames),
        most_frames=part.frames,
        order=replace(plan.order, lateness_ns=late_ns),
    )


def input_messages(
    summary: LogSummary,
    cfg: ReplayConfig,
    plan: InputPlan,
    *,
    topics: Collection[str] | None = None,
) -> Iterator[Message]:
    """The messages to replay, in log-time order: what was latched before, the window, and what arrives late for it.

    Args:
        summary: the log.
        cfg: how long a frame waits for a late sensor.
        plan: the window and what was latched before it.
        topics: only these; None for all.
    """
    window = plan.window
    read = partial(log.read, summary, topics=topics)
    yield from (m for m in plan.latched_messages if topics is None or m.channel.topic in topics)
    yield from (m for m in read(start_ns=window.start_ns, end_ns=window.end_ns) if not is_result(m.channel))
    if window.end_ns is not None and window.end_stamp_ns is not None:
        late_until_ns = window.end_ns + seconds_to_ns(cfg.sync.max_wait_s)
        late = (m for m in read(start_ns=window.end_ns, end_ns=late_until_ns) if not is_result(m.channel))
        yield from (m for m in late if _belongs_before(m, plan.roles, cfg, window.end_stamp_ns))


def span_ns(summary: LogSummary, window: Window) -> tuple[int, int]:
    """First and last log time of the part to replay; what was latched before and what arrives late lie outside."""
    first_ns, last_ns = summary.first_ns or 0, summary.last_ns or 0
    start_ns = first_ns if window.start_ns is None else max(window.start_ns, first_ns)
    end_ns = last_ns if window.end_ns is None else min(window.end_ns, last_ns)
    return start_ns, max(start_ns, end_ns)


def _counted(messages: Iterable[Message], digest: MessageDigest, counts: Counter[str]) -> Iterator[Message]:
    for message in messages:
        digest.update(message)
        counts[message.channel.topic] += 1
        yield message


def _with_parents(items: Iterable[Stamped], parent_of: dict[str, str]) -> Iterator[Stamped]:
    """The items; the last parent of every frame that a transform among them places is kept."""
    for item in items:
        parent_of |= {edge.child: edge.parent for edge in item.edges}
        yield item


def _belongs_before(message: Message, roles: RoleAssignment, cfg: ReplayConfig, end_stamp_ns: int) -> bool:
    """Whether a message of a sensor is of an instant before a stamp."""
    items = decoded_messages([message], roles, cfg.tag_table, Problems(), cfg.limits)
    return any(item.stamp_ns < end_stamp_ns for item in items if ROLES[item.role].kind not in LATCHED_KINDS)


def _window(summary: LogSummary, cfg: ReplayConfig, part: TimeRange, roles: RoleAssignment, reference: str) -> Window:
    first_ns, topic = summary.first_ns or 0, roles.topics[reference]
    start_ns = None if part.start_s is None else first_ns + seconds_to_ns(part.start_s)
    end_ns = None if part.end_s is None else first_ns + seconds_to_ns(part.end_s)
    if part.frames is not None:
        inside = log.read(summary, topics=[topic], start_ns=start_ns, end_ns=end_ns)
        beyond = next(islice(inside, part.frames, None), None)
        end_ns = beyond.log_time_ns if beyond else end_ns
    if end_ns is None:
        return Window(start_ns)
    beyond_end = log.read(summary, topics=[topic], start_ns=end_ns)
    after = decoded_messages(beyond_end, roles, cfg.tag_table, Problems(), cfg.limits)
    first_after = next((item for item in after if item.role == reference), None)
    return Window(start_ns, end_ns, first_after.stamp_ns if first_after else None)


def _latched_at_start(
    summary: LogSummary, cfg: ReplayConfig, roles: RoleAssignment, window: Window, problems: Problems
) -> tuple[LatchedState, tuple[Message, ...]]:
    """Calibrations and transforms that hold at the start: the last ones before it, else the first ones within.

    Also the messages before it that say so, in their order.
    """
    waiting = {role for role in roles.topics if ROLES[role].kind in LATCHED_KINDS}
    topics = {roles.topics[role] for role in waiting}
    latched, sources = LatchedState(), dict[tuple[str, str], Message]()
    before_end = log.read(summary, topics=topics, end_ns=window.end_ns)
    for message in before_end if topics else ():
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
