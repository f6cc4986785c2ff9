"""What stands in a file against what its index and statistics say: messages that fell out leave no other trace."""

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from mcap import records

from roadperc_stream.log.chunks import ChunkHead
from roadperc_stream.log.damage import Damage
from roadperc_stream.log.framing import Record

_INDEX_HEAD: Final = struct.Struct("<HI")
_INDEX_ENTRY: Final = struct.Struct("<QQ")
INDEX_ENTRY_BYTES: Final = _INDEX_ENTRY.size

Positions = dict[int, list[tuple[int, int]]]
"""Log time and offset in its chunk of each message, by channel."""


@dataclass
class ChunkPlace:
    """A chunk of the file, and the message indexes behind it."""

    start: int
    length: int
    first_ns: int
    last_ns: int
    compression: str
    stored_bytes: int
    size_bytes: int
    positions: Positions | None = None
    """None where nobody looked inside."""
    index_offsets: dict[int, int] = field(default_factory=dict)
    """Where the message index of each channel starts."""
    index_bytes: int = 0

    @classmethod
    def of(cls, record: Record, head: ChunkHead, positions: Positions | None) -> "ChunkPlace":
        """The place of a chunk that was read."""
        length, stored = record.end - record.start, head.stored_bytes
        times, sizes = (head.first_ns, head.last_ns), (stored, head.size_bytes)
        return cls(record.start, length, *times, head.compression, *sizes, positions)

    def agrees(self, entry: records.ChunkIndex) -> bool:
        """Whether an entry of the index describes this chunk."""
        return (
            (entry.chunk_start_offset, entry.chunk_length) == (self.start, self.length)
            and (entry.message_start_time, entry.message_end_time) == (self.first_ns, self.last_ns)
            and (entry.compressed_size, entry.uncompressed_size) == (self.stored_bytes, self.size_bytes)
            and (entry.compression, entry.message_index_length) == (self.compression, self.index_bytes)
            and entry.message_index_offsets == self.index_offsets
        )


def read_message_index(body: bytes) -> tuple[int, list[tuple[int, int]]]:
    """Channel, and log time and offset of each of its messages in a chunk.

    Raises:
        ValueError: this is no message index.
    """
    if len(body) < _INDEX_HEAD.size:
        raise ValueError("ends before its contents do")
    channel_id, length = _INDEX_HEAD.unpack_from(body)
    if length % _INDEX_ENTRY.size or _INDEX_HEAD.size + length > len(body):
        raise ValueError("ends before its contents do")
    return channel_id, list(_INDEX_ENTRY.iter_unpack(memoryview(body)[_INDEX_HEAD.size :][:length]))


