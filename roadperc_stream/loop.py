"""The loop: open the log, for each sample run the chain, compute the metrics, and write."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from time import perf_counter, thread_time

from roadperc_stream.chain.prepare import prepare
from roadperc_stream.chain.step import State, step
from roadperc_stream.config import ReplayConfig
from roadperc_stream.input import ReplaySource
from roadperc_stream.metrics import frame_metrics, object_metrics
from roadperc_stream.metrics.evidence import evidence_of
from roadperc_stream.metrics.hindsight import claims_of
from roadperc_stream.model import FrameResult, Sample
from roadperc_stream.output.target import ReplayTarget
from roadperc_stream.output.writing import NO_CALLBACKS, Callbacks, FrameOutput, Outputs, ReplaySummary
from roadperc_stream.resume.checkpoint import Checkpoint, CheckpointFolder, Checkpoints
from roadperc_stream.resume.opening import PLAIN, OpenedLog, ReplayOptions, finished, open_replay, run_of
from roadperc_stream.resume.state import ReplayState
from roadperc_stream.system.files import all_or_none
from roadperc_stream.system.pipeline import Pipeline
from roadperc_stream.system.progress import StageTimer
from roadperc_stream.system.threads import one_thread


def replay(
    source: ReplaySource,
    target: ReplayTarget,
    cfg: ReplayConfig,
    options: ReplayOptions = PLAIN,
    callbacks: Callbacks = NO_CALLBACKS,
) -> ReplaySummary:
    """Replay a log through the chain.

    Args:
        source: the log to read, and the part to replay.
        target: the log to write, and its content.
        cfg: the chain's configuration.
        options: how to begin, checkpoints, threads, and stages of the user's own.
        callbacks: called during the replay.

    Raises:
        RoadpercError: the input cannot be read or replayed, or the output cannot be written. Only requested checkpoints
            stay.
    """
    started = perf_counter()
    with CheckpointFolder(target.path) as folder:
        found = folder.read() if options.resume else None
        target.require_writable(source.files, options.continued, resume=options.resume)
        opened = open_replay(source, cfg, options)
        summary = finished(target, opened) if options.resume and found is None else None
        if summary is None:
            start = Checkpoint(run_of(opened, target), opened.initial)
            checkpoints = Checkpoints(folder, options.checkpoint_every_s, start, found, force=target.force)
            force = target.force or (options.resume and folder.proves_ours(is_complete=target.is_complete))
            target = replace(target, force=force)
            summary = _replay_opened(source, target, opened, options, checkpoints, callbacks=callbacks)
        folder.remove()
    return replace(summary, seconds=perf_counter() - started)


def _replay_opened(
    source: ReplaySource,
    target: ReplayTarget,
    opened: OpenedLog,
    options: ReplayOptions,
    checkpoints: Checkpoints,
    callbacks: Callbacks,
) -> ReplaySummary:
    """Replay an opened log; the outputs get their names when all are complete."""
    target.require_free(source.files)
    outputs = Outputs(target, opened.input, opened.table_facts(), opened.initial.shown.recent)
    checkpoints.begin()
    with one_thread(), all_or_none(*outputs.files):
        frames = _Frames(opened, outputs, checkpoints, callbacks, options)
        frames.run()
        states, notes = ((), ()) if target.results_only else frames.end.attached()
        outputs.end(opened.facts(), states)
        target.require_free(source.files)  # another program may have written them
    return outputs.summary(opened.warnings, (*opened.notes, *notes, *checkpoints.notes))


_Timed = tuple[Sample, StageTimer]


class _Frames:
    """The frames of one replay; the steps may run in different threads, one after the other for each frame."""

    def __init__(
        self,
        opened: OpenedLog,
        outputs: Outputs,
        checkpoints: Checkpoints,
        callbacks: Callbacks,
        options: ReplayOptions,
    ) -> None:
        self._cfg, self._input, self._threads, self._own = opened.input.cfg, opened.input, options.threads, options.own
        self._outputs, self._checkpoints, self._callbacks = outputs, checkpoints, callbacks
        self._samples = self._written = 0
        self.end = opened.end_state()
        self._chain, self._earlier = checkpoints.progress.state.chain, checkpoints.progress.state.earlier

    def run(self) -> None:
        """Write all frames: copy those of an interrupted replay, compute the others."""
        samples, progress = self._input.samples(), self._checkpoints.progress
        self._outputs.begin(self._callbacks, progress.state.shown)
        for sample in islice(samples, progress.samples):
            if sample.is_written:
                self._outputs.write_again(sample, self._checkpoints.next_output(sample.index))
            self._done(sample, progress.state)  # the state counts after the last of them
        read = Pipeline[_Timed](self._read(samples), apart=bool(self._own))
        read.then(self._prepare).then(self._step).then(self._write).run(self._threads)

    def _read(self, samples: Iterator[Sample]) -> Iterator[_Timed]:
        while True:
            timer = StageTimer(perf_counter if self._threads == 1 else thread_time)
            with timer("read"):
                sample = next(samples, None)
            if sample is None:
                return
            yield sample, timer

    def _prepare(self, item: _Timed) -> _Timed:
        sample, timer = item
        return replace(sample, frame=prepare(self._cfg, sample.frame, timer, self._threads, self._own)), timer

    def _step(self, item: _Timed) -> tuple[_Timed, State, FrameResult]:
        sample, timer = item
        self._chain, result = step(self._cfg, self._chain, sample.frame, timer, self._own)
        return item, self._chain, result

    def _write(self, item: tuple[_Timed, State, FrameResult]) -> None:
        (sample, timer), chain, result = item
        if sample.is_written:
            self._input.require_usable(result)
            with timer("metrics"):
                row = frame_metrics(self._cfg, self._input.log_id, sample, result, self._earlier)
                found = object_metrics(self._input.log_id, sample, result)
                output = FrameOutput(row, *found, evidence_of(self._cfg, sample.frame, result), claims_of(result))
            self._checkpoints.keep(self._outputs.write(sample, result, output, timer))
        self._earlier = sample.as_earlier
        self._done(sample, ReplayState(chain, self._earlier, self._outputs.shown))

    def _done(self, sample: Sample, state: ReplayState) -> None:
        self._samples, self._written = self._samples + 1, self._written + sample.is_written
        self.end.reached(sample.settled, state)
        if sample.settled is not None:
            self._checkpoints.reached(sample.log_time_ns, self._samples, state)
        self._callbacks.on_progress(self._written, self._input.expected_frames)
