"""The one loop: a log in, the log with results and the metrics tables out."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Final

from roadperc_stream import log
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import Sample
from roadperc_stream.core.files import all_or_none, partial_of, sync_file, sync_folder
from roadperc_stream.core.progress import Progress, no_progress
from roadperc_stream.core.reasons import throughout
from roadperc_stream.core.stage_timer import StageTimer
from roadperc_stream.core.threads import one_thread
from roadperc_stream.core.time import ns_to_seconds
from roadperc_stream.errors import LogError, StateError, TargetError
from roadperc_stream.input import ReplayInput, ReplaySource
from roadperc_stream.input.damage import require_sound
from roadperc_stream.input.earlier_replay import is_result_log, replay_record
from roadperc_stream.log import Channel, LogSummary, LogWriter, Message, MessageCopy
from roadperc_stream.metrics import object_metrics
from roadperc_stream.output.drawing.on_request import PictureMaker
from roadperc_stream.output.tables import TableWriter, table_facts
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import FrameOutput, ResultWriter, Timed, unwatched, write_origin
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics, ObjectMetrics
from roadperc_stream.schemas.record import BEGIN_ATTACHMENT, FRAMES_KEY, STATE_ATTACHMENT
from roadperc_stream.state.attached import attachment_of
from roadperc_stream.state.checkpoint import NO_CHECKPOINTS, CheckpointOptions, Checkpoints
from roadperc_stream.state.checkpoint_folder import CheckpointFolder, Counted
from roadperc_stream.state.checks import require_sense
from roadperc_stream.state.identity import finished, run_of
from roadperc_stream.state.opening import BY_ITSELF, Beginning, OpenedLog, open_replay
from roadperc_stream.state.replay_state import ReplayMemory, ReplayState, settings_of
from roadperc_stream.state.running import run_frame


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

    @property
    def frames_per_s(self) -> float:
        """Frames computed in a second."""
        return (self.frames - self.frames_before) / self.seconds


@dataclass(frozen=True)
class Watcher:
    """Who follows a replay while it runs; nobody unless said.

    Args:
        progress: called with frames done and frames expected.
        opened: called once before the first message with the output and its first and last log time in nanoseconds;
            gives who takes each frame's times, which are not in the output.
    """

    progress: Progress = no_progress
    opened: Callable[[LogWriter, tuple[int, int]], Timed] = unwatched


NOBODY: Final = Watcher()


def replay(
    source: ReplaySource,
    target: ReplayTarget,
    cfg: ReplayConfig,
    *,
    beginning: Beginning = BY_ITSELF,
    checkpoints: CheckpointOptions = NO_CHECKPOINTS,
    watcher: Watcher = NOBODY,
) -> ReplaySummary:
    """Replay a log through the chain.

    Args:
        source: the log to read, and what of it.
        target: the log to write, and what into it.
        cfg: the chain's configuration.
        beginning: what the chain has seen before the first frame.
        checkpoints: how often what is complete is made durable, and whether to go on from there.
        watcher: who follows it.

    Raises:
        RoadpercError: the input cannot be read or replayed, or the output cannot be written; nothing is left behind but
            the checkpoints that were asked for.
    """
    started = perf_counter()
    with CheckpointFolder(target.path, cfg.limits) as folder:
        summary = _replay(source, target, cfg, folder, beginning, checkpoints, watcher)
    return replace(summary, seconds=perf_counter() - started)


def _replay(
    source: ReplaySource,
    target: ReplayTarget,
    cfg: ReplayConfig,
    folder: CheckpointFolder,
    beginning: Beginning,
    checkpoints: CheckpointOptions,
    watcher: Watcher,
) -> ReplaySummary:
    """As ``replay``, the folder of the checkpoints held; without the time it took."""
    found = folder.read() if checkpoints.resume else None
    _require_writable(source, target, beginning, resume=checkpoints.resume)
    target.remove_dead_partials()
    opened = open_replay(source, cfg, beginning)
    if checkpoints.resume and found is None and (done := finished(target, cfg, opened)) is not None:
        folder.remove()
        return _summary_of_finished(target, opened, done)
    kept = Checkpoints(folder, checkpoints.every_s, run_of(cfg, opened, target), found, force=target.force)
    was_killed = checkpoints.resume and folder.exists and not target.is_complete
    may_replace = target.force or found is not None or was_killed
    target.require_free(source.files, force=may_replace)
    outputs = _Outputs(target, cfg, opened)
    with one_thread(), kept, all_or_none(*outputs.files):
        outputs.begin(watcher, kept.counted)
        end = _replayed(cfg, opened, outputs, kept, watcher.progress)
        outputs.end(end)
        target.require_free(source.files, force=may_replace)  # another program may have written them meanwhile
        if kept.are_durable:
            outputs.make_durable()
    if kept.are_durable:
        sync_folder(target.path.parent)
    kept.remove()
    return outputs.summary((f"{folder.path}: left by an interrupted replay, removed",) if kept.left_over else ())


def _require_writable(source: ReplaySource, target: ReplayTarget, beginning: Beginning, *, resume: bool) -> None:
    """Check before the input is read what may be replaced; with ``resume`` a finished output may stand there."""
    target.require_free(source.files, force=True)
    before = beginning.continued
    if before is not None and before.exists() and target.path.exists() and target.path.samefile(before):
        raise TargetError(f"{target.path}: is the part that the replay goes on from; name another output")
    _require_no_recording(target.path, several=len(source.files) > 1)
    if not resume:
        target.require_free(source.files, force=target.force)


def _summary_of_finished(target: ReplayTarget, opened: OpenedLog, output: LogSummary) -> ReplaySummary:
    """What an earlier replay of the same did."""
    frames, messages = int(replay_record(output.metadata).get(FRAMES_KEY, 0)), sum(output.counts.values())
    notes = (f"{target.path}: is complete, nothing is left to do",)
    log_id, warnings = opened.input.log_id, opened.warnings
    return ReplaySummary(log_id, frames, messages, 0.0, notes, {}, {}, (), warnings, frames, is_new=False)


class _Outputs:
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

    def begin(self, watcher: Watcher, counted: Counted) -> None:
        """Register all channels, and tell who wants to know; ``counted`` is of the frames that were computed before."""
        self._copy = MessageCopy(self._log, *_to_copy(self._input, self._target.results_only))
        self._results = ResultWriter(self._log, self._pictures)
        self._results.reasons = dict(counted.reasons)
        self._pictures.without_image, self._pictures.misfits = counted.without_image, counted.misfits
        self._timed = watcher.opened(self._log, self._input.span_ns)

    def compute(self, memory: ReplayMemory, sample: Sample) -> tuple[ReplayMemory, FrameOutput | None]:
        """Run the chain on a sample and write its messages; of one that only warms up the chain nothing is written."""
        timer, log_id = StageTimer(), self._input.log_id
        with timer("total"):
            memory, result, written, row = run_frame(self._cfg, memory, log_id, sample, timer)
            if not sample.is_written:
                return memory, None
            if self._opened.strict:
                require_sound(self._input.summary.path, sample.frame.stamp_ns, result.reasons())
            self._copy.through(sample.log_time_ns)
            with timer("encode"):
                shown, messages = self._results.messages(sample, result, written, row, memory.shown)
            self._results.write(sample, messages)
        objects = tuple(object_metrics(log_id, sample, result))
        return replace(memory, shown=shown), FrameOutput(messages, row, timer.columns(), objects)

    def write_again(self, sample: Sample, output: FrameOutput) -> None:
        """Write the messages of a frame that was computed before."""
        self._copy.through(sample.log_time_ns)
        self._results.write(sample, output.messages)
        self._frames_before, self._resumed_ns = self._frames_before + 1, sample.log_time_ns

    def append(self, output: FrameOutput) -> None:
        """Write a frame's rows."""
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
        )