@dataclass
class Inventory:
    """What was found in a file; ``conclusive`` where what the messages are is known without a look inside chunks."""

    counts: Counter[int] = field(default_factory=Counter)
    """Messages by channel."""
    first_ns: int | None = None
    last_ns: int | None = None
    behind_ns: int = -1
    """By how much messages stand in the file behind ones of a later log time, at most; -1 where not even equal times
    follow one another."""
    chunks: dict[int, ChunkPlace] = field(default_factory=dict)
    """By their first byte."""
    entries: list[tuple[int, records.ChunkIndex]] = field(default_factory=list)
    """The index's entries of chunks, with the byte each starts at."""
    attachments: list[int] = field(default_factory=list)
    metadata: list[int] = field(default_factory=list)
    """First bytes."""
    beside_entries: list[tuple[int, records.AttachmentIndex | records.MetadataIndex]] = field(default_factory=list)
    statistics: tuple[int, records.Statistics] | None = None
    conclusive: bool = True
    _footer: tuple[int, records.Footer] | None = None
    _open: ChunkPlace | None = None
    _lost: bool = False
    _with_index: bool | None = None

    def note(self, start: int, item: records.McapRecord) -> None:
        """Take note of a record outside chunks that is no message."""
        match item:
            case records.Attachment():
                self.attachments.append(start)
            case records.Metadata():
                self.metadata.append(start)
            case records.Statistics():
                self.statistics = (start, item)
            case records.ChunkIndex():
                self.entries.append((start, item))
            case records.AttachmentIndex() | records.MetadataIndex():
                self.beside_entries.append((start, item))
            case records.Footer():
                self._footer = (start, item)

    def add_message(self, channel_id: int, log_time_ns: int) -> None:
        """Count a message."""
        self.counts[channel_id] += 1
        self.first_ns = log_time_ns if self.first_ns is None else min(self.first_ns, log_time_ns)
        latest_ns = log_time_ns if self.last_ns is None else self.last_ns
        if self.last_ns is not None:
            self.behind_ns = max(self.behind_ns, latest_ns - log_time_ns)
        self.last_ns = max(latest_ns, log_time_ns)

    @property
    def next_ns(self) -> int | None:
        """The earliest log time that the next message may have, if it comes as those before; None at the beginning."""
        return None if self.last_ns is None else self.last_ns - self.behind_ns

    @property
    def span_ns(self) -> tuple[int | None, int | None]:
        """First and last log time of the chunk whose message indexes are being read; None outside."""
        return (None, None) if self._open is None else (self._open.first_ns, self._open.last_ns)

    def add_chunk(self, chunk: ChunkPlace) -> None:
        """Take note of a chunk that was read whole; its message indexes come next."""
        self.chunks[chunk.start] = self._open = chunk

    def add_message_index(self, record: Record) -> None:
        """Compare a message index with its chunk; those of a chunk that was not read whole say nothing.

        Raises:
            ValueError: they differ.
        """
        channel_id, found = read_message_index(record.body)
        chunk = self._open
        if chunk is None:
            if not self._lost:
                raise ValueError("no chunk stands before it")
            return
        chunk.index_offsets[channel_id] = record.start
        chunk.index_bytes += record.end - record.start
        if chunk.positions is not None:
            if sorted(found) != sorted(chunk.positions.get(channel_id, ())):
                raise ValueError(f"names other messages of channel {channel_id} than the chunk before it holds")
            return
        for time_ns, _ in found:
            self.add_message(channel_id, time_ns)
        if not all(chunk.first_ns <= time_ns <= chunk.last_ns for time_ns, _ in found):
            raise ValueError("has log times outside the span of the chunk before it")

    def lose_chunk(self) -> None:
        """A chunk was not read whole: its message indexes come next."""
        self._lost = True

    def close_chunk(self) -> Damage | None:
        """All message indexes of the last chunk were read: says whether one is missing."""
        chunk, self._open, self._lost = self._open, None, False
        if chunk is None:
            return None
        missing = set(chunk.positions or ()) - set(chunk.index_offsets)
        indexed = bool(chunk.index_offsets)
        self.conclusive &= indexed or chunk.positions is not None
        holds_messages = indexed or bool(chunk.positions)
        partly = indexed and bool(missing)
        if holds_messages and self._with_index is None:
            self._with_index = indexed
        chunk.positions = None
        if partly or (holds_messages and indexed != self._with_index):
            words = "messages of the chunk here are missing in the message indexes behind it"
            return Damage(chunk.start, words, chunk.first_ns, chunk.last_ns)
        return None

    def discrepancies(self, summary_start: int | None) -> Iterator[Damage]:
        """Where the index and the statistics say something else than what was found.

        Args:
            summary_start: the first byte behind the data section.
        """
        if self._footer is not None:
            byte, footer = self._footer
            if footer.summary_start != summary_start and (footer.summary_start or byte != summary_start):
                words = f"the footer says that the summary starts at byte {footer.summary_start}, it does at"
                yield Damage(byte, f"{words} {summary_start}", of_messages=False)
        yield from self._chunk_discrepancies()
        beside = {*self.attachments, *self.metadata}
        for byte, entry in self.beside_entries:
            if entry.offset not in beside:
                words = f"the index names byte {entry.offset}, where {entry.name!r} does not start"
                yield Damage(byte, words, of_messages=False)
        if self.statistics is not None:
            yield from self._statistics_discrepancies(*self.statistics)

    def _chunk_discrepancies(self) -> Iterator[Damage]:
        """An index that names no chunk at all is not used."""
        named = Counter(entry.chunk_start_offset for _, entry in self.entries)
        for byte, entry in self.entries:
            chunk = self.chunks.get(entry.chunk_start_offset)
            if chunk is None:
                yield Damage(byte, f"the index names a chunk at byte {entry.chunk_start_offset}, where none starts")
            elif not chunk.agrees(entry):
                words = f"the index says something else of the chunk at byte {chunk.start} than stands there"
                yield Damage(byte, words, chunk.first_ns, chunk.last_ns)
            elif named[chunk.start] > 1:
                yield Damage(byte, f"the index names the chunk at byte {chunk.start} more than once")
        for chunk in self.chunks.values():
            if self.entries and not named[chunk.start]:
                yield Damage(chunk.start, "the index does not name the chunk here", chunk.first_ns, chunk.last_ns)

    def _statistics_discrepancies(self, byte: int, said: records.Statistics) -> Iterator[Damage]:
        found = self.counts.total()
        if said.message_count != found:
            yield Damage(byte, f"{found} messages found, the statistics count {said.message_count}")
        elif +Counter(said.channel_message_counts) != +self.counts:
            ids = sorted({*said.channel_message_counts, *self.counts})
            wrong = next(i for i in ids if said.channel_message_counts.get(i, 0) != self.counts[i])
            words = f"{self.counts[wrong]} messages found on channel {wrong}, the statistics count"
            yield Damage(byte, f"{words} {said.channel_message_counts.get(wrong, 0)}")
        times = (said.message_start_time, said.message_end_time)
        if found and times != (self.first_ns, self.last_ns):
            words = f"log times {self.first_ns} to {self.last_ns} found, the statistics say {times[0]} to {times[1]}"
            yield Damage(byte, words)
        for what, number, counted in (
            ("chunks", len(self.chunks), said.chunk_count),
            ("attachments", len(self.attachments), said.attachment_count),
            ("metadata records", len(self.metadata), said.metadata_count),
        ):
            if number != counted:
                yield Damage(byte, f"{number} {what} found, the statistics count {counted}")
