"""Reads a log by its index, chunk by chunk, in log-time order.

The mcap library's reader copies every byte three times and reads the index again for each pass. Format:
https://mcap.dev/spec.
"""

import heapq
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, chain, groupby, pairwise
from typing import Final

from deflate import crc32
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import ChunkIndex
from mcap.records import Schema as McapSchema

from roadperc_stream.log import layout
from roadperc_stream.log.chunks import INSIDE, Unpacked, unpacked
from roadperc_stream.log.file_order import opened
from roadperc_stream.log.index import MOST_HELD_BYTES, channel_of, held_bytes, is_within, may_hold
from roadperc_stream.log.limits import GuardedFile
from roadperc_stream.log.mcap_file import ChunkRecords, Piece
from roadperc_stream.log.records import Channel, Message
from roadperc_stream.log.recovery import Salvage
from roadperc_stream.log.sorting import SortedMessages

_MOST_WHOLE_BYTES: Final = 16 * 1024 * 1024
"""Largest chunk that is copied unchanged: a reader of the copy keeps it in memory together with its results."""
_NEVER_NS: Final = 2**64
Body = bytes | memoryview
"""The bytes of a record behind its length."""
IndexEntry = tuple[int, int, int]
"""A message's channel, log time and offset in the chunk's data."""


@dataclass(frozen=True, slots=True)
class ChunkContents:
    """Facts about a chunk that are known once it is decompressed."""

    crc: int
    """CRC of the chunk's data."""
    is_tidy: bool
    """Whether its fields and message indexes are correct, and its messages are in log-time order."""
    described: frozenset[tuple[int, int]]
    """Opcode and id of the channels and schemas described in it."""


