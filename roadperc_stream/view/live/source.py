"""What the player reads from: a finished log, or one that a replay is writing; with the times of the stages."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final, Protocol

from google.protobuf.message import DecodeError as ProtobufError

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.input.earlier_replay import is_result_of
from roadperc_stream.log import Channel, GrowingLog, LogSummary, Message
from roadperc_stream.schemas import roadperc_pb2 as pb
from roadperc_stream.schemas.record import PRODUCER
from roadperc_stream.schemas.registry import schema
from roadperc_stream.schemas.topics import LIVE_ONLY, METRICS_TOPIC, TIMES_TOPIC
from roadperc_stream.system.time import NS_PER_S
from roadperc_stream.view.live.playhead import Reach
from roadperc_stream.view.result_frames import StageTimes

_LOOK_BACK_NS: Final = NS_PER_S
_LOOK_BACK_GROWTH: Final = 4


class Source(Protocol):
    """A log to play, as far as it has come."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All channels, those without a message included."""
        ...

    def reach(self) -> Reach:
        """What can be played now."""
        ...

    def read(self, topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[Message]:
        """Messages there are now, up to but not including ``end_ns``."""
        ...

    def follow(self, start_ns: int) -> Iterator[Message | None]:
        """Messages from a log time on; None where there is no more yet, the end where there never will be."""
        ...


@dataclass(frozen=True)
class FinishedLog:
    """A log on disk."""

    summary: LogSummary
    first_ns: int
    last_ns: int

    @classmethod
    def opened(cls, path: Path) -> "FinishedLog":
        """Look what a log holds; its CRCs are checked as it is read.

        Raises:
            LogError: it cannot be read, or holds no message.
        """
        summary = log.summarise(path)
        if summary.first_ns is None or summary.last_ns is None or not sum(summary.counts.values()):
            raise LogError(f"{path}: no message to play")
        return cls(summary, summary.first_ns, summary.last_ns)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All channels of the log."""
        return self.summary.channels

    def reach(self) -> Reach:
        """All of it."""
        return Reach(self.first_ns, self.last_ns)

    def read(self, topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[Message]:
        """Messages of some topics, up to but not including ``end_ns``."""
        return log.read(self.summary, topics=topics, start_ns=start_ns, end_ns=end_ns)

    def follow(self, start_ns: int) -> Iterator[Message | None]:
        """All messages from a log time on."""
        return log.read(self.summary, start_ns=start_ns)


@dataclass(frozen=True)
class RunningReplay:
    """The output of a replay, played while it is written.

    Its reach begins and ends just before a log time whose messages may not all be there yet.
    """

    growing: GrowingLog
    first_ns: int
    """First log time of the part that is replayed."""

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All channels of the output."""
        return self.growing.channels

    def reach(self) -> Reach:
        """What is computed."""
        last_ns, complete = self.growing.progress()
        whole_ns = (last_ns or 0) if complete else (last_ns or 0) - 1
        return Reach(self.first_ns - 1, max(whole_ns, self.first_ns - 1), complete)

    def read(self, topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[Message]:
        """Messages of some topics computed by now, up to but not including ``end_ns``."""
        return self.growing.read(topics=topics, start_ns=start_ns, end_ns=end_ns)

    def follow(self, start_ns: int) -> Iterator[Message | None]:
        """All messages from a log time on, None at the edge of what is computed."""
        return self.growing.follow(start_ns)


def held(source: Source, topics: Collection[str], log_ns: int) -> list[Message]:
    """What holds at a log time: the last message of each channel up to it, with those of its very time.

    Looks back in growing steps and only for the topics not found yet, so that a frame is found in the last second and
    a calibration sent once at the start without reading all between: the index says where it stands.
    """
    missing, end_ns, step_ns = set(topics), log_ns + 1, _LOOK_BACK_NS
    first_ns, found = source.reach().first_ns, list[Message]()
    while missing and end_ns > 0:
        start_ns = end_ns - step_ns if end_ns - step_ns > first_ns else 0
        last = _last_by_channel(source.read(missing, start_ns, end_ns))
        missing -= {channel.topic for channel in last}
        found += [message for messages in last.values() for message in messages]
        end_ns, step_ns = start_ns, step_ns * _LOOK_BACK_GROWTH
    return sorted(found, key=lambda message: message.log_time_ns)


def _last_by_channel(messages: Iterator[Message]) -> dict[Channel, list[Message]]:
    last: dict[Channel, list[Message]] = {}
    for message in messages:
        known = last.setdefault(message.channel, [])
        if known and known[-1].log_time_ns != message.log_time_ns:
            known.clear()
        known.append(message)
    return last


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
