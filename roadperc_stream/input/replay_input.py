"""A log as the input of a replay, opened by every loop over frames."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import ChannelError, NoFrameError, StateError
from roadperc_stream.input.assemble import sample_of
from roadperc_stream.input.decoding import Stamped
from roadperc_stream.input.earlier_replay import networks_digest
from roadperc_stream.input.findings import InputEvidence
from roadperc_stream.input.outcome import FileSpan, InputOutcome, file_notes, joins
from roadperc_stream.input.plan import InputPlan, plan_input
from roadperc_stream.input.replaced import as_configured, with_recorded
from roadperc_stream.input.roles import tag_table_to_record, with_path
from roadperc_stream.input.source import LossTimes, ReadableLog, ReplaySource
from roadperc_stream.input.stream import Problems, decoded_messages
from roadperc_stream.input.sync import Paired, StampPairing, reference_of
from roadperc_stream.input.transforms import LatchedState
from roadperc_stream.input.window import LeadIn
from roadperc_stream.log import DIGEST_ALGORITHM, Channel, LogSummary, LostSpan, Recovery, counted_topics
from roadperc_stream.model import UNWRITTEN, FrameResult, Sample, SettledFrame
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


def input_of(found: ReadableLog, source: ReplaySource, cfg: ReplayConfig, lead: LeadIn | None = None) -> "ReplayInput":
    """As ``open_input``, for a log that was already read.

    ``source`` read ``found``. ``lead`` is read before it: the end of a continued result, or the seconds of a warm-up.

    Raises:
        StateError: the log cannot continue the result; else as ``open_input``.
    """
    for role, topic in source.overrides.items():
        require_role(role, f"topic {topic}")
    asked = replace(source, time_range=found.part(source.time_range))
    cfg = with_recorded(cfg, found.summary.attachments, found.summary.path)
    plan = plan_input(found.summary, cfg, asked, lead)
    if not source.recover:
        start_ns = plan.messages.start_ns if lead is None or lead.continues else lead.start_ns
        found.require_outside(start_ns, plan.messages.end_ns)
    return ReplayInput(found.summary, cfg, plan)


class ReplayInput:
    """The frames of a log, their messages, findings, and counts of dropped and unreadable messages.

    ``cfg`` includes what an earlier replay recorded about its log. ``frames``, ``dropped``, ``unreadable``, ``notes``
    and ``findings`` describe the samples read until now; ``samples`` resets them.
    """

    def __init__(self, summary: LogSummary, cfg: ReplayConfig, plan: InputPlan) -> None:
        self.summary, self.plan, self.cfg = summary, plan, cfg
        self.messages = plan.messages
        logs = (summary,) if not plan.continues or plan.lead is None else (plan.lead.summary, summary)
        recovered = [Recovery.of_records(found.metadata) for found in logs]
        gaps = [() if recovery is None else recovery.gaps for recovery in recovered]
        self._losses = LossTimes(chain(*map(self._ended, gaps[:-1]), gaps[-1]))
        self._begin()

    def _begin(self) -> None:
        plan, lead = self.plan, self.plan.lead
        self._problems = Problems(plan.problems.strict_in)
        self._outcome = InputOutcome(lead.last.segment if lead is not None and lead.last is not None else 0)
        masks = plan.first.counts[self.topics.get("segmentation", "")]
        self._evidence, self._latched = InputEvidence({}, masks), LatchedState()
        self._pairing = StampPairing(self.cfg.sync, plan.order, plan.roles.topics, plan.latched, self._drop)

    def _ended(self, lost: Sequence[LostSpan]) -> tuple[LostSpan, ...]:
        """The gaps of the continued result; one without an end ends before the first new message."""
        next_ns = next((message.log_time_ns for message in self.messages.inside()), None) if lost else None
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
        return record.log_id_of(self.plan.first.digest.hexdigest())

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
        there, most = self.plan.first.frames, self.plan.most_frames
        return there if most is None else min(there, most)

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time of the part to replay, without latched and late messages outside it."""
        window, first_ns, last_ns = self.messages, self.summary.first_ns or 0, self.summary.last_ns or 0
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
        plan, lead = self.plan, self.plan.lead
        last = None if lead is None else lead.last
        before_ns, number = (None, 0) if last is None else (last.log_time_ns, last.number + 1)
        new_frames = 0
        for found, segment in self._frames():
            paired = as_configured(found, plan.given, self.cfg.labels)
            reference = reference_of(paired)
            self._evidence.add(paired.values())
            self._latched = reference.latched
            in_lead = lead is not None and lead.contains(reference.log_time_ns)
            is_written = not in_lead or plan.continues
            sample = replace(self._sample(paired, number if is_written else UNWRITTEN), segment=segment)
            self._outcome.add(paired, segment, is_written=is_written, is_again=in_lead)
            if not is_written:
                yield sample
                continue
            log_time_ns = max(before_ns or 0, reference.log_time_ns)
            lost = self._losses.reason(before_ns, self._until_ns(paired, before_ns, log_time_ns))
            since_ns = self._since_ns(found)
            times = reference.stamp_ns, reference.log_time_ns, log_time_ns
            settled = None if since_ns is None else SettledFrame(number, *times, segment, since_ns)
            yield replace(sample, log_time_ns=log_time_ns, lost=lost, settled=settled)
            before_ns, number, new_frames = log_time_ns, number + 1, new_frames + (not in_lead)
            if new_frames == plan.most_frames:
                break
        if not self.frames and not plan.continues:
            topic = self.topics[plan.order.reference]
            notes = with_path("; ".join(self.notes), self.summary)
            raise NoFrameError(f"{self.summary.path}: no message on {topic} makes a frame; {notes}")

    def _frames(self) -> Iterator[tuple[Paired, int]]:
        """The frames with the numbers of their segments, without those up to the last one of a continued result."""
        plan = self.plan
        messages = self.messages.all(set(self.topics.values()))
        decoded = decoded_messages(messages, plan.roles, self.cfg, self._problems, plan.latched.tree)
        frames = self._pairing.frames_of(decoded)
        if plan.lead is None or (last := plan.lead.last) is None:
            yield from ((frame, reference_of(frame).segment) for frame in frames)
            return
        for frame in frames:
            reference = reference_of(frame)
            if (reference.stamp_ns, reference.log_time_ns) == (last.stamp_ns, last.arrived_ns):
                first = last.segment - reference.segment
                yield from ((later, first + reference_of(later).segment) for later in frames)
                return
        raise StateError(
            f"{plan.lead.summary.path}: frame {last.number} with stamp {last.stamp_ns} ns is not in it: "
            "expected the unchanged result of a replay"
        )

    def _since_ns(self, frame: Paired) -> int | None:
        """The log time from which a later log reads this one again; None if a later message may change the frame.

        Also None if the output has not all messages since then, near the start of a warmed-up replay.
        """
        plan, reference = self.plan, reference_of(frame)
        if (reference.segment, reference.stamp_ns) >= plan.first.settled:
            return None
        since_ns = self._pairing.since_ns(frame)
        return since_ns if plan.lead is None or plan.continues or since_ns >= plan.lead.end_ns else None

    def _until_ns(self, paired: Paired, since_ns: int | None, log_time_ns: int) -> int:
        """The log time up to which messages of a frame may have been lost."""
        if all(role in paired for role in self.topics if ROLES[role].kind not in LATCHED_KINDS):
            return log_time_ns
        interval_ns = 0 if since_ns is None else log_time_ns - since_ns  # assume the same interval to the next frame
        return log_time_ns + self.plan.order.lateness_ns + interval_ns

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What contradicts itself in the samples read until now."""
        return self._evidence.findings(self.cfg, self.topics, self.plan.order.reference, self._latched)

    def _drop(self, item: Stamped) -> None:
        lead = self.plan.lead
        if lead is not None and lead.is_known(item.log_time_ns, item.stamp_ns):
            return
        self._outcome.drop(item)
        if item.role == self.plan.order.reference:
            topic, stamp = self.topics[item.role], f"stamp {item.stamp_ns} ns at log time {item.log_time_ns} ns"
            self._problems.report(f"{topic}: {item.fault}", f"{topic}: message with {stamp}: {item.fault}, left out")

    def _sample(self, paired: Paired, index: int) -> Sample:
        try:
            sample = sample_of(self.cfg, paired, index, self.topics, self.plan.first.parent_of, self.plan.given)
        except ChannelError as error:
            known = (*self.plan.problems.first.values(), *self.plan.roles.unassigned, *self._if_in_other_files)
            text = "; ".join((f"{self.summary.path}: {error.args[0]}", *known))
            raise ChannelError(text, error.option, error.purpose) from error
        if "truth_pose" in paired and sample.truth.odom_T_ego is None:
            topic = self.topics["truth_pose"]
            text = f"{topic}: no transform connects the frame of its poses with ego: not used as truth"
            self._problems.report(topic, text)
        return sample

    @property
    def _if_in_other_files(self) -> tuple[str, ...]:
        """A hint for a log whose calibrations may be in another file."""
        if self.plan.continues or any(ROLES[role].kind == "calibration" for role in self.topics):
            return ()
        return ("if an earlier file of the log has it, pass that file too, or --continue with its result",)

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
        return self.messages.inputs

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
        lead = self.plan.lead
        frames = 0 if lead is None else counted_topics(lead.summary)[self.topics[self.plan.order.reference]]
        if lead is None or not lead.continues or frames < 2:  # without an interval nothing is a gap
            return ()
        before = FileSpan("the continued result", lead.summary.first_ns or 0, lead.end_ns - 1, frames)
        return tuple(joins([before, FileSpan(str(self.summary.path), *self.span_ns, frames=0)]))

    @property
    def chosen_topics(self) -> dict[str, str]:
        """The topics that the user chose, by their keys in the replay record."""
        return {f"{record.TOPIC_KEY}{role}": topic for role, topic in sorted(self.plan.roles.chosen.items())}

    def record(self) -> dict[str, str]:
        """The input facts that a result records, so that it can be replayed again."""
        roles = self.plan.roles
        tag_table = tag_table_to_record(self.summary.channels, roles, self.cfg.tag_table)
        return {
            record.DIGEST_KEY: self.plan.first.digest.hexdigest(),
            record.DIGEST_ALGORITHM_KEY: DIGEST_ALGORITHM,
            "input_messages": str(self.plan.first.counts.total()),
            record.FRAMES_KEY: str(self.frames),
            **({} if self.messages.cut_ns is None else {record.END_KEY: str(self.messages.cut_ns)}),
            **self.chosen_topics,
            **({record.TAG_TABLE_KEY: tag_table} if tag_table else {}),
            **{f"{record.DROPPED_KEY}{role}": str(number) for role, number in sorted(self.dropped.items())},
        }
