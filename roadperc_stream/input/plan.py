"""What part of a log is replayed: a first pass that checks it, and the frames of that part."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

from roadperc_stream import log
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import Sample
from roadperc_stream.core.time import ns_to_seconds, seconds_to_ns
from roadperc_stream.errors import ChannelError, LogError
from roadperc_stream.input.assemble import sample_of
from roadperc_stream.input.roles.fill import Filled, Problems, is_result, roles_of_log, stamped_messages
from roadperc_stream.input.sync import HELD_KINDS, Held, Stamped, SyncCounts, reference_role, synchronise
from roadperc_stream.log import LogSummary, Message, MessageDigest
from roadperc_stream.schemas.roles import ROLES

_EDGES_TOLD = 3
"""Transforms that a message about them names."""


@dataclass(frozen=True)
class Cut:
    """What part of a log is replayed: seconds from its first message, and at most so many frames."""

    start_s: float | None = None
    end_s: float | None = None
    frames: int | None = None


WHOLE = Cut()


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
class Survey:
    """What a first pass over the log finds: the part to replay, its digest, and what holds at its start.

    ``held_messages`` are the calibrations and transforms from before the window that hold in it. They are part of the
    input: without them the output could not be replayed.
    """

    filled: Filled
    window: Window
    held: Held
    held_messages: tuple[Message, ...]
    problems: Problems
    parent_of: Mapping[str, str] = field(default_factory=dict)
    """The last parent of every frame that the transforms of the part place."""
    digest: str = ""
    messages: int = 0
    expected_frames: int = 0


def survey_log(summary: LogSummary, cfg: ReplayConfig, overrides: Mapping[str, str], cut: Cut) -> Survey:
    """Find the roles and the part to replay, and read that part once: every CRC is checked before work starts.

    Raises:
        ChannelError: the channels do not fit the roles.
        LogError: the log is damaged, or the part asked for holds no frame.
    """
    filled = roles_of_log(summary, overrides)
    try:
        reference = reference_role(filled.topics)
    except ChannelError as error:
        raise ChannelError("; ".join((f"{summary.path}: {error}", *filled.unfilled))) from error
    window, problems = _window(summary, cfg, cut, filled, reference), Problems()
    held, held_messages = _held_at(summary, cfg, filled, window, problems)
    survey = Survey(filled, window, held, held_messages, problems)
    digest, counts = MessageDigest(), Counter[str]()
    messages = _counted(input_messages(summary, cfg, survey, validate_crcs=not summary.sealed), digest, counts)
    parent_of = _parents(messages, filled, cfg)
    frames = counts[filled.topics[reference]]
    if not frames:
        raise LogError(
            f"{summary.path}: no message on {filled.topics[reference]} in the part asked for; "
            f"the log lasts {_length_s(summary):.3f} s"
        )
    return replace(
        survey, parent_of=parent_of, digest=digest.hexdigest(), messages=counts.total(), expected_frames=frames
    )


def _counted(messages: Iterable[Message], digest: MessageDigest, counts: Counter[str]) -> Iterator[Message]:
    for message in messages:
        digest.update(message)
        counts[message.channel.topic] += 1
        yield message


def _parents(messages: Iterable[Message], filled: Filled, cfg: ReplayConfig) -> dict[str, str]:
    """The last parent of every frame that transforms among the messages place; all messages are gone through."""
    topics = {topic for role, topic in filled.topics.items() if ROLES[role].kind == "tf"}
    transforms = (message for message in messages if message.channel.topic in topics)
    items = stamped_messages(transforms, filled, cfg.tag_table, Problems())
    return {edge.child: edge.parent for item in items for edge in item.edges}


def _length_s(summary: LogSummary) -> float:
    return ns_to_seconds((summary.last_ns or 0) - (summary.first_ns or 0))


def input_messages(
    summary: LogSummary,
    cfg: ReplayConfig,
    survey: Survey,
    *,
    topics: Collection[str] | None = None,
    validate_crcs: bool = False,
) -> Iterator[Message]:
    """The messages to replay, in log-time order: what held before, the window, and what arrives late for it.

    Args:
        summary: the log.
        cfg: how long a frame waits for a late sensor.
        survey: the window and what held before it.
        topics: only these; None for all.
        validate_crcs: check every chunk.
    """
    window = survey.window
    read = partial(log.read, summary.path, topics=topics, validate_crcs=validate_crcs)
    yield from (m for m in survey.held_messages if topics is None or m.channel.topic in topics)
    yield from (m for m in read(start_ns=window.start_ns, end_ns=window.end_ns) if not is_result(m.channel))
    if window.end_ns is not None and window.end_stamp_ns is not None:
        late_until_ns = window.end_ns + seconds_to_ns(cfg.sync.max_wait_s)
        late = (m for m in read(start_ns=window.end_ns, end_ns=late_until_ns) if not is_result(m.channel))
        yield from (m for m in late if _belongs_before(m, survey, cfg, window.end_stamp_ns))


def span_ns(summary: LogSummary, survey: Survey) -> tuple[int, int]:
    """First and last log time of the part to replay; what held before and what arrives late lie outside."""
    first_ns, last_ns = summary.first_ns or 0, summary.last_ns or 0
    window = survey.window
    start_ns = first_ns if window.start_ns is None else max(window.start_ns, first_ns)
    end_ns = last_ns if window.end_ns is None else min(window.end_ns, last_ns)
    return start_ns, max(start_ns, end_ns)


def _belongs_before(message: Message, survey: Survey, cfg: ReplayConfig, end_stamp_ns: int) -> bool:
    """Whether a message of a sensor speaks of an instant before a stamp."""
    items = stamped_messages([message], survey.filled, cfg.tag_table, Problems())
    return any(item.stamp_ns < end_stamp_ns for item in items if ROLES[item.role].kind not in HELD_KINDS)


def _window(summary: LogSummary, cfg: ReplayConfig, cut: Cut, filled: Filled, reference: str) -> Window:
    first_ns, topic = summary.first_ns or 0, filled.topics[reference]
    start_ns = None if cut.start_s is None else first_ns + seconds_to_ns(cut.start_s)
    end_ns = None if cut.end_s is None else first_ns + seconds_to_ns(cut.end_s)
    if cut.frames is not None:
        inside = log.read(summary.path, topics=[topic], start_ns=start_ns, end_ns=end_ns)
        beyond = next(islice(inside, cut.frames, None), None)
        end_ns = beyond.log_time_ns if beyond else end_ns
    if end_ns is None:
        return Window(start_ns)
    after = stamped_messages(log.read(summary.path, topics=[topic], start_ns=end_ns), filled, cfg.tag_table, Problems())
    first_after = next((item for item in after if item.role == reference), None)
    return Window(start_ns, end_ns, first_after.stamp_ns if first_after else None)


def _held_at(
    summary: LogSummary, cfg: ReplayConfig, filled: Filled, window: Window, problems: Problems
) -> tuple[Held, tuple[Message, ...]]:
    """Calibrations and transforms that hold at the start: the last ones before it, else the first ones within.

    Also the messages before it that say so, in their order.
    """
    waiting = {role for role in filled.topics if ROLES[role].kind in HELD_KINDS}
    topics = {filled.topics[role] for role in waiting}
    held, sources = Held(), dict[tuple[str, str], Message]()
    for message in log.read(summary.path, topics=topics, end_ns=window.end_ns) if topics else ():
        before = window.start_ns is not None and message.log_time_ns < window.start_ns
        if not (before or waiting):
            break
        for item in without_loops(stamped_messages([message], filled, cfg.tag_table, problems), held, filled, problems):
            if before or item.role in waiting:
                held = held.updated(item)
                waiting.discard(item.role)
            if before:
                sources |= dict.fromkeys(((item.role, child) for child in item.children()), message)
    kept = {id(message): message for message in sources.values()}
    return held, tuple(sorted(kept.values(), key=lambda message: message.log_time_ns))


def without_loops(items: Iterable[Stamped], held: Held, filled: Filled, problems: Problems) -> Iterator[Stamped]:
    """The items, but for transforms that close a loop: those are left out and told of, as others that make no sense.

    Args:
        items: in the order in which they come to hold.
        held: the tree before the first of them.
        filled: the roles' topics.
        problems: filled in.
    """
    for item in items:
        kept, looped = held.without_loops(item)
        if looped:
            topic = filled.topics[item.role]
            problems.tell(topic, f"{topic}: message at {item.log_time_ns} ns: {_loop_in_words(item, looped)}")
        if kept.edges:
            held = held.updated(kept)
        if kept.edges or not looped:
            yield kept


def _loop_in_words(item: Stamped, children: Collection[str]) -> str:
    edges = [f"{edge.parent!r} to {edge.child!r}" for edge in item.edges if edge.child in children]
    some = ", ".join(edges[:_EDGES_TOLD]) + ", ..." * (len(edges) > _EDGES_TOLD)
    return f"a loop of transforms ({some}), expected a tree: left out"


def samples(
    summary: LogSummary, survey: Survey, cfg: ReplayConfig, counts: SyncCounts, problems: Problems
) -> Iterator[Sample]:
    """The frames of the part to replay, in order.

    Raises:
        ChannelError: a camera without calibration; the message names it.
    """
    filled = survey.filled
    messages = input_messages(summary, cfg, survey, topics=set(filled.topics.values()))
    decoded = stamped_messages(messages, filled, cfg.tag_table, problems)
    items = without_loops(decoded, survey.held, filled, problems)
    reference = reference_role(filled.topics)
    for index, moment in enumerate(synchronise(cfg.sync, items, reference, filled.topics, survey.held, counts)):
        try:
            sample = sample_of(cfg, moment, index, filled.topics, survey.parent_of)
        except ChannelError as error:
            known = (*survey.problems.first.values(), *filled.unfilled)
            raise ChannelError("; ".join((f"{summary.path}: {error}", *known))) from error
        if "truth_pose" in moment.parts and sample.truth.odom_T_ego is None:
            topic = filled.topics["truth_pose"]
            problems.tell(topic, f"{topic}: no transform connects the frame of its poses with ego: they are no truth")
        yield sample
