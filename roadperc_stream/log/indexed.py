"""Reads a log by its index, chunk by chunk, in log-time order.

The mcap library's reader copies every byte three times and reads the index again for each pass. Format:
https://mcap.dev/spec.
"""

import heapq
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import accumulate, chain, groupby
from typing import IO, Final

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from mcap.records import Schema as McapSchema

from roadperc_stream.config import LimitsConfig
from roadperc_stream.log import layout
from roadperc_stream.log.chunks import INSIDE, unpacked
from roadperc_stream.log.damage import damaged, unopened
from roadperc_stream.log.index import MOST_HELD_BYTES, channel_of, held_bytes, is_within, may_hold
from roadperc_stream.log.mcap_file import ChunkRecords, Piece
from roadperc_stream.log.records import Channel, Message
from roadperc_stream.log.recovery import Salvage, damage_in
from roadperc_stream.log.sorting import SortedMessages
from roadperc_stream.log.stored import LogFile

_MOST_WHOLE_BYTES: Final = 16 * 1024 * 1024
"""Largest chunk that is copied unchanged: a reader of the copy keeps it in memory together with its results."""
_NEVER_NS: Final = 2**64


@contextmanager
def opened(file: LogFile, limits: LimitsConfig) -> Iterator[IO[bytes]]:
    """Open a log that was checked.

    Raises:
        LogError: the file cannot be read, or is damaged now.
    """
    try:
        with file.path.open("rb") as stream:
            yield stream
    except OSError as error:
        raise unopened(file.name, error) from error
    except layout.UNREADABLE as error:
        found = Salvage(file, limits=limits).run()
        raise (damaged(file.name, f"damaged MCAP: {error}") if found.whole else damage_in(found)) from error


@dataclass(frozen=True)
class IndexedFile:
    """A checked log that is read by its index, or sorted on disk if that would take too much memory."""

    found: Salvage
    """The finished account."""
    in_order: SortedMessages
    """All messages, for reading that would take too much memory by the index."""
    _seen: dict[int, frozenset[tuple[int, int]] | None] = field(default_factory=dict, compare=False, repr=False)
    """Opcode and id of what the chunks already read describe, by their first byte; None if a chunk is not tidy."""

    @property
    def channels(self) -> Mapping[int, Channel]:
        """By ``Channel.source_id``."""
        return self.found.channels

    @property
    def chunks(self) -> Sequence[ChunkIndex]:
        """In file order."""
        return self.found.index

    def messages(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Message]:
        """Yield messages as ``reading.read`` does."""
        wanted = frozenset(i for i, channel in self.channels.items() if topics is None or channel.topic in topics)
        chunks = self._holding(wanted, start_ns, end_ns)
        if held_bytes(chunks) > MOST_HELD_BYTES:
            yield from self.in_order.messages(topics, start_ns, end_ns)
            return
        with opened(self.found.file, self.found.limits) as stream:
            yield from self._in_order(stream, chunks, wanted, start_ns, end_ns)

    def pieces(self, kept: frozenset[int], start_ns: int | None, end_ns: int | None) -> Iterator[Piece]:
        """Yield pieces as ``reading.pieces`` does, of channels by id; only tidy chunks are unchanged."""
        chunks = self._holding(kept, start_ns, end_ns)
        if held_bytes(chunks) > MOST_HELD_BYTES:
            messages = self.in_order.messages({self.channels[i].topic for i in kept}, start_ns, end_ns)
            yield from (message for message in messages if message.channel.source_id in kept)
            return
        with opened(self.found.file, self.found.limits) as stream:
            whole = {_start(chunk) for chunk in apart(chunks) if _lies_in(chunk, kept, start_ns, end_ns)}
            for is_whole, group in groupby(chunks, key=lambda chunk: _start(chunk) in whole):
                if is_whole:
                    yield from chain.from_iterable(self._as_is(stream, chunk, kept) for chunk in group)
                else:
                    yield from self._in_order(stream, group, kept, start_ns, end_ns)

    def _as_is(self, stream: IO[bytes], chunk: ChunkIndex, kept: frozenset[int]) -> Iterator[Piece]:
        """Yield a chunk unchanged, or its messages if it is not tidy or describes other channels."""
        if _start(chunk) not in self._seen:
            self._records(stream, chunk)
        described, channels = self._seen[_start(chunk)], [self.channels[i] for i in kept]
        known = {(int(Opcode.SCHEMA), c.schema_id) for c in channels} | {(int(Opcode.CHANNEL), i) for i in kept}
        if described is None or not described <= known:
            yield from self._in_order(stream, [chunk], kept, None, None)
            return
        record = _record(stream, chunk)
        yield ChunkRecords(record, _taken(stream, chunk.message_index_length)).with_crc()

    def _holding(self, wanted: Collection[int], start_ns: int | None, end_ns: int | None) -> list[ChunkIndex]:
        return [chunk for chunk in self.chunks if may_hold(chunk, wanted, start_ns, end_ns)]

    def _in_order(
        self,
        stream: IO[bytes],
        chunks: Iterable[ChunkIndex],
        wanted: Collection[int],
        start_ns: int | None,
        end_ns: int | None,
    ) -> Iterator[Message]:
        """Yield the messages of chunks by log time; those of equal time in file order."""
        coming = sorted(chunks, key=_place, reverse=True)
        waiting: list[tuple[int, int, int, bytes | memoryview]] = []
        while coming or waiting:
            if coming and (not waiting or _place(coming[-1]) < waiting[0][:2]):
                chunk = coming.pop()
                for number, record in enumerate(self._records(stream, chunk)):
                    if record.opcode != Opcode.MESSAGE:
                        continue
                    head = layout.message_head(record.body)
                    if head.channel_id not in self.channels:
                        raise McapError(f"no channel record found with id {head.channel_id}")
                    if head.channel_id in wanted and is_within(head.log_time_ns, start_ns, end_ns):
                        heapq.heappush(waiting, (head.log_time_ns, _start(chunk), number, record.body))
            else:
                body = heapq.heappop(waiting)[3]
                head = layout.message_head(body)
                yield head.of(self.channels[head.channel_id], body)

    def _records(self, stream: IO[bytes], chunk: ChunkIndex) -> list[layout.Record]:
        """Return the records of a chunk, and remember what it describes."""
        head = layout.chunk_of(_record(stream, chunk))
        found = list(layout.records_in(unpacked(head)))
        if _start(chunk) not in self._seen:
            messages = [layout.message_head(item.body) for item in found if item.opcode == Opcode.MESSAGE]
            others = [item for item in found if item.opcode != Opcode.MESSAGE]
            times = [message.log_time_ns for message in messages]
            is_in_order = times == sorted(times) and times[:1] + times[-1:] == [head.first_ns, head.last_ns]
            is_indexed = {message.channel_id for message in messages} == chunk.message_index_offsets.keys()
            is_tidy = is_in_order and is_indexed and all(map(self._is_known, others))
            described = frozenset((item.opcode, int.from_bytes(item.body[:2], "little")) for item in others)
            self._seen[_start(chunk)] = described if is_tidy else None
        return found

    def _is_known(self, item: layout.Record) -> bool:
        """Return whether a record of a chunk equals a channel or a schema of the log."""
        if item.opcode not in INSIDE:
            return False
        known, found = self.found.described, layout.parse(item.opcode, bytes(item.body))
        if isinstance(found, McapSchema):
            return known.schemas.get(found.id) == found
        channel, other = channel_of(found, known.schemas.get(found.schema_id)), known.channels.get(found.id)
        return other is not None and (channel, channel.schema_id) == (other, other.schema_id)


