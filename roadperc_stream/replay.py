"""The one loop: a log in, the log with results and the metrics tables out."""

import hashlib
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from roadperc_stream import __version__, log
from roadperc_stream.chain.step import ChainState, step
from roadperc_stream.cli.plumbing import no_progress
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import FrameResult, Odometry, Sample
from roadperc_stream.core.files import require_free
from roadperc_stream.core.geometry import Float
from roadperc_stream.core.reasons import Reasons, grouped, merged, throughout
from roadperc_stream.input.plan import WHOLE, Cut, Survey, input_messages, samples, span_ns, survey_log
from roadperc_stream.input.roles.fill import Problems, is_result, tag_table_needed
from roadperc_stream.input.sync import SyncCounts
from roadperc_stream.log import Attachment, Channel, LogSummary, LogWriter, Message, Metadata
from roadperc_stream.metrics import frame_metrics, object_metrics
from roadperc_stream.output.drawing.on_request import PictureMaker
from roadperc_stream.output.results import as_written, result_messages
from roadperc_stream.output.tables import TableWriter, beside
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics, ObjectMetrics
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT, METADATA_RECORD, PRODUCER, TAG_TABLE_KEY, TOPIC_KEY
from roadperc_stream.schemas.registry import schema
from roadperc_stream.schemas.topics import Request, result_schemas

TRAJECTORY_POSES = 200
"""Length of the trajectory that each frame shows: ten seconds at 20 Hz."""


@dataclass
class StageTimer:
    """Milliseconds each stage took since the last ``reset``."""

    elapsed_ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Measure what happens inside, and add it to the stage's time."""
        started = perf_counter()
        try:
            yield
        finally:
            self.elapsed_ms[name] = self.elapsed_ms.get(name, 0.0) + (perf_counter() - started) * 1000

    def columns(self) -> dict[str, float]:
        """The time columns of a row; stages that did not run are left out."""
        return {f"{name}_ms": value for name, value in self.elapsed_ms.items()}


@dataclass(frozen=True)
class ReplaySummary:
    """What a replay did, for the person who started it."""

    log_id: str
    frames: int
    messages_out: int
    seconds: float
    notes: tuple[str, ...]
    dropped: dict[str, int]
    problems: dict[str, int]
    throughout: tuple[str, ...]
    """The reasons that held in all frames, in words."""


@contextmanager
def all_or_none(*outputs: TableWriter | LogWriter) -> Iterator[None]:
    """Open outputs that get their names when all are complete: a disk that is full is full for all of them.

    Nothing half written stays, even where a signal comes while an output is being opened.
    """
    with ExitStack() as stack:
        for output in outputs:
            stack.callback(output.discard)
        for output in outputs:
            stack.enter_context(output)
        yield
        for output in outputs:
            output.complete()


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep OpenCV and BLAS to one thread, where a second one mostly waits, and numpy from warning of absurd input."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(limits=1, user_api="blas"), np.errstate(all="ignore"):
            yield
    finally:
        cv2.setNumThreads(before)


Timed = Callable[[FrameMetrics, Mapping[str, float]], None]
"""Takes a frame's row and its time columns in milliseconds, before anything of a later frame is written."""


def unwatched(_writer: LogWriter, _span_ns: tuple[int, int]) -> Timed:
    """Nobody follows the output while it is written."""
    return lambda _row, _times_ms: None


def replay(
    source: Path,
    target: Path,
    cfg: ReplayConfig,
    *,
    overrides: dict[str, str] | None = None,
    cut: Cut = WHOLE,
    results_only: bool = False,
    on_request: Collection[Request] = (),
    force: bool = False,
    progress: Callable[[int, int], None] = no_progress,
    opened: Callable[[LogWriter, tuple[int, int]], Timed] = unwatched,
) -> ReplaySummary:
    """Replay a log through the chain.

    Args:
        source: the log to read.
        target: the log to write; ``target.metrics.parquet`` and ``target.objects.parquet`` come beside it.
        cfg: the chain's configuration.
        overrides: topic of each role that is not on the contract's topic.
        cut: part of the log to replay; the copy of the input is cut with it.
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
    summary = log.summarise(source)
    survey = survey_log(summary, cfg, overrides or {}, cut)
    counts, problems, facts = SyncCounts(), Problems(), table_facts(source, target, cfg)
    log_id, state = survey.digest[:16], ChainState()
    previous: Sample | None = None
    frames = TableWriter(beside(target, "metrics"), FrameMetrics, facts, TIME_COLUMNS)
    detections = TableWriter(beside(target, "objects"), ObjectMetrics, facts)
    writer = LogWriter(target, summary.profile)
    pictures = PictureMaker(on_request)
    with one_thread(), all_or_none(frames, detections, writer):
        copy = InputCopy(summary, survey, cfg, writer, results_only)
        results = ResultWriter(writer, pictures)
        timed = opened(writer, span_ns(summary, survey))
        for sample in samples(summary, survey, cfg, counts, problems):
            timer = StageTimer()
            with timer("total"):
                state, made = step(cfg, state, sample.frame, timer)
                result, written = as_written(made)
                row = frame_metrics(cfg, log_id, sample, result, previous)
                copy.through(sample.log_time_ns)
                results.write(sample, result, written, row, timer)
            timed(row, timer.columns())
            frames.append(row, **timer.columns())
            for detection in object_metrics(log_id, sample, result):
                detections.append(detection)
            previous = sample
            progress(counts.frames, survey.expected_frames)
        copy.rest()
        _describe(writer, summary, survey, cfg, counts)
        _require_free(source, target, force)  # another program may have written them meanwhile
    return ReplaySummary(
        log_id,
        counts.frames,
        writer.messages,
        perf_counter() - started,
        (*survey.filled.notes, *(survey.problems.first | problems.first).values(), *pictures.notes()),
        dict(counts.dropped),
        dict(problems.counts),
        throughout(results.reasons, counts.frames, survey.filled.topics),
    )


class InputCopy:
    """Copies the input's messages to the output, as far as the results have come."""

    def __init__(
        self,
        summary: LogSummary,
        survey: Survey,
        cfg: ReplayConfig,
        writer: LogWriter,
        results_only: bool,
    ) -> None:
        self._writer = writer
        channels = [] if results_only else [c for c in summary.channels if not is_result(c)]
        for channel in channels:
            writer.register(channel)
        self._messages = iter(()) if results_only else input_messages(summary, cfg, survey)
        self._next = next(self._messages, None)

    def through(self, log_time_ns: int | None) -> None:
        """Copy everything up to and including a log time; None copies all that is left."""
        while self._next is not None and (log_time_ns is None or self._next.log_time_ns <= log_time_ns):
            self._writer.write(self._next)
            self._next = next(self._messages, None)

    def rest(self) -> None:
        """Copy all that is left."""
        self.through(None)