def _replayed(
    cfg: ReplayConfig, opened: OpenedLog, outputs: _Outputs, checkpoints: Checkpoints, progress: Progress
) -> ReplayMemory:
    """Go through all frames.

    Returns:
        What is remembered after the last one that no later message can alter.
    """
    log_in = opened.input
    memory = end = opened.memory_for(cfg)
    complete = log_in.plan.first_pass.complete_frames
    for number, sample in enumerate(log_in.samples(), start=1):
        if number <= checkpoints.samples:
            output = checkpoints.next_output(sample.index) if sample.is_written else None
            memory = checkpoints.memory
            if output is not None:
                outputs.write_again(sample, output)
        else:
            memory, output = outputs.compute(memory, sample)
            checkpoints.keep(output)
        if output is not None:
            outputs.append(output)
        if number <= complete:
            end = memory
            checkpoints.reached(sample.log_time_ns, number, memory, lambda: outputs.counted)
        progress(log_in.frames, log_in.expected_frames)
    return end


def _to_copy(log_in: ReplayInput, results_only: bool) -> tuple[Iterable[Channel], Iterator[Message]]:
    """Channels and messages of the input that the output has as well."""
    return ((), iter(())) if results_only else (log_in.channels, log_in.messages())


def _require_no_recording(target: Path, *, several: bool) -> None:
    """Check that what may be replaced is no recording: the last part of a log, where the output was forgotten.

    Raises:
        TargetError: it is one, or with several inputs anything but a result.
    """
    if not target.exists():
        return
    try:
        found = log.summarise(target)
    except LogError:
        replaceable = not several
    else:
        replaceable = is_result_log(found.metadata, found.channels)
    if not replaceable:
        raise TargetError(f"{target}: is no result of this program, so nothing replaces it; was OUT.mcap forgotten?")
