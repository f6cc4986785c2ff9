"""A log that is read by its index, chunk by chunk, in the order of log time.

The library's reader copies every byte three times and reads the index again for each pass. Layout:
https://mcap.dev/spec.
"""

import heapq
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate, chain, groupby, pairwise
from pathlib import Path
from typing import IO, Final

from deflate import crc32
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import ChunkIndex, McapRecord
from mcap.summary import Summary

from roadperc_stream.config import LimitsConfig
from roadperc_stream.log.audit import in_file_order, opened
from roadperc_stream.log.chunks import Unpacked, unpacked
from roadperc_stream.log.index import MOST_HELD_BYTES, channel_of, held_bytes, is_within, may_hold, share_channels
from roadperc_stream.log.layout import (
    UNREADABLE,
    ChunkHead,
    MessageIndex,
    chunk_of,
    message_head,
    message_indexes,
    parse,
    records_in,
)
from roadperc_stream.log.mcap_file import ChunkRecords, Piece
from roadperc_stream.log.records import Channel, Message
from roadperc_stream.log.sorting import SortedMessages

_MOST_WHOLE_BYTES: Final = 16 * 1024 * 1024
"""Of the data of a chunk that is copied as it is: a reader of the copy holds it beside the results of its time."""
_NEVER_NS: Final = 2**64
IndexEntry = tuple[int, int, int]
"""Channel and log time of a message, and its place in the chunk's data."""


@dataclass(frozen=True, slots=True)
class ChunkContents:
    """What only a look into a chunk shows."""

    crc: int
    """Of its data."""
    is_tidy: bool
    """Whether it and its message indexes are as they say, and its messages stand in the order of log time."""
    described: frozenset[tuple[int, int]]
    """Opcode and id of the channels and schemas that are described in it, as the index describes them."""


@dataclass(frozen=True)
class IndexedFile:
    """A log that is read by its index where that takes little memory, and is put in order on disk for the rest.

    What was said of its chunks and bytes was checked before.
    """

    path: Path
    check_chunks: bool
    """Whether their CRCs have not been checked yet."""
    limits: LimitsConfig
    channels: Mapping[int, Channel]
    """By ``Channel.source_id``."""
    chunks: tuple[ChunkIndex, ...]
    """In the order of the file."""
    in_order: SortedMessages
    """All of it, where the index would take too much memory."""
    _descriptions: Mapping[tuple[int, int], McapRecord]
    """The index's channels and schemas, by opcode and id."""
    _seen: dict[int, ChunkContents] = field(default_factory=dict, compare=False, repr=False)
    """Of chunks that have been read, by their first byte."""

    @classmethod
    def of(cls, path: Path, index: Summary, limits: LimitsConfig, *, check_chunks: bool) -> "IndexedFile":
        """A log with its index."""
        known = {number: channel_of(c, index.schemas.get(c.schema_id)) for number, c in sorted(index.channels.items())}
        chunks = tuple(sorted(index.chunk_indexes, key=_start))
        shared: dict[frozenset[int], dict[int, int]] = {}
        for chunk in chunks:
            share_channels(chunk, shared)
        descriptions: dict[tuple[int, int], McapRecord] = {(Opcode.SCHEMA, i): s for i, s in index.schemas.items()}
        descriptions |= {(Opcode.CHANNEL, i): channel for i, channel in index.channels.items()}
        in_order = SortedMessages(str(path), partial(in_file_order, path, limits))
        return cls(path, check_chunks, limits, known, chunks, in_order, descriptions)

    @property
    def schema_ids(self) -> dict[int, int]:
        """Of the channels' schemas, by ``Channel.source_id``; 0 of those without."""
        found = self._descriptions.values()
        return {item.id: item.schema_id for item in found if isinstance(item, McapChannel)}

    def messages(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Message]:
        """As ``reading.read``."""
        wanted = frozenset(i for i, channel in self.channels.items() if topics is None or channel.topic in topics)
        chunks = self._holding(wanted, start_ns, end_ns)
        if held_bytes(chunks) > MOST_HELD_BYTES:
            yield from self.in_order.messages(topics, start_ns, end_ns)
            return
        with opened(self.path, self.limits) as stream:
            yield from self._in_order(stream, chunks, wanted, start_ns, end_ns)

    def pieces(self, kept: frozenset[int], start_ns: int | None, end_ns: int | None) -> Iterator[Piece]:
        """As ``reading.pieces``, of channels by their ids; only tidy chunks are given whole."""
        chunks = self._holding(kept, start_ns, end_ns)
        if held_bytes(chunks) > MOST_HELD_BYTES:
            messages = self.in_order.messages({self.channels[i].topic for i in kept}, start_ns, end_ns)
            yield from (message for message in messages if message.channel.source_id in kept)
            return
        with opened(self.path, self.limits) as stream:
            whole = {_start(chunk) for chunk in apart(chunks) if _lies_in(chunk, kept, start_ns, end_ns)}
            for is_whole, group in groupby(chunks, key=lambda chunk: _start(chunk) in whole):
                if is_whole:
                    yield from chain.from_iterable(self._as_is(stream, chunk, kept) for chunk in group)
                else:
                    yield from self._in_order(stream, group, kept, start_ns, end_ns)

    def _as_is(self, stream: IO[bytes], chunk: ChunkIndex, kept: frozenset[int]) -> Iterator[Piece]:
        """A chunk as it is in the file, or its messages where it is not tidy."""
        if _start(chunk) not in self._seen:
            deque(self._bodies(stream, chunk), maxlen=0)
        contents = self._seen[_start(chunk)]
        if contents.is_tidy and contents.described <= self._known_by(kept):
            found = ChunkRecords(_record(stream, chunk), _indexes(stream, chunk))
            yield found if found.head.crc else found.with_crc(contents.crc)
        else:
            yield from self._in_order(stream, [chunk], kept, None, None)

    def _known_by(self, kept: frozenset[int]) -> frozenset[tuple[int, int]]:
        """What may be described where only these channels, with their schemas, are known."""
        ids = self.schema_ids
        schemas = {(int(Opcode.SCHEMA), ids[i]) for i in kept}
        return frozenset(schemas | {(int(Opcode.CHANNEL), i) for i in kept})

    def held_bytes(self) -> int:
        """The most that reading all of it by the index holds in memory."""
        return held_bytes(self.chunks)

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
        """The messages of chunks by log time, those of equal time in the order of the file."""
        coming = sorted(chunks, key=_place, reverse=True)
        waiting: list[tuple[int, int, int, bytes | memoryview]] = []
        while coming or waiting:
            if coming and (not waiting or _place(coming[-1]) < waiting[0][:2]):
                chunk = coming.pop()
                for number, body in enumerate(self._bodies(stream, chunk)):
                    head = message_head(body)
                    if head.channel_id not in self.channels:
                        raise McapError(f"no channel record found with id {head.channel_id}")
                    if head.channel_id in wanted and is_within(head.log_time_ns, start_ns, end_ns):
                        heapq.heappush(waiting, (head.log_time_ns, _start(chunk), number, body))
            else:
                body = heapq.heappop(waiting)[3]
                head = message_head(body)
                yield head.of(self.channels[head.channel_id], body)

    def _bodies(self, stream: IO[bytes], chunk: ChunkIndex) -> Iterator[bytes | memoryview]:
        """The message records of a chunk; other records are skipped."""
        head = chunk_of(_record(stream, chunk))
        found = unpacked(head, check_crc=self.check_chunks)
        others, entries = list[tuple[int, bytes | memoryview]](), list[IndexEntry]()
        for item in records_in(found.data):
            if item.opcode == Opcode.MESSAGE:
                message = message_head(item.body)
                entries.append((message.channel_id, message.log_time_ns, item.start))
                yield item.body
            else:
                others.append((item.opcode, item.body))
        if _start(chunk) not in self._seen:
            is_indexed = _in_order_and_indexed(entries, message_indexes(_indexes(stream, chunk)))
            times = [time_ns for _, time_ns, _ in entries]
            span_ns = (min(times), max(times)) if times else None
            is_tidy = is_indexed and span_ns == (head.first_ns, head.last_ns)
            self._seen[_start(chunk)] = self._contents(head, found, others, is_tidy=is_tidy)

    def _contents(
        self, head: ChunkHead, found: Unpacked, others: Sequence[tuple[int, bytes | memoryview]], *, is_tidy: bool
    ) -> ChunkContents:
        """What there is to know of a chunk, from its data, the records besides messages, and whether those are tidy."""
        crc, described = crc32(found.data), [(opcode, int.from_bytes(body[:2], "little")) for opcode, body in others]
        is_known = all(self._describes(key, body) for key, (_, body) in zip(described, others, strict=True))
        is_as_said = found.is_plain and head.crc in {0, crc}
        return ChunkContents(crc, is_tidy and is_known and is_as_said, frozenset(described))

    def _describes(self, key: tuple[int, int], body: bytes | memoryview) -> bool:
        """Whether a record of a chunk is a channel or a schema of the index."""
        known = self._descriptions.get(key)
        try:
            return known is not None and parse(key[0], bytes(body), spare_allowed=True) == known
        except UNREADABLE:
            return False


