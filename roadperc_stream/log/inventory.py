"""Compares a file with its index and statistics, and finds which messages a damaged log lost.

Only message indexes, chunk spans and the log time of the next message show which messages are missing.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import IO, Final

from mcap import records
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from roadperc_stream.log.damage import Damage
from roadperc_stream.log.layout import RECORD, ChunkHead, Record, entry_of, message_index

Positions = dict[int, list[tuple[int, int]]]
"""Log time and chunk offset of each message, by channel."""
_MOST_INDEX_BYTES: Final = 64 * 1024 * 1024


@dataclass
class Inventory:
    """The contents of a file. ``conclusive`` means that message indexes list the messages of all unopened chunks."""

    counts: Counter[int] = field(default_factory=Counter)
    """Messages by channel."""
    first_ns: int | None = None
    last_ns: int | None = None
    behind_ns: int = -1
    """Largest step back of log time from an earlier message to a later one; -1 if log times strictly ascend."""
    chunks: dict[int, records.ChunkIndex] = field(default_factory=dict)
    """The correct index entries, by the chunk's first byte."""
    entries: list[tuple[int, records.ChunkIndex]] = field(default_factory=list)
    """The index entries found, each with its first byte."""
    attachments: list[int] = field(default_factory=list)
    metadata: list[int] = field(default_factory=list)
    """First bytes."""
    beside_entries: list[tuple[int, records.AttachmentIndex | records.MetadataIndex]] = field(default_factory=list)
    statistics: tuple[int, records.Statistics] | None = None
    conclusive: bool = True
    chunk: records.ChunkIndex | None = None
    """The chunk whose message indexes come next."""
    lost: bool = False
    """Whether message indexes of a damaged chunk come next; they are skipped."""
    _footer: tuple[int, records.Footer] | None = None
    _positions: Positions | None = None
    """Messages of ``chunk``; None if it was not opened."""
    _with_index: bool | None = None

    def note(self, start: int, item: records.McapRecord) -> None:
        """Record the content of a record outside chunks, except messages."""
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
        """The earliest log time expected of the next message; None before the first one."""
        return None if self.last_ns is None else self.last_ns - self.behind_ns

    def add_chunk(self, record: Record, head: ChunkHead, positions: Positions | None) -> None:
        """Record an intact chunk, whose message indexes come next.

        ``positions`` are those of its messages, None if the chunk was not opened.
        """
        self.chunk, self._positions = entry_of(head, record.start, record.end - record.start), positions
        self.chunks[record.start] = self.chunk

    def add_message_index(self, record: Record) -> None:
        """Compare a message index with its chunk; those of damaged chunks are skipped.

        Raises:
            ValueError: they differ.
        """
        index = message_index(record.body)
        channel_id, found = index.channel_id, index.entries
        chunk = self.chunk
        if chunk is None:
            if not self.lost:
                raise ValueError("there is no chunk before it")
            return
        chunk.message_index_offsets[channel_id] = record.start
        chunk.message_index_length += record.end - record.start
        if self._positions is not None:
            if sorted(found) != sorted(self._positions.get(channel_id, ())):
                raise ValueError(f"lists other messages of channel {channel_id} than the chunk before it has")
            return
        for time_ns, _ in found:
            self.add_message(channel_id, time_ns)
        first_ns, last_ns = span_of(chunk)
        if not all(first_ns <= time_ns <= last_ns for time_ns, _ in found):
            raise ValueError("has log times outside the span of the chunk before it")

    def close_chunk(self) -> Damage | None:
        """End the message indexes of the last chunk; return the damage if one is missing."""
        chunk, positions, self.chunk, self._positions, self.lost = self.chunk, self._positions, None, None, False
        if chunk is None:
            return None
        missing = set(positions or ()) - set(chunk.message_index_offsets)
        indexed = bool(chunk.message_index_offsets)
        self.conclusive &= indexed or positions is not None
        holds_messages = indexed or bool(positions)
        if holds_messages and self._with_index is None:
            self._with_index = indexed
        if (indexed and missing) or (holds_messages and indexed != self._with_index):
            words = "messages of the chunk here are missing in the message indexes behind it"
            return Damage(chunk.chunk_start_offset, words, *span_of(chunk))
        return None

    def discrepancies(self, summary_start: int | None) -> Iterator[Damage]:
        """Yield the differences between the contents and the index and statistics.

        ``summary_start`` is the first byte behind the data section.
        """
        if self._footer is not None:
            byte, footer = self._footer
            if footer.summary_start != summary_start and (footer.summary_start or byte != summary_start):
                words = f"the summary starts at byte {summary_start}, the footer states {footer.summary_start}"
                yield Damage(byte, words, of_messages=False)
        yield from self._chunk_discrepancies()
        beside = {*self.attachments, *self.metadata}
        for byte, entry in self.beside_entries:
            if entry.offset not in beside:
                words = f"the index puts {entry.name!r} at byte {entry.offset}, where it does not start"
                yield Damage(byte, words, of_messages=False)
        if self.statistics is not None:
            yield from self._statistics_discrepancies(*self.statistics)

    def _chunk_discrepancies(self) -> Iterator[Damage]:
        """Yield those of the chunk index; one without entries is not used."""
        named = Counter(entry.chunk_start_offset for _, entry in self.entries)
        for byte, entry in self.entries:
            start = entry.chunk_start_offset
            chunk = self.chunks.get(start)
            if chunk is None:
                yield Damage(byte, f"the index puts a chunk at byte {start}, where no chunk starts")
            elif chunk != entry:
                yield Damage(byte, f"the index entry of the chunk at byte {start} does not match it", *span_of(chunk))
            elif named[start] > 1:
                yield Damage(byte, f"the index names the chunk at byte {start} more than once")
        for start, chunk in self.chunks.items():
            if self.entries and not named[start]:
                yield Damage(start, "the index does not name the chunk here", *span_of(chunk))

    def _statistics_discrepancies(self, byte: int, said: records.Statistics) -> Iterator[Damage]:
        found = self.counts.total()
        if said.message_count != found:
            yield Damage(byte, f"{found} messages found, the statistics count {said.message_count}")
        elif said.channel_message_counts and +Counter(said.channel_message_counts) != +self.counts:
            ids = sorted({*said.channel_message_counts, *self.counts})
            wrong = next(i for i in ids if said.channel_message_counts.get(i, 0) != self.counts[i])
            words = f"{self.counts[wrong]} messages found on channel {wrong}, the statistics count"
            yield Damage(byte, f"{words} {said.channel_message_counts.get(wrong, 0)}")
        for what, number, counted in (
            ("chunks", len(self.chunks), said.chunk_count),
            ("attachments", len(self.attachments), said.attachment_count),
            ("metadata records", len(self.metadata), said.metadata_count),
        ):
            if number != counted:
                yield Damage(byte, f"{number} {what} found, the statistics count {counted}")