@dataclass(frozen=True)
class IndexedFile:
    """A checked log that is read by its index, or sorted on disk if that would take too much memory."""

    found: Salvage
    """The finished account."""
    in_order: SortedMessages
    """All messages, for reading that would take too much memory by the index."""
    _seen: dict[int, ChunkContents] = field(default_factory=dict, compare=False, repr=False)
    """Contents of the chunks already read, by their first byte."""

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

    def _as_is(self, stream: GuardedFile, chunk: ChunkIndex, kept: frozenset[int]) -> Iterator[Piece]:
        """Yield a chunk unchanged, or its messages if it is not tidy."""
        if _start(chunk) not in self._seen:
            deque(self._bodies(stream, chunk), maxlen=0)
        contents = self._seen[_start(chunk)]
        if contents.is_tidy and contents.described <= self._known_by(kept):
            found = ChunkRecords(_record(stream, chunk), _indexes(stream, chunk))
            yield found if found.head.crc else found.with_crc(contents.crc)
        else:
            yield from self._in_order(stream, [chunk], kept, None, None)

    def _known_by(self, kept: frozenset[int]) -> frozenset[tuple[int, int]]:
        """Return opcode and id of these channels and their schemas."""
        schemas = {(int(Opcode.SCHEMA), self.channels[i].schema_id) for i in kept}
        return frozenset(schemas | {(int(Opcode.CHANNEL), i) for i in kept})

    def held_bytes(self) -> int:
        """Return the most memory that reading all of it by the index takes."""
        return held_bytes(self.chunks)

    def _holding(self, wanted: Collection[int], start_ns: int | None, end_ns: int | None) -> list[ChunkIndex]:
        return [chunk for chunk in self.chunks if may_hold(chunk, wanted, start_ns, end_ns)]

    def _in_order(
        self,
        stream: GuardedFile,
        chunks: Iterable[ChunkIndex],
        wanted: Collection[int],
        start_ns: int | None,
        end_ns: int | None,
    ) -> Iterator[Message]:
        """Yield the messages of chunks by log time; those of equal time in file order."""
        coming = sorted(chunks, key=_place, reverse=True)
        waiting: list[tuple[int, int, int, Body]] = []
        while coming or waiting:
            if coming and (not waiting or _place(coming[-1]) < waiting[0][:2]):
                chunk = coming.pop()
                for number, body in enumerate(self._bodies(stream, chunk)):
                    head = layout.message_head(body)
                    if head.channel_id not in self.channels:
                        raise McapError(f"no channel record found with id {head.channel_id}")
                    if head.channel_id in wanted and is_within(head.log_time_ns, start_ns, end_ns):
                        heapq.heappush(waiting, (head.log_time_ns, _start(chunk), number, body))
            else:
                body = heapq.heappop(waiting)[3]
                head = layout.message_head(body)
                yield head.of(self.channels[head.channel_id], body)

    def _bodies(self, stream: GuardedFile, chunk: ChunkIndex) -> Iterator[Body]:
        """Yield the message records of a chunk, and record its contents."""
        head = layout.chunk_of(_record(stream, chunk))
        found = unpacked(head)
        others, entries = list[tuple[int, Body]](), list[IndexEntry]()
        for item in layout.records_in(found.data):
            if item.opcode == Opcode.MESSAGE:
                message = layout.message_head(item.body)
                entries.append((message.channel_id, message.log_time_ns, item.start))
                yield item.body
            else:
                others.append((item.opcode, item.body))
        if _start(chunk) not in self._seen:
            is_indexed = _in_order_and_indexed(entries, layout.message_indexes(_indexes(stream, chunk)))
            times = [time_ns for _, time_ns, _ in entries]
            span_ns = (min(times), max(times)) if times else None
            is_tidy = is_indexed and span_ns == (head.first_ns, head.last_ns)
            self._seen[_start(chunk)] = self._contents(head, found, others, is_tidy=is_tidy)

    def _contents(
        self, head: layout.ChunkHead, found: Unpacked, others: Sequence[tuple[int, Body]], *, is_tidy: bool
    ) -> ChunkContents:
        """Return the contents of a chunk; ``others`` are its records except messages, ``is_tidy`` is for messages."""
        crc, described = crc32(found.data), [(opcode, int.from_bytes(body[:2], "little")) for opcode, body in others]
        is_known = all(self._describes(key, body) for key, (_, body) in zip(described, others, strict=True))
        is_correct = found.is_plain and head.crc in {0, crc}
        return ChunkContents(crc, is_tidy and is_known and is_correct, frozenset(described))

    def _describes(self, key: tuple[int, int], body: Body) -> bool:
        """Return whether a record of a chunk equals a channel or a schema of the log."""
        known = self.found.described
        try:
            item = layout.parse(key[0], bytes(body)) if key[0] in INSIDE else None
        except layout.UNREADABLE:
            return False
        match item:
            case McapSchema():
                return known.schemas.get(item.id) == item
            case McapChannel() if (channel := known.channels.get(item.id)) is not None:
                is_equal = channel == channel_of(item, known.schemas.get(item.schema_id))
                return is_equal and channel.schema_id == item.schema_id
        return False


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


def _in_order_and_indexed(entries: Sequence[IndexEntry], indexes: Sequence[layout.MessageIndex]) -> bool:
    """Return whether messages are in log-time order, and exactly one message index per channel lists them."""
    in_order = all(earlier[1] <= later[1] for earlier, later in pairwise(entries))
    channels = [index.channel_id for index in indexes]
    listed = sorted((index.channel_id, *entry) for index in indexes for entry in index.entries)
    return in_order and len(channels) == len(set(channels)) and sorted(entries) == listed


def _record(stream: GuardedFile, chunk: ChunkIndex) -> bytes:
    stream.seek(chunk.chunk_start_offset)
    return stream.exactly(chunk.chunk_length)


def _indexes(stream: GuardedFile, chunk: ChunkIndex) -> bytes:
    stream.seek(chunk.chunk_start_offset + chunk.chunk_length)
    return stream.exactly(chunk.message_index_length)
