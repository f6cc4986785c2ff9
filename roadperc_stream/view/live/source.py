"""Sources for the player: a finished log or a running replay, with stage times."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

from google.protobuf.message import DecodeError as ProtobufError

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.input.earlier_replay import is_result_of
from roadperc_stream.log import Channel, GrowingLog, LogSummary, Message
from roadperc_stream.output.results import result_channel
from roadperc_stream.schemas.row_messages import FrameMetrics, StageTimes
from roadperc_stream.schemas.topics import LIVE_ONLY, METRICS_TOPIC, TIMES_TOPIC
from roadperc_stream.system.time import NS_PER_S
from roadperc_stream.view.result_frames import TimesOfFrame

_LOOK_BACK_NS: Final = NS_PER_S
_LOOK_BACK_GROWTH: Final = 4


@dataclass(frozen=True)
class Reach:
    """The span of a log that can be played now; a complete one does not grow."""

    first_ns: int
    last_ns: int
    complete: bool = True

    def clamp(self, log_ns: int) -> int:
        """The nearest log time in the span."""
        return max(self.first_ns, min(log_ns, self.last_ns))


@dataclass(frozen=True)
class Source:
    """A log to play, finished or growing."""

    channels: tuple[Channel, ...]
    """All channels, including those without messages."""
    reach: Callable[[], Reach]
    """Returns the span that can be played now."""
    read: Callable[[Collection[str], int, int], Iterator[Message]]
    """Returns the existing messages of some topics in a half-open span of log time."""
    follow: Callable[[int], Iterator[Message | None]]
    """Returns all messages from a log time on, and None while the next one is not written yet."""


def finished_log(summary: LogSummary) -> Source:
    """A log on disk; reading it checks its CRCs.

    Raises:
        LogError: it has no messages.
    """
    if summary.first_ns is None or summary.last_ns is None or not sum(summary.counts.values()):
        raise LogError(f"{summary.path}: the log has no messages to play")
    reach = Reach(summary.first_ns, summary.last_ns)

    def read(topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[Message]:
        return log.read(summary, topics=topics, start_ns=start_ns, end_ns=end_ns)

    return Source(summary.channels, lambda: reach, read, lambda start_ns: log.read(summary, start_ns=start_ns))


def running_replay(growing: GrowingLog, first_ns: int) -> Source:
    """The output of a replay, played while it is written.

    Its reach ends just before the last log time, whose messages may be incomplete. ``first_ns`` is the first log time
    of the replayed messages.
    """

    def reach() -> Reach:
        last_ns, complete = growing.progress()
        whole_ns = (last_ns or 0) if complete else (last_ns or 0) - 1
        return Reach(first_ns - 1, max(whole_ns, first_ns - 1), complete)

    def read(topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[Message]:
        return growing.read(topics=topics, start_ns=start_ns, end_ns=end_ns)

    return Source(growing.channels, reach, read, growing.follow)


def held(source: Source, topics: Collection[str], log_ns: int) -> list[Message]:
    """The last message of each channel up to a log time, or its last messages if several share a log time.

    Looks back in growing steps for the topics not found yet. With the index, a calibration at the start is read without
    the messages in between.
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


def with_times(source: Source, times: TimesOfFrame) -> Source:
    """The source with stage times as one more channel, at the log times of their frames' metrics."""
    channel = result_channel(TIMES_TOPIC, LIVE_ONLY[TIMES_TOPIC])

    def read(topics: Collection[str], start_ns: int, end_ns: int) -> Iterator[Message]:
        if TIMES_TOPIC not in topics:
            return source.read(topics, start_ns, end_ns)
        timed = _timed(source.read({*topics, METRICS_TOPIC}, start_ns, end_ns), channel, times)
        return (message for message in timed if message and message.channel.topic in topics)

    def follow(start_ns: int) -> Iterator[Message | None]:
        return _timed(source.follow(start_ns), channel, times)

    return Source((*source.channels, channel), source.reach, read, follow)


def has_times(source: Source, times: TimesOfFrame) -> bool:
    """Whether the times of the first frame are known."""
    frame = _frame_of(next(source.read({METRICS_TOPIC}, 0, source.reach().last_ns + 1), None))
    return frame is not None and bool(times(frame.log_id, frame.frame))


def _timed(messages: Iterator[Message | None], channel: Channel, times: TimesOfFrame) -> Iterator[Message | None]:
    """The messages, with the times of each frame after its metrics.

    In a running replay, the times of a frame are known after its metrics and before the next frame is written. So they
    are looked up at each message until they are known.
    """
    waiting: Message | None = None
    for message in messages:
        found = _times_of(waiting, channel, times)
        yield from found
        yield message
        waiting = message if _is_metrics(message) else None if found else waiting
    yield from _times_of(waiting, channel, times)


def _times_of(message: Message | None, channel: Channel, times: TimesOfFrame) -> list[Message]:
    """The message with the stage times of a frame; empty if they are unknown."""
    frame = _frame_of(message)
    times_ms = times(frame.log_id, frame.frame) if frame else {}
    if message is None or frame is None or not times_ms:
        return []
    content = StageTimes(timestamp=frame.timestamp, frame_id=frame.frame_id, **times_ms)
    return [replace(message, channel=channel, data=content.SerializeToString())]


def _is_metrics(message: Message | None) -> bool:
    return message is not None and is_result_of(message.channel, METRICS_TOPIC)


def _frame_of(message: Message | None) -> Any:
    """The metrics in a message; None for other messages and damaged ones."""
    try:
        return FrameMetrics.FromString(message.data) if message and _is_metrics(message) else None
    except ProtobufError:
        return None
