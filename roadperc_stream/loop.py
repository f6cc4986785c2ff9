"""The one loop: a log in, the log with results and the metrics tables out."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from roadperc_stream.chain.step import ChainState, Timer, step, untimed
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import EarlierTruth, FrameResult, Sample
from roadperc_stream.core.files import TABLE_SUFFIX, all_or_none, require_free
from roadperc_stream.core.progress import Progress, no_progress
from roadperc_stream.core.reasons import throughout
from roadperc_stream.core.stage_timer import StageTimer
from roadperc_stream.core.threads import one_thread
from roadperc_stream.core.time import WHOLE, TimeRange
from roadperc_stream.input import ReplayInput, open_input
from roadperc_stream.log import Channel, LogWriter, Message, MessageCopy
from roadperc_stream.metrics import frame_metrics, object_metrics
from roadperc_stream.output.drawing.on_request import PictureMaker
from roadperc_stream.output.results import drop_beyond_ros_time
from roadperc_stream.output.tables import TableWriter, sidecar_path, table_facts
from roadperc_stream.output.writing import ResultWriter, Timed, unwatched, write_origin
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics, ObjectMetrics
from roadperc_stream.schemas.topics import Request


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


def run_frame(
    cfg: ReplayConfig,
    state: ChainState,
    log_id: str,
    sample: Sample,
    previous: EarlierTruth | None,
    timer: Timer = untimed,
) -> tuple[ChainState, FrameResult, FrameResult, FrameMetrics]:
    """Run the chain on a sample of a log and measure it, the sample before at hand.

    Returns:
        The chain's next state, the frame's result, what of it a log can carry, and its row.
    """
    state, made = step(cfg, state, sample.frame, timer)
    result, written = drop_beyond_ros_time(made)
    return state, result, written, frame_metrics(cfg, log_id, sample, result, previous)


def replay(
    source: Path,
    target: Path,
    cfg: ReplayConfig,
    *,
    overrides: Mapping[str, str] | None = None,
    time_range: TimeRange = WHOLE,
    results_only: bool = False,
    on_request: Collection[Request] = (),
    force: bool = False,
    progress: Progress = no_progress,
    opened: Callable[[LogWriter, tuple[int, int]], Timed] = unwatched,
) -> ReplaySummary:
    """Replay a log through the chain.

    Args:
        source: the log to read.
        target: the log to write; ``target.metrics.parquet`` and ``target.objects.parquet`` come beside it.
        cfg: the chain's configuration.
        overrides: topic of each role that is not on the contract's topic.
        time_range: part of the log to replay; the copy of the input is cut with it.
        results_only: leave the input's messages out of ``target``.
        on_request: pictures to write beside the results; drawing them counts as encoding.
        force: replace an existing ``target``.
        progress: called with frames done and frames expected.
        opened: called once before the first message with the output and its first and last log time in nanoseconds;
            gives who takes each frame's times, which are not in the output.

    Raises:
        RoadpercError: the input cannot be read or replayed, or the output cannot be written; nothing is left behind.
    """
    started = perf_counter()
    _require_free(source, target, force)
    log_in, facts = open_input(source, cfg, overrides, time_range), table_facts(source, target, cfg)
    frames = TableWriter(sidecar_path(target, "metrics"), FrameMetrics, facts, TIME_COLUMNS)
    detections = TableWriter(sidecar_path(target, "objects"), ObjectMetrics, facts)
    log_out, pictures = LogWriter(target, log_in.summary.profile), PictureMaker(on_request)
    state = ChainState()
    previous: EarlierTruth | None = None
    with one_thread(), all_or_none(frames, detections, log_out):
        copy = MessageCopy(log_out, *_to_copy(log_in, results_only))
        results = ResultWriter(log_out, pictures)
        timed = opened(log_out, log_in.span_ns)
        for sample in log_in.samples():
            timer = StageTimer()
            with timer("total"):
                state, result, written, row = run_frame(cfg, state, log_in.log_id, sample, previous, timer)
                copy.through(sample.log_time_ns)
                results.write(sample, result, written, row, timer)
            timed(row, timer.columns())
            frames.append(row, **timer.columns())
            for detection in object_metrics(log_in.log_id, sample, result):
                detections.append(detection)
            previous = sample.as_earlier
            progress(log_in.frames, log_in.expected_frames)
        copy.rest()
        write_origin(log_out, log_in.summary, cfg, log_in.record())
        _require_free(source, target, force)  # another program may have written them meanwhile
    return ReplaySummary(
        log_in.log_id,
        log_in.frames,
        log_out.messages,
        perf_counter() - started,
        (*log_in.notes, *pictures.notes()),
        log_in.dropped,
        log_in.unreadable,
        throughout(results.reasons, log_in.frames, log_in.topics),
    )


def _to_copy(log_in: ReplayInput, results_only: bool) -> tuple[Iterable[Channel], Iterator[Message]]:
    """Channels and messages of the input that the output has as well."""
    return ((), iter(())) if results_only else (log_in.channels, log_in.messages())


def _require_free(source: Path, target: Path, force: bool) -> None:
    require_free(target, force=force, source=source, suffix=".mcap")
    for table in (sidecar_path(target, "metrics"), sidecar_path(target, "objects")):
        require_free(table, force=force, suffix=TABLE_SUFFIX)
