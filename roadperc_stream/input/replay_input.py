"""A log as the input of a replay, opened by every loop over frames."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice

from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import ChannelError, NoFrameError
from roadperc_stream.input.assemble import sample_of
from roadperc_stream.input.earlier_replay import is_result, networks_digest
from roadperc_stream.input.findings import InputEvidence
from roadperc_stream.input.outcome import FileSpan, InputOutcome, continuation_notes, file_notes
from roadperc_stream.input.plan import InputPlan, plan_input
from roadperc_stream.input.replaced import as_configured, with_recorded
from roadperc_stream.input.roles import tag_table_to_record, with_paths
from roadperc_stream.input.source import LossTimes, ReadableLog, ReplaySource
from roadperc_stream.input.state import InputState
from roadperc_stream.input.stream import Problems, Stamped, decoded_messages
from roadperc_stream.input.sync import LatchedState, StampPairing, SyncedMessages
from roadperc_stream.input.window import WindowMessages
from roadperc_stream.log import DIGEST_ALGORITHM, Channel, LogSummary, LostSpan, Message, Piece, Recovery
from roadperc_stream.model import UNWRITTEN, FrameResult, Sample
from roadperc_stream.model.finding import Finding
from roadperc_stream.model.reason import UNUSABLE
from roadperc_stream.schemas import record
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES, require_role


def open_input(source: ReplaySource, cfg: ReplayConfig) -> "ReplayInput":
    """Check a log, assign its channels to roles, and find the part to replay.

    Raises:
        ChannelError: a role does not exist, or the channels do not fit the roles.
        LogError: the log cannot be read, is damaged in the requested part, or that part has no frame.
        TargetError: the log needs temporary files, and there is no space for them.
    """
    return input_of(source.read(cfg.limits), source, cfg)


def input_of(
    found: ReadableLog,
    source: ReplaySource,
    cfg: ReplayConfig,
    begin: InputState | None = None,
    lost: Sequence[LostSpan] = (),
) -> "ReplayInput":
    """As ``open_input``, for a log that was already read.

    ``source`` read ``found``. ``begin`` is the end state of a continued result, ``lost`` the gaps of that result; a gap
    without an end ends where this log begins.

    Raises:
        StateError: the log cannot continue from ``begin``; else as ``open_input``.
    """
    for role, topic in source.overrides.items():
        require_role(role, f"topic {topic}")
    asked = replace(source, time_range=found.part(source.time_range))
    cfg = with_recorded(cfg, found.summary.attachments, found.summary.path)
    plan = plan_input(found.summary, cfg, asked, begin)
    if not source.recover:
        found.require_outside(plan.window.start_ns, plan.window.end_ns)
    return ReplayInput(found.summary, cfg, plan, lost)


class ReplayInput:
    """The frames of a log, their messages, findings, and counts of dropped and unreadable messages.

    ``cfg`` includes what an earlier replay recorded about its log. ``frames``, ``dropped``, ``unreadable``, ``notes``
    and ``findings`` describe the samples read until now; ``samples`` resets them.
    """

    def __init__(self, summary: LogSummary, cfg: ReplayConfig, plan: InputPlan, lost: Sequence[LostSpan] = ()) -> None:
        self.summary, self.plan, self.cfg = summary, plan, cfg
        recovery = Recovery.of_records(summary.metadata)
        self._gaps = (*self._ended(lost), *(() if recovery is None else recovery.gaps))
        self._losses = LossTimes(self._gaps)
        self._begin()

    def _begin(self) -> None:
        plan = self.plan
        self._problems = Problems(plan.problems.strict_in)
        self._outcome = InputOutcome(plan.begun.segment)
        masks = plan.first_pass.counts[self.topics.get("segmentation", "")]
        self._evidence, self._latched = InputEvidence({}, masks), LatchedState()
        self._pairing = StampPairing(self.cfg.sync, plan.order, plan.roles.topics, plan.begun, self._drop)

    def _ended(self, lost: Sequence[LostSpan]) -> tuple[LostSpan, ...]:
        """The gaps of the continued result; one without an end ends before the first new message."""
        inside = (message.log_time_ns for message in self._messages.inside()) if lost else ()
        next_ns = next((time_ns for time_ns in inside if time_ns >= self.plan.start.from_ns), None)
        return tuple(
            replace(gap, last_ns=max(next_ns - 1, gap.first_ns or 0)) if gap.last_ns is None and next_ns else gap
            for gap in lost
        )

    @property
    def frames(self) -> int:
        """Number of written samples until now."""
        return self._outcome.frames

    @property
    def log_id(self) -> str:
        """The name of the log in every table."""
        return record.log_id_of(self.plan.first_pass.digest)

    @property
    def networks(self) -> str:
        """Digest of the networks that computed channels of the log; empty without them."""
        return networks_digest(self.summary.metadata)

    @property
    def topics(self) -> Mapping[str, str]:
        """Topic of each role that the log has."""
        return self.plan.roles.topics

    @property
    def expected_frames(self) -> int:
        """Number of messages of the reference role that are not left out; an unreadable one makes no frame."""
        plan, found = self.plan, self.plan.first_pass
        there = found.counts[self.topics[plan.order.reference]] - found.left_out + plan.start.frames_waiting
        return there if plan.most_frames is None else min(there, plan.most_frames)

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time of the part to replay, without latched and late messages outside it."""
        window, first_ns, last_ns = self.plan.window, self.summary.first_ns or 0, self.summary.last_ns or 0
        start_ns = first_ns if window.start_ns is None else max(window.start_ns, first_ns)
        end_ns = last_ns if window.end_ns is None else min(window.end_ns, last_ns)
        return start_ns, max(start_ns, end_ns)

    def samples(self) -> Iterator[Sample]:
        """The frames in order, a few messages in memory at a time.

        Raises:
            ChannelError: a camera without calibration; the message names it.
            NoFrameError: no message makes a frame.
        """
        self._begin()
        plan, topics, numbers = self.plan, self.topics, self.plan.start.numbers
        messages, limits = self._messages.all(set(topics.values())), self.cfg.limits
        decoded = decoded_messages(messages, plan.roles, self.cfg.tag_table, self._problems, limits)
        items = plan.start.to_come(decoded, topics, self._problems, limits)
        before_ns = numbers.log_time_ns if numbers.next else None
        for found in islice(self._pairing.frames_of(items), plan.most_frames):
            synced = as_configured(found, plan.rig, self.cfg.labels)
            self._evidence.add(synced.messages.values())
            self._latched = synced.latched
            before, numbers = numbers, numbers.after(synced.reference)
            is_written = before.is_written(synced.reference)
            sample = self._sample(synced, before.next if is_written else UNWRITTEN)
            self._outcome.add(synced, is_written=is_written)
            if is_written:
                lost = self._losses.reason(before_ns, self._until_ns(synced, before_ns, numbers.log_time_ns))
                yield replace(sample, log_time_ns=numbers.log_time_ns, lost=lost)
                before_ns = numbers.log_time_ns
            else:
                yield sample
        if not self.frames and not self.plan.is_continuation:
            topic = self.topics[plan.order.reference]
            notes = with_paths("; ".join(self.notes), self.summary)
            raise NoFrameError(f"{self.summary.path}: no message on {topic} makes a frame; {notes}")

    def _until_ns(self, synced: SyncedMessages, since_ns: int | None, log_time_ns: int) -> int:
        """The log time up to which messages of a frame may have been lost."""
        if all(role in synced.messages for role in self.topics if ROLES[role].kind not in LATCHED_KINDS):
            return log_time_ns
        interval_ns = 0 if since_ns is None else log_time_ns - since_ns  # assume the same interval to the next frame
        return log_time_ns + self.plan.order.lateness_ns + interval_ns

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What contradicts itself in the samples read until now."""
        return self._evidence.findings(self.cfg, self.topics, self.plan.order.reference, self._latched)

    def _drop(self, item: Stamped) -> None:
        self._outcome.drop(item)
        if item.role == self.plan.order.reference:
            topic, stamp = self.topics[item.role], f"stamp {item.stamp_ns} ns at log time {item.log_time_ns} ns"
            self._problems.report(f"{topic}: {item.fault}", f"{topic}: message with {stamp}: {item.fault}, left out")

    def _sample(self, synced: SyncedMessages, index: int) -> Sample:
        try:
            sample = sample_of(self.cfg, synced, index, self.topics, self.plan.first_pass.parent_of, self.plan.rig)
        except ChannelError as error:
            known = (*self.plan.problems.first.values(), *self.plan.roles.unassigned, *self._if_in_other_files)
            raise ChannelError("; ".join((f"{self.summary.path}: {error}", *known))) from error
        if "truth_pose" in synced.messages and sample.truth.odom_T_ego is None:
            topic = self.topics["truth_pose"]
            text = f"{topic}: no transform connects the frame of its poses with ego: not used as truth"
            self._problems.report(topic, text)
        return sample

    @property
    def _if_in_other_files(self) -> tuple[str, ...]:
        """A hint for a log whose calibrations may be in another file."""
        if self.plan.is_continuation or any(ROLES[role].kind == "calibration" for role in self.topics):
            return ()
        return ("pass the earlier files of the log too, or pass --continue with the result of the previous one",)

    def require_usable(self, result: FrameResult) -> None:
        """Check that all messages of a frame are usable, in a strict replay.

        Raises:
            LogError: one is unusable.
        """
        for reason in result.reasons() if self._problems.strict_in is not None else ():
            if reason.code in UNUSABLE:
                self._problems.require_lenient(f"message with stamp {result.stamp_ns} ns: {reason}")

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All channels of the log except the results of an earlier replay."""
        return tuple(channel for channel in self.summary.channels if not is_result(channel))

    def messages(self) -> Iterator[Message]:
        """All messages of the part to replay, unchanged and in log-time order; no results."""
        return self._messages.all()

    def pieces(self) -> Iterator[Piece]:
        """As ``messages``, but as whole chunks of the log where possible."""
        return self._messages.pieces()

    def end_state(self, *, with_messages: bool) -> InputState:
        """The state that later frames need.

        Args:
            with_messages: whether it contains its messages; else it refers to those in the output by log time and
                number.
        """
        end = self.plan.first_pass.end
        first_ns = end.first_pending_ns
        if first_ns is None or not with_messages:
            return end
        return end.carrying(self._messages.inside(set(self.topics.values()), first_ns))

    @property
    def lost_to_come(self) -> tuple[LostSpan, ...]:
        """The gaps that may affect the frames after the last complete one, without gaps after the cut."""
        numbers = self.plan.first_pass.end.numbers
        since_ns = numbers.log_time_ns if numbers.next else None
        cut_ns = self.plan.window.cut_ns
        own = (gap for gap in self._gaps if cut_ns is None or gap.first_ns is None or gap.first_ns < cut_ns)
        spans = dict.fromkeys(
            (gap.first_ns, gap.last_ns)
            for gap in own
            if since_ns is None or gap.last_ns is None or gap.last_ns > since_ns
        )
        return tuple(LostSpan(first_ns, last_ns) for first_ns, last_ns in spans)

    @property
    def _messages(self) -> WindowMessages:
        plan = self.plan
        return WindowMessages(self.summary, self.cfg, plan.roles, plan.window, plan.latched_messages)

    @property
    def dropped(self) -> dict[str, int]:
        """Number of messages of each role that belong to no frame."""
        return dict(self._outcome.dropped)

    @property
    def unreadable(self) -> dict[str, int]:
        """Number of messages of each topic that could not be decoded."""
        return dict(self._problems.counts)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user: gaps between files, guessed or missing roles, the first problem of each topic.

        For the samples read until now also segments, messages that belong to no frame, and roles in no frame.
        """
        plan, topics = self.plan, self.topics
        files = file_notes(self.summary, topics[plan.order.reference])
        problems = (plan.problems.first | self._problems.first).values()
        outcome = self._outcome.notes(topics, self.cfg.sync, self._pairing.nearest_ns)
        return (*files, *self._before, *plan.roles.notes, *problems, *outcome)

    @property
    def _before(self) -> tuple[str, ...]:
        """A note if there is a gap between this log and the result that it continues."""
        plan = self.plan
        if not plan.is_continuation or plan.start.numbers.written_from_ns is not None:
            return ()
        frames = plan.first_pass.counts[self.topics[plan.order.reference]]
        waiting = [item.log_time_ns for item in plan.start.pairing.items if item.role == plan.order.reference]
        return continuation_notes(FileSpan(str(self.summary.path), *self.span_ns, frames), waiting, plan.start.from_ns)

    @property
    def chosen_topics(self) -> dict[str, str]:
        """The topics that the user chose, by their keys in the replay record."""
        return {f"{record.TOPIC_KEY}{role}": topic for role, topic in sorted(self.plan.roles.chosen.items())}

    def record(self) -> dict[str, str]:
        """The input facts that a result records, so that it can be replayed again."""
        roles = self.plan.roles
        tag_table = tag_table_to_record(self.summary.channels, roles, self.cfg.tag_table)
        return {
            record.DIGEST_KEY: self.plan.first_pass.digest,
            record.DIGEST_ALGORITHM_KEY: DIGEST_ALGORITHM,
            "input_messages": str(self.plan.first_pass.counts.total()),
            record.FRAMES_KEY: str(self.frames),
            **({} if self.plan.window.cut_ns is None else {record.END_KEY: str(self.plan.window.cut_ns)}),
            **self.chosen_topics,
            **({record.TAG_TABLE_KEY: tag_table} if tag_table else {}),
            **{f"{record.DROPPED_KEY}{role}": str(number) for role, number in sorted(self.dropped.items())},
        }
