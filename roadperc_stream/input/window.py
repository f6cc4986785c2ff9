"""The messages of the part of a log that is replayed."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from roadperc_stream import log
from roadperc_stream.core.config import ReplayConfig
from roadperc_stream.core.time import seconds_to_ns
from roadperc_stream.input.earlier_replay import is_result
from roadperc_stream.input.problems import Problems
from roadperc_stream.input.roles import RoleAssignment
from roadperc_stream.input.stream import decoded_messages
from roadperc_stream.log import LogSummary, Message
from roadperc_stream.schemas.roles import LATCHED_KINDS, ROLES


@dataclass(frozen=True)
class Window:
    """The part of a log, by log time: from ``start_ns`` up to ``end_ns``, None without a limit.

    ``end_stamp_ns`` is the stamp of the first frame beyond: a sensor's message that arrives later than ``end_ns`` but
    belongs to an earlier instant is part of the window still. ``cut_ns`` is the log time at which the drive goes on
    elsewhere: ``end_ns``, where the log does not end before, or where an earlier replay cut the log; what stands behind
    it arrived late, and comes again there.
    """

    start_ns: int | None = None
    end_ns: int | None = None
    end_stamp_ns: int | None = None
    cut_ns: int | None = None

    @property
    def limits_ns(self) -> tuple[int | None, int | None]:
        """Its first log time, and the first one behind it."""
        return self.start_ns, self.end_ns


@dataclass(frozen=True)
class WindowMessages:
    """Reads the messages to replay, in log-time order: what was latched before, the window, what arrives late for it.

    ``latched`` are the messages from before the window that hold in it.
    """

    summary: LogSummary
    cfg: ReplayConfig
    roles: RoleAssignment
    window: Window
    latched: tuple[Message, ...]

    def all(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """All of them.

        Args:
            topics: only these; None for all.
        """
        yield from self.inside(topics)
        yield from self.late(topics)

    def inside(self, topics: Collection[str] | None = None, from_ns: int = 0) -> Iterator[Message]:
        """Those from before the window and in it, up to where the drive goes on elsewhere.

        Args:
            topics: only these; None for all.
            from_ns: the first log time read.
        """
        held = (m for m in self.latched if m.log_time_ns >= from_ns)
        yield from (m for m in held if topics is None or m.channel.topic in topics)
        ends = [ns for ns in (self.window.end_ns, self.window.cut_ns) if ns is not None]
        yield from self._read(max(self.window.start_ns or 0, from_ns), min(ends, default=None), topics)

    def late(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Those that arrive after that and belong to an instant before it."""
        end_ns, end_stamp_ns, cut_ns = self.window.end_ns, self.window.end_stamp_ns, self.window.cut_ns
        if cut_ns is not None and (end_ns is None or cut_ns < end_ns):
            yield from self._read(cut_ns, end_ns, topics)
        if end_ns is None or end_stamp_ns is None:
            return
        until_ns = end_ns + seconds_to_ns(self.cfg.sync.max_wait_s)
        for message in self._read(end_ns, until_ns, topics):
            if self._belongs_before(message, end_stamp_ns):
                yield message

    def _read(self, start_ns: int | None, end_ns: int | None, topics: Collection[str] | None) -> Iterator[Message]:
        messages = log.read(self.summary, topics=topics, start_ns=start_ns, end_ns=end_ns)
        return (message for message in messages if not is_result(message.channel))

    def _belongs_before(self, message: Message, end_stamp_ns: int) -> bool:
        """Whether a message of a sensor is of an instant before a stamp."""
        items = decoded_messages([message], self.roles, self.cfg.tag_table, Problems(), self.cfg.limits)
        return any(item.stamp_ns < end_stamp_ns for item in items if ROLES[item.role].kind not in LATCHED_KINDS)
