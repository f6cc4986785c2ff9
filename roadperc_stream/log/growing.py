"""Reads a log while it is written: finished chunks from the file, the open chunk from memory."""

import heapq
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import count, islice
from pathlib import Path
from threading import Lock

from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from roadperc_stream.errors import LogError
from roadperc_stream.log.chunks import unpacked
from roadperc_stream.log.index import is_within, may_hold, share_channels
from roadperc_stream.log.layout import UNREADABLE, chunk_of, message_head, records_in
from roadperc_stream.log.records import Channel, Message


@dataclass
class GrowingLog:
    """The log that a ``LogWriter`` is writing, for one reader in another thread.

    It keeps position, channels and time span of each chunk, and the messages of the open one. It needs memory for a
    few chunks, whatever the log's length. Messages come in log-time order, up to the time that the writer has reached.
    A chunk copied unchanged may have later messages, because results are written between them afterwards.
    """

    path: Path
    """The file: under its temporary name, then under its final one."""
    _channels: dict[int, Channel]
    """The channels registered, by id."""
    _chunks: list[ChunkIndex] = field(default_factory=list)
    _channel_sets: dict[frozenset[int], dict[int, int]] = field(default_factory=dict)
    _open: list[Message] = field(default_factory=list)
    _reached_ns: int | None = None
    _complete: bool = False
    _lock: Lock = field(default_factory=Lock)

    def __post_init__(self) -> None:
        self.channels = tuple(self._channels.values())
        """The channels registered when reading began."""

    def add_channel(self, channel_id: int, channel: Channel) -> None:
        """Add a channel."""
        with self._lock:
            self._channels[channel_id] = channel

    def append(self, message: Message) -> None:
        """Add a message of the open chunk."""
        with self._lock:
            self._open.append(message)
            self._reached_ns = max(message.log_time_ns, self._reached_ns or 0)

    def add_chunk(self, chunk: ChunkIndex) -> None:
        """Add a chunk that is now in the file: the open one, or a copied one."""
        share_channels(chunk, self._channel_sets)
        with self._lock:
            self._chunks.append(chunk)
            self._open.clear()

    def reach(self, log_time_ns: int) -> None:
        """Declare that all messages up to a log time are written, except results."""
        with self._lock:
            self._reached_ns = max(log_time_ns, self._reached_ns or 0)

    def finish(self, temporary: Path, final: Path) -> None:
        """Rename the complete file to its final name; reading waits until this is done."""
        with self._lock:
            temporary.replace(final)
            self.path, self._complete = final, True
            self._reached_ns = max((chunk.message_end_time for chunk in self._chunks), default=None)

    def progress(self) -> tuple[int | None, bool]:
        """Return the log time reached, None before the first message, and whether the log is complete."""
        with self._lock:
            return self._reached_ns, self._complete

    def read(
        self, *, topics: Collection[str] | None = None, start_ns: int = 0, end_ns: int | None = None
    ) -> Iterator[Message]:
        """Yield the messages written until now, as ``log.read`` does for a finished log.

        Raises:
            LogError: the file cannot be read.
        """
        for message in self._found(topics, start_ns, end_ns):
            if message is None:
                return
            yield message

    def follow(self, start_ns: int) -> Iterator[Message | None]:
        """Yield all messages from a log time on, until the log is complete; None when no message is ready yet.

        Raises:
            LogError: the file cannot be read.
        """
        return self._found(None, start_ns, None)

    def _found(self, topics: Collection[str] | None, start_ns: int, end_ns: int | None) -> Iterator[Message | None]:
        waiting: list[tuple[int, int, Message]] = []  # by log time, then in the order of reading
        numbers, chunk_index, taken = count(), 0, 0

        def add(messages: Iterable[Message]) -> None:
            for message in messages:
                in_time = is_within(message.log_time_ns, start_ns, end_ns)
                if in_time and (topics is None or message.channel.topic in topics):
                    heapq.heappush(waiting, (message.log_time_ns, next(numbers), message))

        while True:
            with self._lock:
                chunk = self._chunks[chunk_index] if chunk_index < len(self._chunks) else None
                tail = () if chunk else tuple(self._open[taken:])
                complete, reached_ns = self._complete, self._reached_ns or 0
                wanted = {i for i, channel in self._channels.items() if topics is None or channel.topic in topics}
            if chunk is not None:
                if may_hold(chunk, wanted, start_ns, end_ns):
                    yield from _through(waiting, min(chunk.message_start_time, reached_ns))
                    add(islice(self._load(chunk), taken, None))
                chunk_index, taken = chunk_index + 1, 0
                continue
            add(tail)
            taken += len(tail)
            if waiting and waiting[0][0] <= reached_ns:  # while they are consumed, more may come
                yield from _through(waiting, reached_ns)
            elif complete:
                return
            else:
                yield None

    def _load(self, chunk: ChunkIndex) -> Iterator[Message]:
        try:
            with self._lock, self.path.open("rb") as stream:
                stream.seek(chunk.chunk_start_offset)
                data = stream.read(chunk.chunk_length)
            for item in records_in(unpacked(chunk_of(data))):
                if item.opcode == Opcode.MESSAGE:
                    head = message_head(item.body)
                    yield head.of(self._channels[head.channel_id], item.body)
        except OSError as error:
            raise LogError(f"{self.path}: {error.strerror or error}") from error
        except UNREADABLE as error:
            raise LogError(f"{self.path}: damaged MCAP: {error}") from error


def _through(waiting: list[tuple[int, int, Message]], log_time_ns: int) -> Iterator[Message]:
    """Remove and yield the messages up to a log time."""
    while waiting and waiting[0][0] <= log_time_ns:
        yield heapq.heappop(waiting)[2]
