"""The one loop: a log in, the log with results and the metrics tables out."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from time import perf_counter, thread_time
from typing import Final

from roadperc_stream import log
from roadperc_stream.chain.step import Sight, Timer, Whereabouts, see
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import Sample
from roadperc_stream.core.files import all_or_none, sync_folder
from roadperc_stream.core.pipeline import Pipeline
from roadperc_stream.core.progress import Progress, no_progress
from roadperc_stream.core.stage_timer import StageTimer
from roadperc_stream.core.threads import one_thread, opencv_threads
from roadperc_stream.errors import LogError, TargetError
from roadperc_stream.input import ReplaySource
from roadperc_stream.input.damage import require_sound
from roadperc_stream.input.earlier_replay import is_result_log, replay_record
from roadperc_stream.log import LogSummary, LogWriter
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import ComputedFrame, Timed, unwatched
from roadperc_stream.outputs import Outputs, ReplaySummary
from roadperc_stream.schemas.record import FRAMES_KEY
from roadperc_stream.state.checkpoint import NO_CHECKPOINTS, CheckpointOptions, Checkpoints
from roadperc_stream.state.checkpoint_folder import CheckpointFolder
from roadperc_stream.state.identity import finished, run_of
from roadperc_stream.state.opening import BY_ITSELF, Beginning, OpenedLog, open_replay
from roadperc_stream.state.replay_state import ReplayMemory
from roadperc_stream.state.running import run_locating, run_perceiving

_MATCHING_THREADS: Final = 2
"""More of them gain little."""


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
    threads: int = 1,
) -> ReplaySummary:
    """Replay a log through the chain.

    Args:
        source: the log to read, and what of it.
        target: the log to write, and what into it.
        cfg: the chain's configuration.
        beginning: what the chain has seen before the first frame.
        checkpoints: how often what is complete is made durable, and whether to go on from there.
        watcher: who follows it.
        threads: how many work on it; what is written does not depend on them, but for the times.

    Raises:
        RoadpercError: the input cannot be read or replayed, or the output cannot be written; nothing is left behind but
            the checkpoints that were asked for.
    """
    started = perf_counter()
    with CheckpointFolder(target.path, cfg.limits) as folder:
        summary = _replay(source, target, cfg, folder, beginning, checkpoints, watcher, threads)
    return replace(summary, seconds=perf_counter() - started)


def _replay(
    source: ReplaySource,
    target: ReplayTarget,
    cfg: ReplayConfig,
    folder: CheckpointFolder,
    beginning: Beginning,
    checkpoints: CheckpointOptions,
    watcher: Watcher,
    threads: int,
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
    outputs = Outputs(target, cfg, opened)
    with one_thread(), kept, all_or_none(*outputs.files):
        outputs.begin(watcher.opened, kept.counted)
        end = _Frames(cfg, opened, outputs, kept, watcher, threads).replayed()
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
    log_id, warnings, first_ns = opened.input.log_id, opened.warnings, opened.input.summary.first_ns or 0
    return ReplaySummary(log_id, frames, messages, 0.0, notes, {}, {}, (), warnings, frames, None, False, first_ns)


@dataclass(frozen=True)
class _Given:
    """A sample of the log, counted from 1, and what measures all that is done with it."""

    number: int
    sample: Sample
    timer: StageTimer


_Seen = tuple[_Given, Sight | None]
_Located = tuple[_Given, Whereabouts | None]
_Perceived = tuple[_Given, ComputedFrame | None, ReplayMemory]


class _Frames:
    """The frames of one replay, each from the log through the chain into the outputs, in their order.

    The steps on the way remember what they need from one frame to the next, each for itself, so that several threads
    can be at several of them. What a checkpoint holds is not computed again.
    """

    def __init__(
        self,
        cfg: ReplayConfig,
        opened: OpenedLog,
        outputs: Outputs,
        checkpoints: Checkpoints,
        watcher: Watcher,
        threads: int,
    ) -> None:
        self._cfg, self._opened, self._input, self._outputs = cfg, opened, opened.input, outputs
        self._checkpoints, self._progress, self._threads = checkpoints, watcher.progress, threads
        self._complete = self._input.plan.first_pass.complete_frames
        self._expected = self._input.expected_frames
        self._written = 0
        self._located = self._perceived = self._end = opened.memory_for(cfg)

    def replayed(self) -> ReplayMemory:
        """Go through all frames.

        Returns:
            What is remembered after the last one that no later message can alter.
        """
        frames = Pipeline[_Given](self._read())
        frames.then(self._see).then(self._locate).then(self._perceive).then(self._finish).run(self._threads)
        return self._end

    def _read(self) -> Iterator[_Given]:
        clock = perf_counter if self._threads == 1 else thread_time
        samples = self._input.samples()
        for number in count(1):
            timer = StageTimer(clock)
            with timer("read"):
                sample = next(samples, None)
            if sample is None:
                return
            yield _Given(number, sample, timer)

    def _is_computed(self, given: _Given) -> bool:
        """Whether an earlier run has been through all steps."""
        return given.number <= self._checkpoints.samples

    def _see(self, given: _Given) -> _Seen:
        if self._is_computed(given):
            return given, None
        return given, see(self._cfg, given.sample.frame, _matching_in(self._threads, given.timer))

    def _locate(self, seen: _Seen) -> _Located:
        given, sight = seen
        if sight is None:
            self._located = self._checkpoints.memory
            return given, None
        self._located, place = run_locating(self._cfg, self._located, given.sample, sight, given.timer)
        return given, place

    def _perceive(self, located: _Located) -> _Perceived:
        (given, place), before, frame = located, self._perceived, None
        if place is None:
            self._perceived = self._checkpoints.memory
        else:
            sample, timer = given.sample, given.timer
            self._perceived, result, written = run_perceiving(self._cfg, before, sample, place, timer)
            if sample.is_written and self._opened.strict:
                require_sound(self._input.summary.path, sample.frame.stamp_ns, result.reasons())
            frame = ComputedFrame(sample, result, written, before.shown, before.earlier, timer)
        return given, frame, self._perceived

    def _finish(self, perceived: _Perceived) -> None:
        """Write what is to be written of a sample; of one that only warms up the chain nothing is."""
        given, frame, memory = perceived
        sample, outputs, checkpoints = given.sample, self._outputs, self._checkpoints
        if sample.is_written:
            if frame is None:
                outputs.write_again(sample, checkpoints.next_output(sample.index))
            else:
                checkpoints.keep(outputs.write(frame))
            self._written += 1
        if given.number <= self._complete:
            self._end = memory
            checkpoints.reached(sample.log_time_ns, given.number, memory, lambda: outputs.counted)
        self._progress(self._written, self._expected)


def _matching_in(threads: int, timer: StageTimer) -> Timer:
    """The timer, with a second thread of OpenCV's while stereo matches: that gives the same bits in half the time."""

    @contextmanager
    def timed(stage: str) -> Iterator[None]:
        with timer(stage), opencv_threads(min(threads, _MATCHING_THREADS) if stage == "stereo" else 1):
            yield

    return timed


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
