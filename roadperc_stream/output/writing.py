"""The results of a replay into its log, frame by frame, and at the end how they came about."""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Final

from roadperc_stream import __version__
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.datatypes import FrameResult, Odometry, Sample
from roadperc_stream.core.geometry import Float
from roadperc_stream.core.reasons import ReasonCounts, frame_reasons, merged, of_frame
from roadperc_stream.core.stage_timer import StageTimer
from roadperc_stream.log import Attachment, Channel, LogSummary, LogWriter, Message, Metadata
from roadperc_stream.output.drawing.on_request import PictureMaker
from roadperc_stream.output.results import result_messages
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.schemas.record import CONFIG_ATTACHMENT, METADATA_RECORD, PRODUCER, SEED_KEY, VERSION_KEY
from roadperc_stream.schemas.registry import schema
from roadperc_stream.schemas.topics import result_schemas

TRAJECTORY_POSES: Final = 200
"""Length of the trajectory that each frame shows: ten seconds at 20 Hz."""
Timed = Callable[[FrameMetrics, Mapping[str, float]], None]
"""Takes a frame's row and its time columns in milliseconds, before anything of a later frame is written."""


def unwatched(_writer: LogWriter, _span_ns: tuple[int, int]) -> Timed:
    """Nobody follows the output while it is written."""
    return lambda _row, _times_ms: None


class ResultWriter:
    """Writes what the frames gave, and remembers what a later frame's messages show: trajectory and last reasons.

    ``reasons`` are those of all frames so far.
    """

    def __init__(self, writer: LogWriter, pictures: PictureMaker) -> None:
        self._writer, self._pictures = writer, pictures
        self._channels = {t: _result_channel(t, name) for t, name in result_schemas(pictures.requests).items()}
        for channel in self._channels.values():
            writer.register(channel)
        self._trajectory = deque[Float](maxlen=TRAJECTORY_POSES)
        self._last_reasons: tuple[str, ...] = ()
        self.reasons: ReasonCounts = {}

    def write(
        self, sample: Sample, result: FrameResult, written: FrameResult, row: FrameMetrics, timer: StageTimer
    ) -> None:
        """Write a frame's results; ``written`` is what of ``result`` the log can carry."""
        if isinstance(result.odometry, Odometry) and result.odometry.status != "lost":
            self._trajectory.append(result.odometry.odom_T_ego)
        with timer("encode"):
            messages = list(result_messages(sample, written, row, self._last_reasons, tuple(self._trajectory)))
            messages += self._pictures.messages(sample, result, row)
        for topic, data in messages:
            time_ns = sample.log_time_ns
            self._writer.write(Message(self._channels[topic], time_ns, time_ns, sample.index, data))
        self._last_reasons = row.reasons
        self.reasons = merged((self.reasons, of_frame(frame_reasons(sample, result))))


def _result_channel(topic: str, schema_name: str) -> Channel:
    found = schema(schema_name)
    return Channel(topic, found.message_encoding, found.name, found.schema_encoding, found.data, metadata=(PRODUCER,))


def write_origin(writer: LogWriter, source: LogSummary, cfg: ReplayConfig, record: Mapping[str, str]) -> None:
    """Carry the input's attachments and metadata over, and say how this output came about.

    Args:
        writer: of the output.
        source: the input.
        cfg: the chain's configuration.
        record: what else the result has to record of its input.
    """
    for attachment in source.attachments:
        if attachment.name != CONFIG_ATTACHMENT:
            writer.attach(attachment)
    writer.attach(Attachment(CONFIG_ATTACHMENT, "application/toml", cfg.to_toml().encode()))
    for metadata in source.metadata:
        if metadata.name != METADATA_RECORD:
            writer.describe(metadata)
    facts = {VERSION_KEY: __version__, SEED_KEY: str(cfg.seed), **record}
    writer.describe(Metadata(METADATA_RECORD, tuple(facts.items())))
