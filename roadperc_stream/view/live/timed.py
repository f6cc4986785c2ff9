"""A log's messages and, behind each frame's metrics, how long its stages took: a channel that is in no file."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

from google.protobuf.message import DecodeError as ProtobufError

from roadperc_stream.input.earlier_replay import is_result_of
from roadperc_stream.log import Channel, Message
from roadperc_stream.schemas import roadperc_pb2 as pb
from roadperc_stream.schemas.record import PRODUCER
from roadperc_stream.schemas.registry import schema
from roadperc_stream.schemas.topics import LIVE_ONLY, METRICS_TOPIC, TIMES_TOPIC
from roadperc_stream.view.live.playhead import Reach
from roadperc_stream.view.live.source import Source
from roadperc_stream.view.stage_times import StageTimes


@dataclass(frozen=True)
class TimedSource:
    """A source with one more channel, whose messages have the log times of the metrics they belong to."""

    source: Source
    times: StageTimes

    @cached_property
    def channel(self) -> Channel:
        """The channel of the times."""
        found = schema(LIVE_ONLY[TIMES_TOPIC])
        return Channel(TIMES_TOPIC, found.message_encoding, found.name, found.schema_encoding, found.data, (PRODUCER,))

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Those of the log, and the times."""
        return (*self.source.channels, self.channel)

    def reach(self) -> Reach:
        """That of the log."""
        return self.source.reach()

    def read(self, topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[Message]:
        """Messages there are now, up to but not including ``end_ns``."""
        if TIMES_TOPIC not in topics:
            yield from self.source.read(topics, start_ns, end_ns)
            return
        for message in self.source.read({*topics, METRICS_TOPIC}, start_ns, end_ns):
            if message.channel.topic in topics:
                yield message
            yield from self._times_of(message)

    def follow(self, start_ns: int) -> Iterator[Message | None]:
        """Messages from a log time on; None where there is no more yet.

        A replay writes a frame's metrics before it knows the frame's times, and knows these before it writes anything
        later: so they come with what is next.
        """
        waiting: Message | None = None
        for message in self.source.follow(start_ns):
            found = self._times_of(waiting)
            yield from found
            yield message
            waiting = message if _is_metrics(message) else None if found else waiting
        yield from self._times_of(waiting)

    def has_times(self) -> bool:
        """Whether those of the first frame are known."""
        reach = self.source.reach()
        first = next(self.source.read({METRICS_TOPIC}, 0, reach.last_ns + 1), None)
        return bool(self._times_of(first))

    def _times_of(self, message: Message | None) -> list[Message]:
        """The times that belong to a frame's metrics, as far as they are known."""
        frame = _frame_of(message)
        times_ms = self.times.of(frame.log_id, frame.frame) if frame else {}
        if message is None or frame is None or not times_ms:
            return []
        times = pb.StageTimes(timestamp=frame.timestamp, frame_id=frame.frame_id, **times_ms)
        return [replace(message, channel=self.channel, data=times.SerializeToString())]


def _is_metrics(message: Message | None) -> bool:
    return message is not None and is_result_of(message.channel, METRICS_TOPIC)


def _frame_of(message: Message | None) -> pb.FrameMetrics | None:
    """A frame's metrics; None where the message is something else, or damaged."""
    try:
        return pb.FrameMetrics.FromString(message.data) if message and _is_metrics(message) else None
    except ProtobufError:
        return None
