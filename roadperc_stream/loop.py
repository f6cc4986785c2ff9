"""The one loop: a log in, the log with results and the metrics tables out."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

from roadperc_stream import log
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import Sample
from roadperc_stream.core.files import TABLE_SUFFIX, all_or_none, remove_dead_partials, require_free
from roadperc_stream.core.progress import Progress, no_progress
from roadperc_stream.core.reasons import throughout
from roadperc_stream.core.stage_timer import StageTimer
from roadperc_stream.core.threads import one_thread
from roadperc_stream.core.time import WHOLE, TimeRange
from roadperc_stream.errors import ConfigError, LogError, StateError, TargetError
from roadperc_stream.input import ReplayInput
from roadperc_stream.input.damage import require_sound
from roadperc_stream.input.earlier_replay import is_result_log, replay_record
from roadperc_stream.log import Channel, LogWriter, Message, MessageCopy
from roadperc_stream.metrics import object_metrics
from roadperc_stream.output.drawing.on_request import PictureMaker
from roadperc_stream.output.tables import TableWriter, sidecar_path, table_facts
from roadperc_stream.output.writing import FrameOutput, ResultWriter, Timed, unwatched, write_origin
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics, ObjectMetrics
from roadperc_stream.schemas.record import BEGIN_ATTACHMENT, FRAMES_KEY, STATE_ATTACHMENT
from roadperc_stream.schemas.topics import Request
from roadperc_stream.state.attached import attachment_of
from roadperc_stream.state.checkpoint import CheckpointFolder, Checkpoints, Counted
from roadperc_stream.state.identity import finished, run_of
from roadperc_stream.state.opening import OpenedLog, ReplaySource, open_continued, open_log, open_warmed
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


def replay(
    source: Path | Sequence[Path],
    target: Path,
    cfg: ReplayConfig,
    *,
    overrides: Mapping[str, str] | None = None,
    time_range: TimeRange = WHOLE,
    results_only: bool = False,
    on_request: Collection[Request] = (),
    force: bool = False,
    recover: bool = False,
    strict: bool = False,
    continued: Path | None = None,
    warm_up_s: float = 0.0,
    checkpoint_every_s: float | None = None,
    resume: bool = False,
    progress: Progress = no_progress,
    opened: Callable[[LogWriter, tuple[int, int]], Timed] = unwatched,
) -> ReplaySummary:
    """Replay a log through the chain.

    Args:
        source: the log to read, or the parts of one; a path ``-`` is standard input.
        target: the log to write; ``target.metrics.parquet`` and ``target.objects.parquet`` come beside it.
        cfg: the chain's configuration.
        overrides: topic of each role that is not on the contract's topic.
        time_range: part of the log to replay; the copy of the input is cut with it.
        results_only: leave the input's messages out of ``target``.
        on_request: pictures to write beside the results; drawing them counts as encoding.
        force: replace an existing ``target``, but no recording, and start over where a checkpoint is of another replay.
        recover: replay what can be read of a damaged log; frames behind what was lost say so.
        strict: the first message that cannot be used is an error, instead of costing that message alone.
        continued: the result of the part of the drive before, to go on from.
        warm_up_s: seconds of log before the start of ``time_range`` on which the chain's memory is built.
        checkpoint_every_s: seconds of log after which what is complete is made durable; None: never.
        resume: go on from the latest checkpoint, where there is one.
        progress: called with frames done and frames expected.
        opened: called once before the first message with the output and its first and last log time in nanoseconds;
            gives who takes each frame's times, which are not in the output.

    Raises:
        RoadpercError: the input cannot be read or replayed, or the output cannot be written; nothing is left behind but
            the checkpoints that were asked for.
    """
    started = perf_counter()
    _require_one_beginning(time_range, continued, warm_up_s)
    folder = CheckpointFolder(target)
    found = folder.read() if resume else None
    sources = [source] if isinstance(source, Path) else list(source)
    _require_free(sources, target, force=True)
    _require_no_recording(target, several=len(sources) > 1)
    if not resume:
        _require_free(sources, target, force)
    for path in (target, *_tables(target)):
        remove_dead_partials(path)
    replayed = ReplaySource(sources, overrides or {}, time_range, recover, strict)
    log_opened = _opened(replayed, cfg, continued, warm_up_s)
    log_in = log_opened.input
    run = run_of(cfg, log_opened, results_only=results_only, on_request=on_request)
    if resume and found is None and (done := _finished_before(target, cfg, log_opened, started)) is not None:
        return done
    checkpoints = Checkpoints(folder, checkpoint_every_s, run, found, force=force)
    may_replace = force or found is not None
    _require_free(sources, target, may_replace)
    outputs = _Outputs(target, cfg, log_opened, on_request)
    with one_thread(), checkpoints, all_or_none(*outputs.files):
        outputs.begin(opened, checkpoints.counted, results_only=results_only)
        end = _replayed(cfg, log_opened, outputs, checkpoints, progress)
        state = ReplayState(log_in.log_id, settings_of(cfg), log_in.end_state(with_messages=results_only), end)
        outputs.end(state)
        _require_free(sources, target, may_replace)  # another program may have written them meanwhile
    checkpoints.remove()
    return ReplaySummary(
        log_in.log_id,
        log_in.frames,
        outputs.log.messages,
        perf_counter() - started,
        (*log_opened.notes, *log_in.notes, *outputs.pictures.notes(), *outputs.notes),
        log_in.dropped,
        log_in.unreadable,
        throughout(outputs.results.reasons, log_in.frames, log_in.topics),
        log_opened.warnings,
    )


def _require_one_beginning(time_range: TimeRange, continued: Path | None, warm_up_s: float) -> None:
    if warm_up_s and continued is not None:
        raise ConfigError("warm_up_s: what is continued needs no warm-up")
    if warm_up_s and time_range.start_s is None:
        raise ConfigError("warm_up_s: only with a start")


def _finished_before(target: Path, cfg: ReplayConfig, opened: OpenedLog, started: float) -> ReplaySummary | None:
    """What an earlier replay of the same did, where its output is whole."""
    there = all(path.exists() for path in (target, *_tables(target)))
    if not there or (summary := finished(target, cfg, opened)) is None:
        return None
    log_in, frames = opened.input, int(replay_record(summary.metadata).get(FRAMES_KEY, 0))
    notes = (f"{target}: is complete, nothing is left to do",)
    messages = sum(summary.counts.values())
    return ReplaySummary(log_in.log_id, frames, messages, perf_counter() - started, notes, {}, {}, ())


def _opened(source: ReplaySource, cfg: ReplayConfig, continued: Path | None, warm_up_s: float) -> OpenedLog:
    if continued is not None:
        return open_continued(source, cfg, continued)
    if warm_up_s:
        return open_warmed(source, cfg, warm_up_s)
    return open_log(source, cfg)


class _Outputs:
    """What a replay writes: the log and its two tables."""

    def __init__(self, target: Path, cfg: ReplayConfig, opened: OpenedLog, on_request: Collection[Request]) -> None:
        self._cfg, self._opened, self._input = cfg, opened, opened.input
        facts = table_facts(self._input.summary.path, target, cfg, opened.table_facts())
        self._frames = TableWriter(sidecar_path(target, "metrics"), FrameMetrics, facts, TIME_COLUMNS)
        self._objects = TableWriter(sidecar_path(target, "objects"), ObjectMetrics, facts)
        self.log, self.pictures = LogWriter(target, self._input.summary.profile), PictureMaker(on_request)
        self.files = (self._frames, self._objects, self.log)
        self.notes: tuple[str, ...] = ()

    def begin(
        self, opened: Callable[[LogWriter, tuple[int, int]], Timed], counted: Counted, *, results_only: bool
    ) -> None:
        """Register all channels, and tell who wants to know; ``counted`` is of the frames that were computed before."""
        self._copy = MessageCopy(self.log, *_to_copy(self._input, results_only))
        self.results = ResultWriter(self.log, self.pictures)
        self.results.reasons = dict(counted.reasons)
        self.pictures.without_image, self.pictures.misfits = counted.without_image, counted.misfits
        self._timed = opened(self.log, self._input.span_ns)

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
                shown, messages = self.results.messages(sample, result, written, row, memory.shown)
            self.results.write(sample, messages)
        objects = tuple(object_metrics(log_id, sample, result))
        return replace(memory, shown=shown), FrameOutput(messages, row, timer.columns(), objects)

    def write_again(self, sample: Sample, output: FrameOutput) -> None:
        """Write the messages of a frame that was computed before."""
        self._copy.through(sample.log_time_ns)
        self.results.write(sample, output.messages)

    def append(self, output: FrameOutput) -> None:
        """Write a frame's rows."""
        self._timed(output.row, output.times_ms)
        self._frames.append(output.row, **output.times_ms)
        for item in output.objects:
            self._objects.append(item)

    @property
    def counted(self) -> Counted:
        """What has been counted so far."""
        return Counted(tuple(self.results.reasons.items()), self.pictures.without_image, self.pictures.misfits)

    def end(self, state: ReplayState) -> None:
        """Write what comes behind the last frame."""
        self._copy.rest()
        begin = self._opened.state_for(self._cfg)
        states = () if begin is None else (attachment_of(BEGIN_ATTACHMENT, begin),)
        record = {**self._opened.facts(), **self._input.record()}
        try:
            states = (*states, attachment_of(STATE_ATTACHMENT, state))
        except StateError as error:  # the results are none the worse for it
            self.notes = (f"{STATE_ATTACHMENT}: left out, this part cannot be continued: {error}",)
        write_origin(self.log, self._input.summary, self._cfg, record, states)


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
            output = checkpoints.next_output() if sample.is_written else None
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


def _tables(target: Path) -> tuple[Path, Path]:
    return sidecar_path(target, "metrics"), sidecar_path(target, "objects")


def _require_free(sources: Iterable[Path], target: Path, force: bool) -> None:
    for source in sources:
        require_free(target, force=force, source=source, suffix=".mcap")
    for table in _tables(target):
        require_free(table, force=force, suffix=TABLE_SUFFIX)


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
