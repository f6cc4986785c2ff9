"""Sorts messages by log time with bounded memory, for logs whose file and index are not in order.

Messages that are nearly in order wait in memory for a while. All others are sorted on disk, in a temporary SQLite
database with bounded memory.
"""

import heapq
import sqlite3
import weakref
from collections.abc import Callable, Collection, Iterable, Iterator
from tempfile import gettempdir
from threading import Lock
from typing import Final, TypeVar

from roadperc_stream.log.records import Channel, Message
from roadperc_stream.log.stored import storing

T = TypeVar("T")
_SIGN: Final = 2**63
"""SQLite's integers have a sign, log times have none."""
_LATEST_NS: Final = 2**64 - 1
_SETUP: Final = (
    "PRAGMA journal_mode = OFF",
    "PRAGMA cache_size = -8192",
    "CREATE TABLE messages (log_time, number, publish_time, sequence, channel, data, "
    "PRIMARY KEY (log_time, number)) WITHOUT ROWID",
)
_PLACE: Final = "PRAGMA temp_store_directory = '{folder}'"
"""Without it, SQLite uses another folder than Python if TMPDIR is not set."""
_ADD: Final = "INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?)"
_FIND: Final = (
    "SELECT log_time, publish_time, sequence, channel, data FROM messages "
    "WHERE log_time BETWEEN ? AND ? AND {wanted} ORDER BY log_time, number"
)


def in_order_within(
    items: Iterable[T], time_of: Callable[[T], int], size_of: Callable[[T], int], most: int
) -> Iterator[T]:
    """Yield items by time, as far as a bounded buffer can sort them; those of equal time keep their order.

    ``most`` is the largest total size in the buffer; beyond it, the earliest item is yielded.
    """
    waiting: list[tuple[int, int, T]] = []
    held = 0
    for number, item in enumerate(items):
        heapq.heappush(waiting, (time_of(item), number, item))
        held += size_of(item)
        while held > most:
            first = heapq.heappop(waiting)[2]
            held -= size_of(first)
            yield first
    while waiting:
        yield heapq.heappop(waiting)[2]


class SortedMessages:
    """Sorts messages by log time when they are first read; those of equal time keep their order.

    ``what`` names the log in errors. ``unsorted`` returns the messages; each channel has its own ``source_id``.
    """

    def __init__(self, what: str, unsorted: Callable[[], Iterable[Message]]) -> None:
        self._what, self._unsorted = what, unsorted
        self._channels: dict[int, Channel] = {}
        self._database: sqlite3.Connection | None = None
        self._lock = Lock()

    def messages(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Message]:
        """Yield messages as ``reading.read``.

        Raises:
            TargetError: there is no space to store them, or the stored ones cannot be read.
        """
        with self._lock:
            database = self._database = self._database or self._stored()
        ids = [i for i, channel in self._channels.items() if topics is None or channel.topic in topics]
        wanted = "TRUE" if topics is None else f"channel IN ({', '.join(map(str, ids))})"
        first = max(start_ns or 0, 0)
        last = _LATEST_NS if end_ns is None else min(end_ns - 1, _LATEST_NS)
        if first > last:
            return
        with storing(self._what, "sorted"):
            for log_time, publish_time, sequence, channel_id, data in database.execute(
                _FIND.format(wanted=wanted), (first - _SIGN, last - _SIGN)
            ):
                channel = self._channels[channel_id]
                yield Message(channel, log_time + _SIGN, publish_time + _SIGN, sequence, data)

    def _stored(self) -> sqlite3.Connection:
        """Return the database with the messages."""
        database = sqlite3.connect("", isolation_level=None, check_same_thread=False)
        try:
            with storing(self._what, "sorted"):
                folder = gettempdir().replace("'", "''")
                for statement in (_PLACE.format(folder=folder), *_SETUP, "BEGIN"):
                    database.execute(statement)
                database.executemany(_ADD, self._rows())
                database.execute("COMMIT")
        except BaseException:
            database.close()
            raise
        weakref.finalize(self, database.close)
        return database

    def _rows(self) -> Iterator[tuple[int, int, int, int, int, bytes]]:
        for number, message in enumerate(self._unsorted()):
            channel_id = message.channel.source_id
            self._channels[channel_id] = message.channel
            log_time, publish_time = message.log_time_ns - _SIGN, message.publish_time_ns - _SIGN
            yield log_time, number, publish_time, message.sequence, channel_id, message.data
