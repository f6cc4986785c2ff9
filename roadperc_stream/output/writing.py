"""Writes the log with results and its two tables, frame by frame."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from roadperc_stream import __version__
from roadperc_stream.geometry import Float
from roadperc_stream.input.replay_input import ReplayInput
from roadperc_stream.log import Attachment, Channel, LogWriter, Message, MessageCopy, Metadata, Piece
from roadperc_stream.model import FrameResult, Odometry, Reason, Sample
from roadperc_stream.model.finding import Evidence, Finding, encoded_findings
from roadperc_stream.output.drawing.on_request import picture_messages
from roadperc_stream.output.findings import Contradictions, undecodable
from roadperc_stream.output.hindsight import RECENT_NS, Hindsight, Recent
from roadperc_stream.output.reason_counts import ReasonCounts, merged, of_frame, throughout
from roadperc_stream.output.results import result_channel, result_messages
from roadperc_stream.output.tables import TableWriter, config_text, table_facts
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.schemas import record
from roadperc_stream.schemas.columns import EXTRA_COLUMNS, FrameMetrics, ObjectMetrics
from roadperc_stream.schemas.columns.hindsight import TRACK_HINDSIGHT
from roadperc_stream.schemas.columns.places import OBJECT_PLACE, TRUE_OBJECTS, FramePlaces
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT, METADATA_RECORD, OWN_ATTACHMENTS
from roadperc_stream.schemas.topics import result_schemas
from roadperc_stream.system.progress import Progress, StageTimer, no_progress
from roadperc_stream.system.text import number
from roadperc_stream.system.time import ns_to_seconds

TRAJECTORY_POSES: Final = 200
"""Length of the trajectory that each frame shows: ten seconds at 20 Hz."""


@dataclass(frozen=True)
class Callbacks:
    """Callbacks during a replay; all optional.

    Args:
        on_progress: takes the frames done and the frames expected.
        on_start: takes the output and its first and last log time in nanoseconds, before the first message.
        on_frame: takes a frame's row and its time columns in milliseconds, before the next frame is written.
    """

    on_progress: Progress = no_progress
    on_start: Callable[[LogWriter, tuple[int, int]], None] | None = None
    on_frame: Callable[[FrameMetrics, Mapping[str, float]], None] | None = None


NO_CALLBACKS: Final = Callbacks()


@dataclass(frozen=True)
class Shown:
    """Facts of earlier frames that the messages of a frame show, and that the tables need at the end.

    ``trajectory`` are the latest known poses odom_T_ego, ``reasons`` those of the previous frame, ``first_ns`` the
    stamp of the first frame, ``recent`` the rows of the last second.
    """

    trajectory: tuple[Float, ...] = ()
    reasons: tuple[Reason, ...] = ()
    first_ns: int | None = None
    recent: tuple[Recent, ...] = ()

    def __post_init__(self) -> None:
        if any(pose.shape != (4, 4) for pose in self.trajectory):
            raise ValueError("trajectory: expected poses of shape (4, 4)")

    def after(self, result: FrameResult, row: FrameMetrics, objects: tuple[ObjectMetrics, ...]) -> "Shown":
        """The facts after one more frame, with its pose if known."""
        poses = self.trajectory
        if isinstance(result.odometry, Odometry) and result.odometry.has_pose:
            poses = (*poses, result.odometry.odom_T_ego)[-TRAJECTORY_POSES:]
        recent = tuple(item for item in self.recent if abs(row.stamp_ns - item[0].stamp_ns) <= RECENT_NS)
        first_ns = result.stamp_ns if self.first_ns is None else self.first_ns
        return Shown(poses, row.reasons, first_ns, (*recent, (row, objects)))


@dataclass(frozen=True)
class FrameOutput:
    """The output of one frame: topic and bytes of its messages, its row with time columns, rows of its objects.

    ``places`` are more columns of these rows. ``evidence`` is for the findings of the whole replay, ``claims`` for its
    errors by hindsight.
    """

    row: FrameMetrics
    objects: tuple[ObjectMetrics, ...]
    places: FramePlaces
    evidence: Evidence = field(default_factory=Evidence)
    claims: tuple[float, ...] = ()
    messages: tuple[tuple[str, bytes], ...] = ()
    times_ms: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ReplaySummary:
    """A summary of a replay, for the user.

    ``dropped`` counts the messages of each role that belong to no frame, ``problems`` those of each topic that could
    not be decoded.
    """

    log_id: str
    frames: int
    messages_out: int
    seconds: float = 0.0
    notes: tuple[str, ...] = ()
    dropped: Mapping[str, int] = field(default_factory=dict)
    problems: Mapping[str, int] = field(default_factory=dict)
    throughout: tuple[str, ...] = ()
    """Texts of the reasons that held in all frames."""
    warnings: tuple[str, ...] = ()
    """For a damaged log: the damaged places, and the numbers of saved and lost messages."""
    frames_before: int = 0
    """Frames that an interrupted replay computed."""
    resumed_s: float | None = None
    """Log seconds that these frames cover; None if no interrupted replay was resumed."""
    is_new: bool = True
    """Whether the replay wrote an output; False if the output was already complete."""
    first_ns: int = 0
    """Log time of the input's first message in nanoseconds."""
    findings: tuple[Finding, ...] = ()
    """Contradictions between inputs, or between inputs and results."""

    @property
    def frames_per_s(self) -> float:
        """Frames computed per second."""
        return (self.frames - self.frames_before) / self.seconds

    @property
    def remarks(self) -> tuple[str, ...]:
        """Warnings and notes, one line each."""
        unreadable = (
            f"warning: {number(count, 'message')} on {topic} could not be read, skipped"
            for topic, count in self.problems.items()
        )
        return (
            *(f"warning: {warning}" for warning in self.warnings),
            *(f"note: {note}" for note in (*self.findings, *self.notes, *self.throughout)),
            *unreadable,
        )


