"""A log that is read by its index, chunk by chunk, in the order of log time.

The library's reader copies every byte three times and reads the index anew for each pass. Layout:
https://mcap.dev/spec.
"""

import heapq
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
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
from roadperc_stream.log.audit import opened
from roadperc_stream.log.chunks import Unpacked, unpacked
from roadperc_stream.log.index import channel_of, most_at_once
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

_MOST_WHOLE_BYTES: Final = 16 * 1024 * 1024
"""Of the data of a chunk that is copied as it is: who reads the copy holds it beside the results of its time."""
_NEVER_NS: Final = 2**64
IndexEntry = tuple[int, int, int]
"""Channel and log time of a message, and its place in the chunk's data."""


@dataclass(frozen=True, slots=True)
class IndexedChunk:
    """Where a chunk stands, and what it holds, as the index says."""

    start: int
    length: int
    """Of its record."""
    index_length: int
    """Of its message indexes, which follow it."""
    first_ns: int
    last_ns: int
    size_bytes: int
    channels: frozenset[int]
    """Those with messages in it; empty where it has no message indexes."""

    def lies_in(self, channels: frozenset[int], start_ns: int | None, end_ns: int | None) -> bool:
        """Whether all its messages are of these channels and times, and it is none too large to be held as it is."""
        in_time = (start_ns is None or self.first_ns >= start_ns) and (end_ns is None or self.last_ns < end_ns)
        return in_time and bool(self.channels) and self.channels <= channels and self.size_bytes <= _MOST_WHOLE_BYTES

    def may_hold(self, wanted: Collection[int], start_ns: int, end_ns: int | None) -> bool:
        """Whether a message of these channels and times can be in it."""
        in_time = self.last_ns >= start_ns and (end_ns is None or self.first_ns < end_ns)
        return in_time and (not self.channels or not self.channels.isdisjoint(wanted))


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
    """A log that is read by its index. What was said of its chunks and bytes was checked before."""

    path: Path
    check_chunks: bool
    """Whether their CRCs have not been checked yet."""
    limits: LimitsConfig
    channels: Mapping[int, Channel]
    """By ``Channel.source_id``."""
    chunks: tuple[IndexedChunk, ...]
    """In the order of the file."""
    _descriptions: Mapping[tuple[int, int], McapRecord]
    """The index's channels and schemas, by opcode and id."""
    _seen: dict[int, ChunkContents] = field(default_factory=dict, compare=False, repr=False)
    """Of chunks that have been read, by their first byte."""

    @classmethod
    def of(cls, path: Path, index: Summary, limits: LimitsConfig, *, check_chunks: bool) -> "IndexedFile":
        """A log with its index."""
        known = {number: channel_of(c, index.schemas.get(c.schema_id)) for number, c in sorted(index.channels.items())}
        groups: dict[frozenset[int], frozenset[int]] = {}
        ordered = sorted(index.chunk_indexes, key=lambda entry: entry.chunk_start_offset)
        chunks = tuple(_indexed(entry, groups) for entry in ordered)
        descriptions: dict[tuple[int, int], McapRecord] = {(Opcode.SCHEMA, i): s for i, s in index.schemas.items()}
        descriptions |= {(Opcode.CHANNEL, i): channel for i, channel in index.channels.items()}
        return cls(path, check_chunks, limits, known, chunks, descriptions)

    @property
    def schema_ids(self) -> dict[int, int]:
        """Of the channels' schemas, by ``Channel.source_id``; 0 of those without."""
        found = self._descriptions.values()
        return {item.id: item.schema_id for item in found if isinstance(item, McapChannel)}

    def messages(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> Iterator[Message]:
        """As ``reading.read``."""
        wanted = self._wanted(topics)
        with opened(self.path, self.limits) as stream:
            yield from self._in_order(stream, self._holding(wanted, start_ns, end_ns), wanted, start_ns, end_ns)

    def pieces(self, kept: frozenset[int], start_ns: int | None, end_ns: int | None) -> Iterator[Piece]:
        """The messages of some channels, whole chunks where they hold nothing else and nobody need look inside.

        Args:
            kept: ids of the channels.
            start_ns: first log time read.
            end_ns: first log time no longer read.
        """
        chunks = list(self._holding(kept, start_ns, end_ns))
        with opened(self.path, self.limits) as stream:
            whole = {chunk.start for chunk in apart(chunks) if chunk.lies_in(kept, start_ns, end_ns)}
            for is_whole, group in groupby(chunks, key=lambda chunk: chunk.start in whole):
                if is_whole:
                    yield from chain.from_iterable(self._as_is(stream, chunk, kept) for chunk in group)
                else:
                    yield from self._in_order(stream, group, kept, start_ns, end_ns)

    def _as_is(self, stream: IO[bytes], chunk: IndexedChunk, kept: frozenset[int]) -> Iterator[Piece]:
        """A chunk as it stands in the file, or its messages where it is not tidy."""
        if chunk.start not in self._seen:
            deque(self._bodies(stream, chunk), maxlen=0)
        contents = self._seen[chunk.start]
        if contents.is_tidy and contents.described <= self._known_by(kept):
            indexes_at = chunk.start + chunk.length
            found = ChunkRecords(
                _read(stream, chunk.start, chunk.length), _read(stream, indexes_at, chunk.index_length)
            )
            yield found if found.crc else found.with_crc(contents.crc)
        else:
            yield from self._in_order(stream, [chunk], kept, None, None)

    def _known_by(self, kept: frozenset[int]) -> frozenset[tuple[int, int]]:
        """What may be described where only these channels, with their schemas, are known."""
        ids = self.schema_ids
        schemas = {(int(Opcode.SCHEMA), ids[i]) for i in kept}
        return frozenset(schemas | {(int(Opcode.CHANNEL), i) for i in kept})

    def held_bytes(self, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None) -> int:
        """The most that is held in memory when these are read: chunks that overlap in time."""
        chunks = self._holding(self._wanted(topics), start_ns, end_ns)
        return most_at_once((chunk.first_ns, chunk.last_ns, chunk.size_bytes) for chunk in chunks)

    def _wanted(self, topics: Collection[str] | None) -> frozenset[int]:
        return frozenset(i for i, channel in self.channels.items() if topics is None or channel.topic in topics)

    def _holding(self, wanted: Collection[int], start_ns: int | None, end_ns: int | None) -> Iterator[IndexedChunk]:
        return (chunk for chunk in self.chunks if chunk.may_hold(wanted, start_ns or 0, end_ns))

    def _in_order(
        self,
        stream: IO[bytes],
        chunks: Iterable[IndexedChunk],
        wanted: Collection[int],
        start_ns: int | None,
        end_ns: int | None,
    ) -> Iterator[Message]:
        """The messages of chunks by log time, those of equal time in the order of the file."""
        coming = sorted(chunks, key=lambda chunk: (chunk.first_ns, chunk.start), reverse=True)
        waiting: list[tuple[int, int, int, memoryview]] = []
        while coming or waiting:
            if coming and (not waiting or (coming[-1].first_ns, coming[-1].start) < waiting[0][:2]):
                chunk = coming.pop()
                for number, body in enumerate(self._bodies(stream, chunk)):
                    head = message_head(body)
                    if head.channel_id not in self.channels:
                        raise McapError(f"no channel record found with id {head.channel_id}")
                    if head.channel_id in wanted and _is_within(head.log_time_ns, start_ns, end_ns):
                        heapq.heappush(waiting, (head.log_time_ns, chunk.start, number, body))
            else:
                body = heapq.heappop(waiting)[3]
                head = message_head(body)
                yield head.of(self.channels[head.channel_id], body)

    def _bodies(self, stream: IO[bytes], chunk: IndexedChunk) -> Iterator[memoryview]:
        """The message records of a chunk; what else stands in it is skipped."""
        head = chunk_of(_read(stream, chunk.start, chunk.length))
        found = unpacked(head, check_crc=self.check_chunks)
        others, entries = list[tuple[int, memoryview]](), list[IndexEntry]()
        for item in records_in(found.data):
            if item.opcode == Opcode.MESSAGE:
                message = message_head(item.body)
                entries.append((message.channel_id, message.log_time_ns, item.offset))
                yield item.body
            else:
                others.append((item.opcode, item.body))
        if chunk.start not in self._seen:
            indexes = _read(stream, chunk.start + chunk.length, chunk.index_length)
            is_indexed = _in_order_and_indexed(entries, message_indexes(indexes))
            times = [time_ns for _, time_ns, _ in entries]
            span_ns = (min(times), max(times)) if times else None
            is_tidy = is_indexed and span_ns == (head.first_ns, head.last_ns)
            self._seen[chunk.start] = self._contents(head, found, others, is_tidy=is_tidy)

    def _contents(
        self, head: ChunkHead, found: Unpacked, others: Sequence[tuple[int, memoryview]], *, is_tidy: bool
    ) -> ChunkContents:
        """What there is to know of a chunk, from its data, the records besides messages, and whether those are tidy."""
        crc, described = crc32(found.data), [(opcode, int.from_bytes(body[:2], "little")) for opcode, body in others]
        is_known = all(self._describes(key, body) for key, (_, body) in zip(described, others, strict=True))
        is_as_said = found.is_plain and head.crc in {0, crc}
        return ChunkContents(crc, is_tidy and is_known and is_as_said, frozenset(described))

    def _describes(self, key: tuple[int, int], body: memoryview) -> bool:
        """Whether a record of a chunk is a channel or a schema of the index."""
        known = self._descriptions.get(key)
        try:
            return known is not None and parse(key[0], bytes(body), spare_allowed=True) == known
        except UNREADABLE:
            return False


def apart(chunks: Sequence[IndexedChunk]) -> Iterator[IndexedChunk]:
    """The chunks before which all others in front end, and behind whose end all others behind begin.

    Args:
        chunks: in the order of the file.
    """
    behind = accumulate((chunk.first_ns for chunk in reversed(chunks[1:])), min, initial=_NEVER_NS)
    latest_ns = 0
    for chunk, next_ns in zip(chunks, reversed(list(behind)), strict=False):
        if latest_ns <= chunk.first_ns and chunk.last_ns <= next_ns:
            yield chunk
        latest_ns = max(latest_ns, chunk.last_ns)


def _in_order_and_indexed(entries: Sequence[IndexEntry], indexes: Sequence[MessageIndex]) -> bool:
    """Whether messages stand in the order of log time, and one message index of each channel names them all."""
    in_order = all(earlier[1] <= later[1] for earlier, later in pairwise(entries))
    channels = [index.channel_id for index in indexes]
    said = sorted((index.channel_id, *entry) for index in indexes for entry in index.entries)
    return in_order and len(channels) == len(set(channels)) and sorted(entries) == said


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


def _indexed(entry: ChunkIndex, groups: dict[frozenset[int], frozenset[int]]) -> IndexedChunk:
    """A chunk by its entry; of equal sets of channels, which most chunks have, one is kept in ``groups``."""
    channels = frozenset(entry.message_index_offsets)
    return IndexedChunk(
        entry.chunk_start_offset,
        entry.chunk_length,
        entry.message_index_length,
        entry.message_start_time,
        entry.message_end_time,
        entry.uncompressed_size,
        groups.setdefault(channels, channels),
    )


def _is_within(log_time_ns: int, start_ns: int | None, end_ns: int | None) -> bool:
    return (start_ns is None or log_time_ns >= start_ns) and (end_ns is None or log_time_ns < end_ns)
