"""What the player reads from: a finished log, or one that a replay is writing."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from roadperc_stream import log
from roadperc_stream.core.time import NS_PER_S
from roadperc_stream.errors import LogError
from roadperc_stream.log import Channel, GrowingLog, LogSummary, Message
from roadperc_stream.view.live.playhead import Reach

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
