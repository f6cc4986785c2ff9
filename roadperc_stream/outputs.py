"""All that a replay writes: the log with the results, and its two tables."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import Sample
from roadperc_stream.core.files import partial_of, sync_file
from roadperc_stream.core.reasons import throughout
from roadperc_stream.core.text import number
from roadperc_stream.core.time import ns_to_seconds
from roadperc_stream.errors import StateError
from roadperc_stream.input import ReplayInput
from roadperc_stream.log import Channel, LogWriter, MessageCopy, Piece
from roadperc_stream.metrics import frame_metrics, object_metrics
from roadperc_stream.output.drawing.on_request import PictureMaker
from roadperc_stream.output.tables import TableWriter, table_facts
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import ComputedFrame, FrameOutput, ResultWriter, Timed, write_origin
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics, ObjectMetrics
from roadperc_stream.schemas.record import BEGIN_ATTACHMENT, STATE_ATTACHMENT
from roadperc_stream.state.attached import attachment_of
from roadperc_stream.state.checkpoint_folder import Counted
from roadperc_stream.state.checks import require_sense
from roadperc_stream.state.opening import OpenedLog
from roadperc_stream.state.replay_state import ReplayMemory, ReplayState, settings_of


@dataclass(frozen=True)
class ReplaySummary:
    """What a replay did, for the person who started it.

    ``dropped`` are the messages of each role that belong to no frame, ``problems`` those of each topic that could not
    be decoded.
    """

    log_id: str
    frames: int
    messages_out: int
    seconds: float
    notes: tuple[str, ...]
    dropped: dict[str, int]
    problems: dict[str, int]
    throughout: tuple[str, ...]
    """The reasons that held in all frames, in words."""
    warnings: tuple[str, ...] = ()
    """Of a damaged log: where, what was saved and what was lost."""
    frames_before: int = 0
    """Those that an earlier run had computed."""
    resumed_s: float | None = None
    """How far into the log those went, in seconds; None where it was no earlier run that this one went on from."""
    is_new: bool = True
    """Whether anything was written: nothing where the output was complete already."""
    first_ns: int = 0
    """Log time of the input's first message, nanoseconds since 1970 where its clock counts so."""

    @property
    def frames_per_s(self) -> float:
        """Frames computed in a second."""
        return (self.frames - self.frames_before) / self.seconds

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a person should know of it, a line each."""
        unreadable = (
            f"warning: {number(count, 'message')} on {topic} could not be read; frames go without"
            for topic, count in self.problems.items()
        )
        return (
            *(f"warning: {warning}" for warning in self.warnings),
            *(f"note: {note}" for note in (*self.notes, *self.throughout)),
            *unreadable,
        )


class Outputs:
    """What a replay writes: the log and its two tables."""

    def __init__(self, target: ReplayTarget, cfg: ReplayConfig, opened: OpenedLog) -> None:
        self._target, self._cfg, self._opened, self._input = target, cfg, opened, opened.input
        facts = table_facts(self._input.summary.path, target.path, cfg, opened.table_facts())
        self._frames = TableWriter(target.metrics, FrameMetrics, facts, TIME_COLUMNS)
        self._objects = TableWriter(target.objects, ObjectMetrics, facts)
        self._log = LogWriter(target.path, self._input.summary.profile)
        self._pictures = PictureMaker(target.on_request)
        self.files = (self._log, self._objects, self._frames)
        """The last one gets its name first: where the log stands under its own, its tables do."""
        self._notes: tuple[str, ...] = ()
        self._frames_before = 0
        self._resumed_ns: int | None = None

    def begin(self, opened: Callable[[LogWriter, tuple[int, int]], Timed], counted: Counted) -> None:
        """Register all channels, and tell who wants to know; ``counted`` is of the frames that were computed before."""
        copied = _to_copy(self._input, self._target.results_only)
        self._copy = MessageCopy(self._log, *copied, self._input.summary.schema_ids)
        self._results = ResultWriter(self._log, self._pictures)
        self._results.reasons = dict(counted.reasons)
        self._pictures.without_image, self._pictures.misfits = counted.without_image, counted.misfits
        self._timed = opened(self._log, self._input.span_ns)

    def write(self, frame: ComputedFrame) -> FrameOutput:
        """Measure a frame, and write its messages and its rows."""
        sample, timer, log_id = frame.sample, frame.timer, self._input.log_id
        with timer("metrics"):
            row = frame_metrics(self._cfg, log_id, sample, frame.result, frame.earlier)
            objects = tuple(object_metrics(log_id, sample, frame.result))
        with timer("copy"):
            self._copy.through(sample.log_time_ns)
        with timer("encode"):
            messages = self._results.messages(frame, row)
        with timer("write"):
            self._results.write(sample, messages)
        timer.end()
        output = FrameOutput(messages, row, timer.columns(), objects)
        self._append(output)
        return output

    def write_again(self, sample: Sample, output: FrameOutput) -> None:
        """Write the messages and the rows of a frame that was computed before."""
        self._copy.through(sample.log_time_ns)
        self._results.write(sample, output.messages)
        self._append(output)
        self._frames_before, self._resumed_ns = self._frames_before + 1, sample.log_time_ns

    def _append(self, output: FrameOutput) -> None:
        self._timed(output.row, output.times_ms)
        self._frames.append(output.row, **output.times_ms)
        for item in output.objects:
            self._objects.append(item)

    @property
    def counted(self) -> Counted:
        """What has been counted so far."""
        return Counted(tuple(self._results.reasons.items()), self._pictures.without_image, self._pictures.misfits)

    def end(self, memory: ReplayMemory) -> None:
        """Write what comes behind the last frame; ``memory`` is that of the last one that was complete."""
        self._copy.rest()
        waiting = self._input.end_state(with_messages=self._target.results_only)
        lost = self._input.lost_to_come
        state = ReplayState(self._input.log_id, settings_of(self._cfg), waiting, memory, lost)
        begin = self._opened.state_for(self._cfg)
        states = () if begin is None else (attachment_of(BEGIN_ATTACHMENT, begin),)
        record = {**self._opened.facts(), **self._input.record()}
        try:
            states = (*states, attachment_of(STATE_ATTACHMENT, require_sense(state, self._cfg)))
        except StateError as error:  # the results are none the worse for it
            self._notes = (f"{STATE_ATTACHMENT}: left out, this part cannot be continued: {error}",)
        write_origin(self._log, self._input.summary, self._cfg, record, states)

    def make_durable(self) -> None:
        """Write all of them to the disk, before they get their names."""
        for file in self.files:
            file.complete()
        for path in self._target.files:
            sync_file(partial_of(path))

    def summary(self, notes: tuple[str, ...]) -> ReplaySummary:
        """What was written, with some more notes."""
        log_in, resumed_ns = self._input, self._resumed_ns
        return ReplaySummary(
            log_in.log_id,
            log_in.frames,
            self._log.messages,
            0.0,
            (*self._opened.notes, *log_in.notes, *self._pictures.notes(), *self._notes, *notes),
            log_in.dropped,
            log_in.unreadable,
            throughout(self._results.reasons, log_in.frames, log_in.topics),
            self._opened.warnings,
            self._frames_before,
            None if resumed_ns is None else ns_to_seconds(resumed_ns - (log_in.summary.first_ns or 0)),
            first_ns=log_in.summary.first_ns or 0,
        )


def _to_copy(log_in: ReplayInput, results_only: bool) -> tuple[Iterable[Channel], Iterator[Piece]]:
    """Channels and messages of the input that the output has as well."""
    return ((), iter(())) if results_only else (log_in.channels, log_in.pieces())