class ResultWriter:
    """Writes what the frames gave, and remembers what a later frame's messages show: the way, and the reasons told.

    ``reasons`` are those of all frames so far.
    """

    def __init__(self, writer: LogWriter, pictures: PictureMaker) -> None:
        self._writer, self._pictures = writer, pictures
        self._channels = {t: _result_channel(t, name) for t, name in result_schemas(pictures.requests).items()}
        for channel in self._channels.values():
            writer.register(channel)
        self._way = deque[Float](maxlen=TRAJECTORY_POSES)
        self._last_reasons: tuple[str, ...] = ()
        self.reasons: Reasons = {}

    def write(
        self, sample: Sample, result: FrameResult, written: FrameResult, row: FrameMetrics, timer: StageTimer
    ) -> None:
        """Write a frame's results; ``written`` is what of ``result`` the log can carry."""
        if isinstance(result.odometry, Odometry) and result.odometry.status != "lost":
            self._way.append(result.odometry.odom_T_ego)
        with timer("encode"):
            messages = list(result_messages(sample, written, row, self._last_reasons, tuple(self._way)))
            messages += self._pictures.messages(sample, result, row)
        for topic, data in messages:
            time_ns = sample.log_time_ns
            self._writer.write(Message(self._channels[topic], time_ns, time_ns, sample.index, data))
        self._last_reasons = row.reasons
        self.reasons = merged((self.reasons, grouped(Counter(row.reasons))))


def _require_free(source: Path, target: Path, force: bool) -> None:
    require_free(target, force=force, source=source, suffix=".mcap")
    for table in (beside(target, "metrics"), beside(target, "objects")):
        require_free(table, force=force, suffix=".parquet")


def _result_channel(topic: str, schema_name: str) -> Channel:
    found = schema(schema_name)
    return Channel(topic, found.message_encoding, found.name, found.schema_encoding, found.data, metadata=(PRODUCER,))


def table_facts(source: Path, target: Path, cfg: ReplayConfig) -> dict[str, str]:
    """What a table says of where it came from: ``roadperc.log`` is the log beside it, ``roadperc.source`` the input."""
    facts = {
        "config_digest": hashlib.sha256(cfg.to_toml().encode()).hexdigest(),
        "version": __version__,
        "log": str(target.absolute()),
        "source": str(source.absolute()),
    }
    return {f"roadperc.{key}": value for key, value in facts.items()}


def _describe(writer: LogWriter, summary: LogSummary, survey: Survey, cfg: ReplayConfig, counts: SyncCounts) -> None:
    """Carry the input's attachments and metadata over, and say how this output came about."""
    for attachment in summary.attachments:
        if attachment.name != CONFIG_ATTACHMENT:
            writer.attach(attachment)
    writer.attach(Attachment(CONFIG_ATTACHMENT, "application/toml", cfg.to_toml().encode()))
    for record in summary.metadata:
        if record.name != METADATA_RECORD:
            writer.describe(record)
    tag_table = tag_table_needed(summary.channels, survey.filled, cfg.tag_table)
    facts = {
        "version": __version__,
        "seed": str(cfg.seed),
        "digest": survey.digest,
        "input_messages": str(survey.messages),
        "frames": str(counts.frames),
        **{f"{TOPIC_KEY}{role}": topic for role, topic in sorted(survey.filled.chosen.items())},
        **({TAG_TABLE_KEY: tag_table} if tag_table else {}),
        **{f"dropped.{role}": str(number) for role, number in sorted(counts.dropped.items())},
    }
    writer.describe(Metadata(METADATA_RECORD, tuple(facts.items())))