def span_of(chunk: records.ChunkIndex) -> tuple[int, int]:
    """Return first and last log time of a chunk."""
    return chunk.message_start_time, chunk.message_end_time


@dataclass(frozen=True)
class Gap:
    """A span of log times in which messages were lost: first and last, both included, None if unknown.

    ``messages`` counts those lost by channel; empty if unknown.
    """

    first_ns: int | None
    last_ns: int | None
    messages: Mapping[int, int] = field(default_factory=dict)


def expected_messages(stream: IO[bytes], at: int) -> Positions:
    """Return the messages in the message indexes that start at a byte; the stream's position is restored."""
    expected = Positions()
    here = stream.tell()
    stream.seek(at)
    with suppress(McapError, ValueError):
        while len(head := stream.read(RECORD.size)) == RECORD.size:
            opcode, length = RECORD.unpack(head)
            if opcode != Opcode.MESSAGE_INDEX or length > _MOST_INDEX_BYTES:
                break
            index = message_index(stream.read(length))
            expected[index.channel_id] = index.entries
    stream.seek(here)
    return expected


def lost_in_chunk(
    expected: Positions, saved: Positions, span_ns: tuple[int, int] | None, next_ns: int | None, *, all_read: bool
) -> Gap | None:
    """Return what a damaged chunk lost; None if nothing.

    Args:
        expected: its messages, from the message indexes behind it; empty without any.
        saved: its messages that were read.
        span_ns: first and last log time, from the index or its own fields; None if neither is valid.
        next_ns: earliest log time expected after the last message read.
        all_read: whether it has its full length and all its messages were read.
    """
    if any(expected.values()):
        lost = {number: set(places) - set(saved.get(number, ())) for number, places in expected.items()}
        times = [time_ns for places in lost.values() for time_ns, _ in places]
        counts = {number: len(places) for number, places in lost.items() if places}
        return Gap(min(times), max(times), counts) if times else None
    if all_read:
        return None
    if span_ns is None:
        return Gap(next_ns, None)
    if not any(saved.values()) or next_ns is None:
        return Gap(*span_ns)
    first_ns = max(span_ns[0], next_ns)
    return Gap(first_ns, max(span_ns[1], first_ns))


@dataclass
class Losses:
    """The gaps of a log while it is read. A gap without a known end ends at the next message."""

    gaps: list[Gap] = field(default_factory=list)
    undescribed: Counter[int] = field(default_factory=Counter)
    """Number of messages whose channel the log does not describe, by channel; they are lost."""
    _undescribed_ns: tuple[int, int] | None = None
    """Their first and last log time."""
    is_open: bool = False
    """Whether the end of the last gap is not known yet."""

    @property
    def all(self) -> tuple[Gap, ...]:
        """The gaps in file order, then the span of the messages without a described channel."""
        return (*self.gaps, *(() if self._undescribed_ns is None else (Gap(*self._undescribed_ns),)))

    def add_undescribed(self, channel_id: int, log_time_ns: int) -> None:
        """Count a message whose channel the log does not describe."""
        self.undescribed[channel_id] += 1
        first_ns, last_ns = self._undescribed_ns or (log_time_ns, log_time_ns)
        self._undescribed_ns = min(first_ns, log_time_ns), max(last_ns, log_time_ns)

    def add(self, gap: Gap, *, is_open: bool) -> None:
        """Add a gap; an open one ends at the next message."""
        first_ns = self.gaps.pop().first_ns if self.is_open else gap.first_ns  # open: no message came since
        self.gaps.append(Gap(first_ns, None if is_open else gap.last_ns, gap.messages))
        self.is_open = is_open

    def settle(self, last_ns: int) -> bool:
        """End the open gap at a log time, because a message was read; return whether there was one."""
        was_open, self.is_open = self.is_open, False
        if was_open:
            first_ns = self.gaps[-1].first_ns
            self.gaps[-1] = replace(self.gaps[-1], last_ns=max(last_ns, 0 if first_ns is None else first_ns))
        return was_open