def _lies_in(chunk: ChunkIndex, kept: frozenset[int], start_ns: int | None, end_ns: int | None) -> bool:
    """Return whether all messages of a chunk have these channels and times, and it is small enough to copy."""
    ends_ns = chunk.message_start_time, chunk.message_end_time
    in_time = all(is_within(log_time_ns, start_ns, end_ns) for log_time_ns in ends_ns)
    channels = chunk.message_index_offsets.keys()
    return in_time and bool(channels) and channels <= kept and chunk.uncompressed_size <= _MOST_WHOLE_BYTES


def apart(chunks: Sequence[ChunkIndex]) -> Iterator[ChunkIndex]:
    """Yield the chunks whose times overlap no other chunk and that are in log-time order among all.

    ``chunks`` are in file order.
    """
    behind = accumulate((chunk.message_start_time for chunk in reversed(chunks[1:])), min, initial=_NEVER_NS)
    latest_ns = 0
    for chunk, next_ns in zip(chunks, reversed(list(behind)), strict=False):
        if latest_ns <= chunk.message_start_time and chunk.message_end_time <= next_ns:
            yield chunk
        latest_ns = max(latest_ns, chunk.message_end_time)


def _start(chunk: ChunkIndex) -> int:
    return chunk.chunk_start_offset


def _place(chunk: ChunkIndex) -> tuple[int, int]:
    """Return the key of the reading order."""
    return chunk.message_start_time, chunk.chunk_start_offset


def _record(stream: IO[bytes], chunk: ChunkIndex) -> bytes:
    stream.seek(chunk.chunk_start_offset)
    return _taken(stream, chunk.chunk_length)


def _taken(stream: IO[bytes], length: int) -> bytes:
    data = stream.read(length)
    if len(data) < length:
        raise McapError(f"expected {length} bytes, found {len(data)}")
    return data