class Outputs:
    """The files that a replay writes: the log, the table of frames and the table of objects.

    ``shown`` are the facts of earlier frames for the messages of the next frame.
    """

    def __init__(
        self,
        target: ReplayTarget,
        log_in: ReplayInput,
        facts: Mapping[str, str],
        earlier: tuple[Recent, ...] = (),
    ) -> None:
        """Name the files; ``earlier`` are the last rows of the replay that this one continues."""
        self._target, self._cfg, self._input = target, log_in.cfg, log_in
        facts = table_facts(log_in.summary.path, target.path, log_in.cfg, facts, log_in.networks)
        self._frames = TableWriter(target.metrics, FrameMetrics, facts, (*EXTRA_COLUMNS, TRUE_OBJECTS))
        self._objects = TableWriter(target.objects, ObjectMetrics, facts, (*TRACK_HINDSIGHT, *OBJECT_PLACE))
        self._log = LogWriter(target.path, log_in.summary.profile)
        self.files = (self._log, self._objects, self._frames)
        """Renamed in reverse order: when the log has its name, the tables have theirs."""
        self._reasons: ReasonCounts = {}
        self._contradictions = Contradictions()
        self._hindsight = Hindsight(earlier)
        self._findings: tuple[Finding, ...] = ()
        self._frames_before = 0
        self._resumed_ns: int | None = None

    def begin(self, callbacks: Callbacks, shown: Shown) -> None:
        """Register all channels; ``shown`` is that of earlier frames."""
        log_in, self.shown, self._on_frame = self._input, shown, callbacks.on_frame
        copied: tuple[Iterable[Channel], Iterator[Piece]] = (
            ((), iter(())) if self._target.results_only else (log_in.channels, log_in.messages.pieces())
        )
        self._copy = MessageCopy(self._log, *copied)
        topics = result_schemas(self._target.on_request)
        self._channels = {topic: result_channel(topic, name) for topic, name in topics.items()}
        for channel in self._channels.values():
            self._log.register(channel)
        if callbacks.on_start is not None:
            callbacks.on_start(self._log, log_in.span_ns)

    def write(self, sample: Sample, result: FrameResult, output: FrameOutput, timer: StageTimer) -> FrameOutput:
        """Copy the input's messages up to a frame, then write the frame's rows, and messages that it makes of them."""
        with timer("copy"):
            self._copy.through(sample.log_time_ns)
        with timer("encode"):
            messages = self._messages(sample, result, output)
        with timer("write"):
            self._write_messages(sample, messages)
        timer.end()
        output = replace(output, messages=messages, times_ms=timer.columns())
        self._append(output)
        return output

    def write_again(self, sample: Sample, output: FrameOutput) -> None:
        """Write the messages and the rows of a frame that an interrupted replay computed."""
        self._copy.through(sample.log_time_ns)
        self._write_messages(sample, output.messages)
        self._append(output)
        self._frames_before, self._resumed_ns = self._frames_before + 1, sample.log_time_ns

    def _messages(self, sample: Sample, result: FrameResult, output: FrameOutput) -> tuple[tuple[str, bytes], ...]:
        """Topics and bytes of a frame's results and pictures."""
        row, known_reasons = output.row, self.shown.reasons
        self.shown = self.shown.after(result, row, output.objects)
        return (
            *result_messages(sample, result, row, known_reasons, self.shown.trajectory),
            *picture_messages(self._target.on_request, sample, result, row, self.shown.first_ns or 0),
        )

    def _write_messages(self, sample: Sample, messages: Iterable[tuple[str, bytes]]) -> None:
        time_ns = sample.log_time_ns
        for topic, data in messages:
            self._log.write(Message(self._channels[topic], time_ns, time_ns, sample.index, data))

    def _append(self, output: FrameOutput) -> None:
        if self._on_frame is not None:
            self._on_frame(output.row, output.times_ms)
        self._contradictions.add(output.row, output.evidence)
        self._hindsight.add(output.claims)
        self._reasons = merged((self._reasons, of_frame(output.row.reasons)))
        true = output.places.true_objects
        listed = {TRUE_OBJECTS: None if true is None else [vars(item) for item in true]}
        self._frames.append(output.row, **output.times_ms, **listed)
        for item, place in zip(output.objects, output.places.objects, strict=True):
            self._objects.append(item, **vars(place))

    def end(self, facts: Mapping[str, str], states: Iterable[Attachment]) -> None:
        """Copy the rest of the input, and record how the output was made.

        ``facts`` say how the replay began; ``states`` is the state at its end, if a later log can continue it.
        """
        self._copy.rest()
        for attachment in self._input.summary.attachments:
            if attachment.name not in OWN_ATTACHMENTS:
                self._log.attach(attachment)
        text = config_text(self._cfg, self._input.networks)
        toml = Attachment(CONFIG_ATTACHMENT, "application/toml", text.encode())
        for attachment in (toml, *states):
            self._log.attach(attachment)
        for metadata in self._input.summary.metadata:
            if metadata.name != METADATA_RECORD:
                self._log.describe(metadata)
        topics, unreadable = self._input.topics, self._input.unreadable
        by_role = {role: unreadable[topic] for role, topic in topics.items() if topic in unreadable}
        unusable = undecodable(self._reasons, by_role, self._input.plan.order.reference, self._input.frames)
        self._findings = (*self._input.findings, *self._contradictions.findings(), *unusable)
        stored = {record.FINDINGS_KEY: encoded_findings(self._findings)}
        mounting_m = self._contradictions.mounting_m
        known = {} if mounting_m is None else {record.MOUNTING_KEY: repr(mounting_m)}
        self._hindsight.fill(self._frames, self._objects)
        self._frames.add_facts({**stored, **known})
        made = {record.VERSION_KEY: __version__, record.SEED_KEY: str(self._cfg.seed)}
        values = {**made, **facts, **self._input.record(), **(stored if self._findings else {})}
        self._log.describe(Metadata(METADATA_RECORD, tuple(values.items())))

    def summary(self, warnings: tuple[str, ...], notes: tuple[str, ...]) -> ReplaySummary:
        """The summary of the replay, with warnings and more notes."""
        log_in, resumed_ns = self._input, self._resumed_ns
        asked = " and ".join(f"--{request}" for request in self._target.on_request)
        bare = (f"{asked}: no pictures, the log has no camera image",) if asked and "image" not in log_in.topics else ()
        return ReplaySummary(
            log_in.log_id,
            log_in.frames,
            self._log.messages,
            notes=(*notes, *log_in.notes, *bare),
            warnings=warnings,
            dropped=log_in.dropped,
            problems=log_in.unreadable,
            throughout=throughout(self._reasons, log_in.frames, log_in.topics),
            frames_before=self._frames_before,
            resumed_s=None if resumed_ns is None else ns_to_seconds(resumed_ns - (log_in.summary.first_ns or 0)),
            first_ns=log_in.summary.first_ns or 0,
            findings=self._findings,
        )
