"""Reads the messages of the replayed part of a log."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

from roadperc_stream import log
from roadperc_stream.config import ReplayConfig
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.stream import Problems, RoleAssignment, decoded_messages
from roadperc_stream.log import Channel, LogSummary, Message, Piece
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES
from roadperc_stream.system.time import seconds_to_ns


@dataclass(frozen=True)
class Window:
    """The part of a log, by log time: from ``start_ns`` up to ``end_ns``, None without a limit.

    ``end_stamp_ns`` is the stamp of the first frame after the window. A sensor's message with an earlier stamp belongs
    to the window even if it arrives after ``end_ns``. ``late_until_ns`` is the end of these late messages in log time,
    None without any. ``cut_ns`` is the log time from which another replay continues the log: ``end_ns``, or the cut of
    an earlier replay. Messages of this log after the cut arrived late, and the other replay's input has them too.
    """

    start_ns: int | None = None
    end_ns: int | None = None
    end_stamp_ns: int | None = None
    cut_ns: int | None = None
    late_until_ns: int | None = None


@dataclass(frozen=True)
class WindowMessages:
    """Reads the messages to replay, in log-time order: latched ones, the window, and late ones.

    ``latched`` has the messages from before the window that hold in it.
    """

    summary: LogSummary
    cfg: ReplayConfig
    roles: RoleAssignment
    window: Window
    latched: tuple[Message, ...]

    def all(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """All messages of the window.

        ``topics`` limits them; None yields all.
        """
        yield from self.inside(topics)
        yield from self.late(topics)

    def inside(self, topics: Collection[str] | None = None, from_ns: int = 0) -> Iterator[Message]:
        """Latched messages, and messages in the window up to the cut.

        ``topics`` limits them; None yields all. ``from_ns`` is the first log time read.
        """
        held = (m for m in self.latched if m.log_time_ns >= from_ns)
        yield from (m for m in held if topics is None or m.channel.topic in topics)
        ends = [ns for ns in (self.window.end_ns, self.window.cut_ns) if ns is not None]
        yield from self._read(max(self.window.start_ns or 0, from_ns), min(ends, default=None), topics)

    def pieces(self) -> Iterator[Piece]:
        """All messages of the window, as whole chunks of the log where possible."""
        start_ns, end_ns = self.window.start_ns, self.window.end_ns
        if self.window.cut_ns is not None and start_ns is not None:
            start_ns = min(start_ns, self.window.cut_ns)
        yield from self.latched
        yield from log.pieces(self.summary, self._inputs, start_ns, end_ns)
        yield from self._behind_the_end(None)

    def late(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Messages that arrive after the cut or the window, and belong to it by their stamps."""
        end_ns, cut_ns = self.window.end_ns, self.window.cut_ns
        if cut_ns is not None and (end_ns is None or cut_ns < end_ns):
            yield from self._read(cut_ns, end_ns, topics)
        yield from self._behind_the_end(topics)

    def with_late(self) -> "WindowMessages":
        """The same with ``late_until_ns`` set: reads the stamps of the messages after the window."""
        end_ns = self.window.end_ns
        if end_ns is None or self.window.end_stamp_ns is None:
            return self
        sensors = {topic for role, topic in self.roles.topics.items() if ROLES[role].kind not in LATCHED_KINDS}
        last_ns = None
        for message in self._read(end_ns, end_ns + seconds_to_ns(self.cfg.sync.max_wait_s), sensors):
            if self._belongs_inside(message):
                last_ns = message.log_time_ns
        return replace(self, window=replace(self.window, late_until_ns=None if last_ns is None else last_ns + 1))

    def _behind_the_end(self, topics: Collection[str] | None) -> Iterator[Message]:
        """Messages after the window that belong to it by their stamps."""
        until_ns = self.window.late_until_ns
        late = () if until_ns is None else self._read(self.window.end_ns, until_ns, topics)
        yield from (message for message in late if self._belongs_inside(message))

    def _read(self, start_ns: int | None, end_ns: int | None, topics: Collection[str] | None) -> Iterator[Message]:
        inputs = {channel.topic for channel in self._inputs}  # channels of results are not read
        topics = inputs if topics is None else topics
        messages = log.read(self.summary, topics=topics, start_ns=start_ns, end_ns=end_ns)
        return (message for message in messages if not is_result(message.channel))

    @property
    def _inputs(self) -> tuple[Channel, ...]:
        return tuple(channel for channel in self.summary.channels if not is_result(channel))

    def _belongs_inside(self, message: Message) -> bool:
        """Whether a sensor's message has a stamp before the first frame after the window."""
        end_stamp_ns = self.window.end_stamp_ns
        items = decoded_messages([message], self.roles, self.cfg.tag_table, Problems(), self.cfg.limits)
        sensed = (item.stamp_ns for item in items if ROLES[item.role].kind not in LATCHED_KINDS)
        return end_stamp_ns is not None and any(stamp_ns < end_stamp_ns for stamp_ns in sensed)
