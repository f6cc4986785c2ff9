"""Reads the messages of the replayed part of a log."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.stream import RoleAssignment, decoded_messages
from roadperc_stream.log import Channel, LogSummary, Message, Piece
from roadperc_stream.model import SettledFrame
from roadperc_stream.system.time import seconds_to_ns


@dataclass(frozen=True)
class LeadIn:
    """What is read before the window, from ``start_ns`` up to ``end_ns``: the end of a continued result, or a warm-up.

    Of a continued result, the frames up to its ``last`` complete one are left out, and the later ones are written
    again. Frames of a warm-up only build the chain's state.
    """

    summary: LogSummary
    start_ns: int
    end_ns: int
    continues: bool
    last: SettledFrame | None = None

    @property
    def known_ns(self) -> int:
        """The last log time of the frames that are left out, or of a warm-up."""
        last_ns = -1 if self.last is None else self.last.log_time_ns
        return last_ns if self.continues else self.end_ns - 1

    def contains(self, log_time_ns: int) -> bool:
        """Whether a message of this log time is before the window."""
        return log_time_ns < self.end_ns

    def is_known(self, log_time_ns: int, stamp_ns: int) -> bool:
        """Whether a message belongs to the frames that are left out, or to a warm-up: its loss was counted before."""
        is_earlier = not self.continues or (self.last is not None and stamp_ns <= self.last.stamp_ns)
        return is_earlier and self.contains(log_time_ns)


@dataclass(frozen=True)
class WindowMessages:
    """Reads the messages to replay, in log-time order: the lead, the window, and late ones.

    The window is the part of the log from ``start_ns`` up to ``end_ns``, None without a limit.
    """

    summary: LogSummary
    cfg: ReplayConfig
    roles: RoleAssignment
    start_ns: int | None
    end_ns: int | None
    end_stamp_ns: int | None
    """Stamp of the first frame after the window. A sensor's message with an earlier stamp belongs to the window even if
    it arrives after ``end_ns``."""
    cut_ns: int | None
    """Log time from which another replay continues the log: ``end_ns``, or the cut of an earlier replay. Messages of
    this log after the cut arrived late, and the other replay's input has them too."""
    lead: LeadIn | None
    latched: tuple[Message, ...] = ()
    """The messages from before that hold at the beginning of the copy."""

    def all(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """All messages that make the frames; ``topics`` limits them."""
        yield from self.before(topics)
        yield from self.inside(topics)

    def copied(self) -> Iterator[Message]:
        """All messages of the output's copy: latched ones, those of a continued result, and the window's."""
        yield from self.copied_before()
        yield from self.inside()

    def pieces(self) -> Iterator[Piece]:
        """As ``copied``, but as whole chunks of the log where possible."""
        yield from self.copied_before()
        yield from log.pieces(self.summary, self.inputs, self.start_ns, self.end_ns)
        yield from self._late(None)

    def copied_before(self) -> Iterator[Message]:
        """The messages of the output's copy from before the window."""
        yield from self.latched
        yield from self.before() if self.lead is not None and self.lead.continues else ()

    def before(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages of the lead, on the channels of the log; ``topics`` limits them."""
        if self.lead is None:
            return
        messages = _inputs_of(self.lead.summary, self.lead.start_ns, self.lead.end_ns, topics)
        yield from on_channels_of(self.summary, messages)

    def inside(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages in the window, and later ones that belong to it; ``topics`` limits them."""
        yield from _inputs_of(self.summary, self.start_ns, self.end_ns, topics)
        yield from self._late(topics)

    @property
    def inputs(self) -> tuple[Channel, ...]:
        """All channels of the log except the results of an earlier replay."""
        return tuple(channel for channel in self.summary.channels if not is_result(channel))

    def _late(self, topics: Collection[str] | None) -> Iterator[Message]:
        """Messages of sensors after the window that belong to it by their stamps."""
        end_ns, end_stamp_ns = self.end_ns, self.end_stamp_ns
        if end_ns is None or end_stamp_ns is None:
            return
        for message in _inputs_of(self.summary, end_ns, end_ns + seconds_to_ns(self.cfg.sync.max_wait_s), topics):
            items = decoded_messages([message], self.roles, self.cfg)
            if any(item.stamp_ns < end_stamp_ns and not item.is_latched for item in items):
                yield message


def on_channels_of(summary: LogSummary, messages: Iterable[Message]) -> Iterator[Message]:
    """Messages of an earlier log, on the equal channels of a log if it has them."""
    own = {replace(channel, source_id=0): channel for channel in summary.channels}
    for message in messages:
        channel = replace(message.channel, source_id=0)
        yield replace(message, channel=own.get(channel, channel))


def _inputs_of(
    summary: LogSummary, start_ns: int | None, end_ns: int | None, topics: Collection[str] | None
) -> Iterator[Message]:
    """The messages of a log without the results of an earlier replay."""
    if topics is None:
        topics = {channel.topic for channel in summary.channels if not is_result(channel)}
    messages = log.read(summary, topics=topics, start_ns=start_ns, end_ns=end_ns)
    return (message for message in messages if not is_result(message.channel))
