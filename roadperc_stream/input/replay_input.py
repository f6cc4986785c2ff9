"""A log as the input of a replay: what every loop over frames opens."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

from roadperc_stream import log
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import Sample
from roadperc_stream.core.time import WHOLE, TimeRange, seconds_to_ns
from roadperc_stream.errors import ChannelError, LogError
from roadperc_stream.input.assemble import sample_of
from roadperc_stream.input.damage import loss_reason, require_outside, shifted, warnings_of
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.latched import without_loops
from roadperc_stream.input.order import in_stamp_order
from roadperc_stream.input.parts import part_notes
from roadperc_stream.input.plan import InputPlan, input_messages, plan_input, span_ns
from roadperc_stream.input.problems import Problems
from roadperc_stream.input.roles import tag_table_to_record
from roadperc_stream.input.stream import Stamped, decoded_messages
from roadperc_stream.input.sync import SyncedMessages, Synchroniser
from roadperc_stream.log import Channel, DamagedLogError, LogSummary, Message, Recovery
from roadperc_stream.schemas.record import DIGEST_KEY, DROPPED_KEY, FRAMES_KEY, TAG_TABLE_KEY, TOPIC_KEY, log_id_of
from roadperc_stream.schemas.roles import require_role


def open_input(
    source: Path | Sequence[Path],
    cfg: ReplayConfig,
    overrides: Mapping[str, str] | None = None,
    time_range: TimeRange = WHOLE,
    *,
    recover: bool = False,
    strict: bool = False,
) -> "ReplayInput":
    """Check a log, assign its channels to roles, and find the part to replay.

    Args:
        source: the log, or its parts; a path ``-`` is standard input.
        cfg: how messages are decoded, paired and placed.
        overrides: topic of each role that is not on the contract's topic.
        time_range: the part to replay; the copy of the input is cut with it.
        recover: replay what can be read of a damaged log.
        strict: the first message that cannot be used is an error.

    Raises:
        ChannelError: a role does not exist, or the channels do not fit the roles.
        LogError: the log cannot be read, is damaged in the part asked for, or that part holds no frame.
        TargetError: there is no space for temporary files, where the log needs some.
    """
    for role, topic in (overrides or {}).items():
        require_role(role, f"topic {topic}")
    sources = log.received([source] if isinstance(source, Path) else source)
    try:
        return _planned(log.summarise(sources, cfg.limits), cfg, overrides or {}, time_range, strict=strict)
    except DamagedLogError as damage:
        if time_range == WHOLE and not recover:
            raise
        found = [log.audited(path, cfg.limits) for path in sources]
        copies = [None if salvage.whole else log.repaired_copy(salvage.path, cfg.limits) for salvage in found]
        saved = log.summarise(
            [copy.path if copy else path for copy, path in zip(copies, sources, strict=True)], cfg.limits
        )
        first_ns = min((salvage.first_ns for salvage in found if salvage.first_ns is not None), default=None)
        log_in = _planned(saved, cfg, overrides or {}, shifted(time_range, first_ns, saved.first_ns), strict=strict)
        damaged = [copy for copy in copies if copy is not None]
        if not recover:
            window = log_in.plan.window
            for copy in damaged:
                require_outside(damage, copy.salvage.damages, window.start_ns, window.end_ns)
        log_in.warnings = tuple(
            warning
            for copy in damaged
            for warning in warnings_of(copy.path, copy.salvage.damages, copy.recovery, first_ns)
        )
        return log_in


def _planned(
    summary: LogSummary, cfg: ReplayConfig, overrides: Mapping[str, str], time_range: TimeRange, *, strict: bool
) -> "ReplayInput":
    return ReplayInput(summary, cfg, plan_input(summary, cfg, overrides, time_range, strict=strict))


class ReplayInput:
    """The frames of a log, the messages they are made of, and what became of these.

    ``frames``, ``dropped``, ``unreadable`` and ``notes`` are of the samples so far; ``samples`` begins anew.
    """

    warnings: tuple[str, ...] = ()
    """What the user should know of a damaged log."""

    def __init__(self, summary: LogSummary, cfg: ReplayConfig, plan: InputPlan) -> None:
        self.summary, self.plan = summary, plan
        self._cfg = cfg
        recovery = Recovery.of_records(summary.metadata)
        self._gaps = () if recovery is None else recovery.gaps
        self._begin()

    def _begin(self) -> None:
        plan = self.plan
        self._problems = Problems(plan.problems.strict_in)
        self._dropped = Counter[str]()
        tolerance_ns = seconds_to_ns(self._cfg.sync.tolerance_s)
        roles = plan.roles.topics
        self._synchroniser = Synchroniser(tolerance_ns, plan.order, roles, plan.latched, self._drop)

    @property
    def log_id(self) -> str:
        """What names the log in every table."""
        return log_id_of(self.plan.digest)

    @property
    def topics(self) -> Mapping[str, str]:
        """Topic of each role that the log has."""
        return self.plan.roles.topics

    @property
    def expected_frames(self) -> int:
        """Messages of the reference role; one that cannot be read makes no frame."""
        return self.plan.expected_frames

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time of the part to replay."""
        return span_ns(self.summary, self.plan.window)

    def samples(self) -> Iterator[Sample]:
        """The frames in order, a few messages in memory at a time.

        Raises:
            ChannelError: a camera without calibration; the message names it.
            LogError: no message makes a frame.
        """
        self._begin()
        plan, topics = self.plan, self.topics
        messages = input_messages(self.summary, self._cfg, plan, topics=set(topics.values()))
        decoded = decoded_messages(messages, plan.roles, self._cfg.tag_table, self._problems, self._cfg.limits)
        items = without_loops(decoded, plan.latched, topics, self._problems, self._cfg.limits)
        ordered = in_stamp_order(items, plan.order, self._drop)
        log_time_ns, before_ns = 0, None
        for index, synced in enumerate(islice(self._synchroniser.synced(ordered), plan.most_frames)):
            sample = self._sample(synced, index)
            log_time_ns = max(log_time_ns, sample.log_time_ns)  # results do not go back in the log
            lost = loss_reason(self._gaps, before_ns, log_time_ns)
            yield replace(sample, log_time_ns=log_time_ns, lost=lost)
            before_ns = log_time_ns
        if not self.frames:
            topic = self.topics[plan.order.reference]
            raise LogError(f"{self.summary.path}: no message on {topic} makes a frame; {'; '.join(self.notes)}")

    def _drop(self, item: Stamped) -> None:
        self._dropped[item.role] += 1
        if item.role == self.plan.order.reference:
            topic, stamp = self.topics[item.role], f"stamp {item.stamp_ns} ns at log time {item.log_time_ns} ns"
            self._problems.report(topic, f"{topic}: message with {stamp}: too late for its place, left out")

    def _sample(self, synced: SyncedMessages, index: int) -> Sample:
        try:
            sample = sample_of(self._cfg, synced, index, self.topics, self.plan.parent_of)
        except ChannelError as error:
            known = (*self.plan.problems.first.values(), *self.plan.roles.unassigned)
            raise ChannelError("; ".join((f"{self.summary.path}: {error}", *known))) from error
        if "truth_pose" in synced.parts and sample.truth.odom_T_ego is None:
            topic = self.topics["truth_pose"]
            text = f"{topic}: no transform connects the frame of its poses with ego: they are no truth"
            self._problems.report(topic, text)
        return sample

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All channels of the log but the results of an earlier replay."""
        return tuple(channel for channel in self.summary.channels if not is_result(channel))

    def messages(self) -> Iterator[Message]:
        """All messages of the part to replay as they stand in the log, in log-time order; no results."""
        return input_messages(self.summary, self._cfg, self.plan)

    @property
    def frames(self) -> int:
        """Samples so far."""
        return self._synchroniser.frames

    @property
    def dropped(self) -> dict[str, int]:
        """Messages per role that belong to no frame."""
        return dict(self._dropped)

    @property
    def unreadable(self) -> dict[str, int]:
        """Messages per topic that could not be decoded."""
        return dict(self._problems.counts)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know: how parts join, roles guessed or missing, the first problem of each topic."""
        parts = part_notes(self.summary, self.topics[self.plan.order.reference])
        return (*parts, *self.plan.roles.notes, *(self.plan.problems.first | self._problems.first).values())

    def record(self) -> dict[str, str]:
        """What a result has to record of its input, so that it can be replayed from itself."""
        roles = self.plan.roles
        tag_table = tag_table_to_record(self.summary.channels, roles, self._cfg.tag_table)
        return {
            DIGEST_KEY: self.plan.digest,
            "input_messages": str(self.plan.messages),
            FRAMES_KEY: str(self.frames),
            **{f"{TOPIC_KEY}{role}": topic for role, topic in sorted(roles.chosen.items())},
            **({TAG_TABLE_KEY: tag_table} if tag_table else {}),
            **{f"{DROPPED_KEY}{role}": str(number) for role, number in sorted(self.dropped.items())},
        }
