"""The results of a replay into its log, frame by frame, and at the end how they came about."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from roadperc_stream import __version__
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import EarlierTruth, FrameResult, Odometry, Reason, Sample
from roadperc_stream.core.geometry import Float
from roadperc_stream.core.reasons import ReasonCounts, frame_reasons, merged, of_frame
from roadperc_stream.core.stage_timer import StageTimer
from roadperc_stream.log import Attachment, Channel, LogSummary, LogWriter, Message, Metadata
from roadperc_stream.output.drawing.on_request import PictureMaker
from roadperc_stream.output.results import result_messages
from roadperc_stream.schemas.columns import FrameMetrics, ObjectMetrics
from roadperc_stream.schemas.record import (
    CONFIG_ATTACHMENT,
    METADATA_RECORD,
    OWN_ATTACHMENTS,
    PRODUCER,
    SEED_KEY,
    VERSION_KEY,
)
from roadperc_stream.schemas.registry import schema
from roadperc_stream.schemas.topics import result_schemas

TRAJECTORY_POSES: Final = 200
"""Length of the trajectory that each frame shows: ten seconds at 20 Hz."""
ResultMessages = tuple[tuple[str, bytes], ...]
"""Topic and bytes of each."""
Timed = Callable[[FrameMetrics, Mapping[str, float]], None]
"""Takes a frame's row and its time columns in milliseconds, before anything of a later frame is written."""


def unwatched(_writer: LogWriter, _span_ns: tuple[int, int]) -> Timed:
    """Nobody follows the output while it is written."""
    return lambda _row, _times_ms: None


@dataclass(frozen=True)
class Shown:
    """What a frame's messages show of earlier frames.

    ``trajectory`` are the latest poses odom_T_ego that are known, ``reasons`` those of the frame before, ``first_ns``
    the stamp of the first frame of all. Each pose is of an odometry, which checks it; those of a state are checked when
    it is read (``state.memory_checks``): checking all in every frame takes as long as drawing the lanes.
    """

    trajectory: tuple[Float, ...] = ()
    reasons: tuple[str, ...] = ()
    first_ns: int | None = None

    def after(self, result: FrameResult, reasons: Iterable[Reason]) -> "Shown":
        """What the next frame shows of earlier ones: of this one, with its reasons, too."""
        first_ns = result.stamp_ns if self.first_ns is None else self.first_ns
        return Shown(self.with_pose(result), tuple(map(str, reasons)), first_ns)

    def with_pose(self, result: FrameResult) -> tuple[Float, ...]:
        """The trajectory with the pose of one more frame, where it has one."""
        if not isinstance(result.odometry, Odometry) or result.odometry.status == "lost":
            return self.trajectory
        return (*self.trajectory, result.odometry.odom_T_ego)[-TRAJECTORY_POSES:]


@dataclass(frozen=True)
class ComputedFrame:
    """What the chain made of a sample: the result, and what of it a log can carry (``written``).

    ``shown`` is what its messages show of the frames before, ``earlier`` the truth of the last one, ``timer`` measures
    all that is done with it.
    """

    sample: Sample
    result: FrameResult
    written: FrameResult
    shown: Shown
    earlier: EarlierTruth | None
    timer: StageTimer


@dataclass(frozen=True)
class FrameOutput:
    """All that is written of one frame: its messages, its row with the time columns in milliseconds, its objects."""

    messages: ResultMessages
    row: FrameMetrics
    times_ms: Mapping[str, float]
    objects: tuple[ObjectMetrics, ...]


class ResultWriter:
    """Makes the messages of what the frames gave, and writes them.

    ``reasons`` are those of all frames so far.
    """

    def __init__(self, writer: LogWriter, pictures: PictureMaker) -> None:
        self._writer, self._pictures = writer, pictures
        self._channels = {t: _result_channel(t, name) for t, name in result_schemas(pictures.requests).items()}
        for channel in self._channels.values():
            writer.register(channel)
        self.reasons: ReasonCounts = {}

    def messages(self, frame: ComputedFrame, row: FrameMetrics) -> ResultMessages:
        """Topics and bytes of a frame's results; ``row`` is its row."""
        sample, result, shown = frame.sample, frame.result, frame.shown
        first_ns = result.stamp_ns if shown.first_ns is None else shown.first_ns
        messages = list(result_messages(sample, frame.written, row, shown.reasons, shown.with_pose(result)))
        messages += self._pictures.messages(sample, result, row, first_ns)
        self.reasons = merged((self.reasons, of_frame(frame_reasons(sample, result))))
        return tuple(messages)

    def write(self, sample: Sample, messages: ResultMessages) -> None:
        """Write a frame's messages."""
        time_ns = sample.log_time_ns
        for topic, data in messages:
            self._writer.write(Message(self._channels[topic], time_ns, time_ns, sample.index, data))


def _result_channel(topic: str, schema_name: str) -> Channel:
    found = schema(schema_name)
    return Channel(topic, found.message_encoding, found.name, found.schema_encoding, found.data, metadata=(PRODUCER,))


def write_origin(
    writer: LogWriter,
    source: LogSummary,
    cfg: ReplayConfig,
    record: Mapping[str, str],
    states: Iterable[Attachment],
) -> None:
    """Carry the input's attachments and metadata over, and say how this output came about.

    Args:
        writer: of the output.
        source: the input.
        cfg: the chain's configuration.
        record: what else the result has to record of its input.
        states: what the replay began with, and what it leaves to the next part.
    """
    for attachment in source.attachments:
        if attachment.name not in OWN_ATTACHMENTS:
            writer.attach(attachment)
    for attachment in (Attachment(CONFIG_ATTACHMENT, "application/toml", cfg.to_toml().encode()), *states):
        writer.attach(attachment)
    for metadata in source.metadata:
        if metadata.name != METADATA_RECORD:
            writer.describe(metadata)
    facts = {VERSION_KEY: __version__, SEED_KEY: str(cfg.seed), **record}
    writer.describe(Metadata(METADATA_RECORD, tuple(facts.items())))