def _lies_in(chunk: ChunkIndex, kept: frozenset[int], start_ns: int | None, end_ns: int | None) -> bool:
    """Whether all messages of a chunk are of these channels and times, and it is small enough to be held as it is."""
    ends_ns = chunk.message_start_time, chunk.message_end_time
    in_time = all(is_within(log_time_ns, start_ns, end_ns) for log_time_ns in ends_ns)
    channels = chunk.message_index_offsets.keys()
    return in_time and bool(channels) and channels <= kept and chunk.uncompressed_size <= _MOST_WHOLE_BYTES


def apart(chunks: Sequence[ChunkIndex]) -> Iterator[ChunkIndex]:
    """The chunks before which all others in front end, and behind whose end all others behind begin.

    Args:
        chunks: in the order of the file.
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
    """In the order of reading."""
    return chunk.message_start_time, chunk.chunk_start_offset


def _in_order_and_indexed(entries: Sequence[IndexEntry], indexes: Sequence[MessageIndex]) -> bool:
    """Whether messages stand in the order of log time, and one message index of each channel names them all."""
    in_order = all(earlier[1] <= later[1] for earlier, later in pairwise(entries))
    channels = [index.channel_id for index in indexes]
    said = sorted((index.channel_id, *entry) for index in indexes for entry in index.entries)
    return in_order and len(channels) == len(set(channels)) and sorted(entries) == said


def _record(stream: IO[bytes], chunk: ChunkIndex) -> bytes:
    return _read(stream, chunk.chunk_start_offset, chunk.chunk_length)


def _indexes(stream: IO[bytes], chunk: ChunkIndex) -> bytes:
    return _read(stream, chunk.chunk_start_offset + chunk.chunk_length, chunk.message_index_length)


def _read(stream: IO[bytes], start: int, length: int) -> bytes:
    """Some bytes of a file.

    Raises:
        McapError: it has fewer, now.
    """
    stream.seek(start)
    data = stream.read(length)
    if len(data) < length:
        raise McapError(f"{length} bytes expected at byte {start}, {len(data)} are left")
    return data
