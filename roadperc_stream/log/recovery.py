"""Reads a log once, in file order: checks it, and gives every intact message of a damaged one, with the lost times.

A cut file is read up to the cut, including the readable start of its last chunk. A chunk whose CRC is wrong gives no
message, and one without a CRC those before the fault. Behind invalid bytes, reading continues where the next consistent
record starts. Format: https://mcap.dev/spec.
"""

import mmap
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO, Final, Self

from deflate import crc32
from mcap import records
from mcap.opcode import Opcode

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log import layout
from roadperc_stream.log.chunks import INSIDE, outline_of, streamed, too_many
from roadperc_stream.log.damage import (
    ANY_TIME,
    DamagedLogError,
    Losses,
    LostSpan,
    nothing_saved,
    require_magic,
    unopened,
)
from roadperc_stream.log.index import Described, share_channels, summary_of
from roadperc_stream.log.layout import MAGIC, MESSAGE, NAMES, RECORD, Record
from roadperc_stream.log.limits import ATTACHED, LimitError, require_chunk, require_record
from roadperc_stream.log.records import Message
from roadperc_stream.log.stored import AnyLog, LogFile
from roadperc_stream.system.time import ns_to_seconds

_OF_DATA: Final = frozenset(
    (*INSIDE, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END)
)
_OF_SUMMARY: Final = frozenset(Opcode) - _OF_DATA - {Opcode.HEADER} | {Opcode.SCHEMA, Opcode.CHANNEL}
_BESIDE_MESSAGES: Final = frozenset((Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA))
_CHUNK_OPCODE: Final = bytes([Opcode.CHUNK])
_SUMMARY_CRC_AT: Final = 16
"""Offset of the summary's CRC in the footer's body."""
_MOST_END_BYTES: Final = 13
"""Largest length of the record that ends the data section; those of damaged opcodes are longer."""
_FAR_NS: Final = 24 * 3600 * 1_000_000_000
"""Limit for the time between messages of a log, to recognise one."""
_FIELDS_BYTES: Final = 64
"""More than the fields of a chunk."""
_CHUNK: Final = rb"(?=\x06.{5}\x00{3}.{28}(?:\x00{4}|\x03\x00{3}lz4|\x04\x00{3}zstd))"
_BESIDE_CHUNKS: Final = re.compile(_CHUNK + rb"|(?=[\x09\x0c].{5}\x00{3})", re.DOTALL)
"""First bytes of a chunk, or of a record between chunks; lengths are below 2^40 bytes."""
_ANYWHERE: Final = re.compile(_CHUNK + rb"|(?=[\x03\x04\x05\x09\x0c].{5}\x00{3})", re.DOTALL)


class _Search:
    """Finds where records start behind invalid bytes.

    ``is_message`` returns whether the fields of a message record belong to a message of this log.
    """

    def __init__(self, stream: IO[bytes], is_message: Callable[[bytes], bool]) -> None:
        self._data, self._is_message = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ), is_message

    def next_record(self, at: int, *, chunked: bool) -> int | None:
        """Return the byte where the next consistent record starts, from byte ``at`` on; None without any.

        A message of this log also counts if no record follows it, unless a consistent record starts inside it.
        ``chunked`` skips messages, channels and schemas, because those inside a chunk look like those outside.
        """
        alone: tuple[int, int] | None = None
        for found in (_BESIDE_CHUNKS if chunked else _ANYWHERE).finditer(self._data, at):
            start = found.start()
            if alone is not None and start >= alone[1]:
                break
            end, is_certain = self._end(start)
            if is_certain or (end and self._leads_on(end)):
                return start
            if end and self._data[start] == Opcode.MESSAGE:
                alone = start, end
        return None if alone is None else alone[0]

    def chunk_bytes(self, start: int) -> int:
        """Return the length of the chunk at a byte by its own fields; 0 if no record follows there."""
        stated = _chunk_bytes(self._data[start + RECORD.size : start + RECORD.size + _FIELDS_BYTES])
        return stated if stated and self._leads_on(start + stated) else 0

    def _end(self, start: int) -> tuple[int, bool]:
        """Return the byte behind a likely record, 0 if no record is there, and whether its fields alone prove it."""
        opcode, length = RECORD.unpack_from(self._data, start)
        fields_at, end = start + RECORD.size, start + RECORD.size + length
        if end > len(self._data) or length < layout.LENGTH.size:
            return 0, False
        fields = self._data[fields_at : min(end, fields_at + _FIELDS_BYTES)]
        if opcode == Opcode.CHUNK:
            stated = _chunk_bytes(fields)
            return (end if 0 < stated <= end - start else 0), stated == end - start
        return (0 if opcode == Opcode.MESSAGE and not self._is_message(fields) else end), False

    def _leads_on(self, end: int) -> bool:
        """Return whether a record can start at a byte, or the file ends there."""
        left = len(self._data) - end
        if left < RECORD.size:
            return not left
        opcode, length = RECORD.unpack_from(self._data, end)
        return bool(opcode) and bool(RECORD.size + length <= left)


def _chunk_bytes(fields: bytes | memoryview) -> int:
    """Return the length of the whole record that a chunk's first fields state; 0 if they are not a chunk's."""
    try:
        head = layout.chunk_head(fields)
    except ValueError:
        return 0
    return head.record_bytes if head.first_ns <= head.last_ns else 0


def _is_chunk(record: Record) -> bool:
    """Return whether a record has the form of a chunk of just its length."""
    return _chunk_bytes(record.body) == record.end - record.start


Found = tuple[layout.MessageHead, bytes | memoryview]
"""A message's fields and its record."""
_Entry = tuple[int, int, int]
"""A message's channel, log time and offset in the data of its chunk."""


@dataclass
class _Chunk:
    """A chunk whose message indexes come next: the messages that they list, and those that it has if it was opened."""

    entry: records.ChunkIndex
    has_crc: bool
    held: list[_Entry] | None = None
    listed: list[_Entry] = field(default_factory=list)

    @property
    def span(self) -> LostSpan:
        return LostSpan(self.entry.message_start_time, self.entry.message_end_time)

    def add(self, record: Record) -> None:
        """Add a message index."""
        channel_id, places = layout.message_index(record.body)
        self.entry.message_index_offsets[channel_id] = record.start
        self.entry.message_index_length += record.end - record.start
        self.listed += ((channel_id, *place) for place in places)


@dataclass
class Salvage:
    """Reads a log once and records its state. The account is complete at the end of ``messages`` or ``run``.

    Args:
        source: the log.
        inside: open all chunks. Otherwise those with message indexes stay closed, and reading ends at the first damage.
        limits: of its records and chunks.

    Raises:
        LogError: the file cannot be opened, is empty, or does not start as an MCAP log; while reading: it exceeds the
            limits.
    """

    source: AnyLog
    inside: bool = True
    limits: LimitsConfig = DEFAULT_LIMITS
    size_bytes: int = 0
    chunks: Counter[str] = field(default_factory=Counter)
    """Number of chunks by compression; "" for uncompressed ones."""
    index: list[records.ChunkIndex] = field(default_factory=list)
    """The intact chunks, in file order."""
    described: Described = field(default_factory=Described)
    losses: Losses = field(default_factory=Losses)
    absent: tuple[str, ...] = ()
    """Optional parts that the log lacks: its index, CRCs."""
    notes: tuple[str, ...] = ()
    """What is wrong in the log without harm."""
    all_in_chunks: bool = True
    """Whether every message is in a chunk."""
    whole: bool = False
    """Whether the file is complete and no damage was found."""
    is_summary_sealed: bool = False
    """Whether the summary has a correct CRC."""
    has_data_crc: bool = False
    """Whether the data section has a CRC, as far as the summary shows where."""

    def __post_init__(self) -> None:
        self.file = LogFile.of(self.source)
        self.path = self.file.name
        self.counts = self.losses.counts
        """Messages read, by ``Channel.source_id``."""
        self.damages = self.losses.damages
        """In file order."""
        self.channels = self.described.channels
        """By ``Channel.source_id``, including channels without messages."""
        self.first_ns: int | None = None
        """Log time of the first message; of a damaged log the first one written, if the statistics state it."""
        self._indexed: dict[int, records.ChunkIndex] = {}
        self._statistics: tuple[int, records.Statistics] | None = None
        self._chunk: _Chunk | None = None
        self._channel_sets: dict[frozenset[int], dict[int, int]] = {}
        self._without_crc = self._held_bytes = 0
        self._in_data, self._is_sealed, self._is_ended = True, False, False
        self._search: _Search | None = None
        self._doubted: int | None = None
        """First byte of a record that may be a message with a damaged opcode, unless a CRC proves the opcode."""
        try:
            with self.file.path.open("rb") as stream:
                self.size_bytes = stream.seek(0, os.SEEK_END)
                stream.seek(0)
                require_magic(self.path, stream.read(len(MAGIC)))
                self._read_summary(stream)
        except OSError as error:
            raise unopened(self.path, error) from error

    def _read_summary(self, stream: IO[bytes]) -> None:
        """Take descriptions and the chunk index from the summary: those in the data may be damaged."""
        with suppress(OSError, *layout.UNREADABLE):  # comes again in reading
            data_end, items = summary_of(stream, self.limits)
            for item in items:
                self.described.add(item, in_data=False)
                if isinstance(item, records.ChunkIndex) and item.message_start_time <= item.message_end_time:
                    self._indexed[item.chunk_start_offset] = item
            stream.seek(data_end - layout.CRC_BYTES)
            self.has_data_crc = any(stream.read(layout.CRC_BYTES))

    @property
    def last_ns(self) -> int | None:
        """Log time of the last message read."""
        return self.losses.last_ns

    def messages(self) -> Iterator[Message]:
        """Yield every readable message, in file order."""
        for head, body in self._found(with_content=True):
            yield head.of(self.channels[head.channel_id], body)

    def run(self) -> Self:
        """Read everything for the account alone."""
        for _ in self._found(with_content=False):
            pass
        return self

    def _found(self, *, with_content: bool) -> Iterator[Found]:
        try:
            with self.file.path.open("rb") as stream:
                for record, cut in self._records(stream):
                    yield from self._messages_of(record, cut, with_content=with_content)
                    if self.damages and not self.inside:
                        return
        except OSError as error:
            raise LogError(f"{self.path}: {error.strerror or error}") from error
        except LimitError as error:
            raise LogError(f"{self.path}: {error}") from error
        self._conclude()

    def _records(self, stream: IO[bytes]) -> Iterator[tuple[Record, str]]:
        """Yield the records outside chunks, each with the reason if it is a chunk cut by the end of the file."""
        crc: int | None = crc32(stream.read(len(MAGIC)))
        at: int | None = len(MAGIC)
        head = stream.read(RECORD.size)
        while at is not None:
            if fault := self._fault(at, head, in_data=self._in_data):
                if self._in_data and head[:1] == _CHUNK_OPCODE and len(head) == RECORD.size:
                    most = min(self.size_bytes - at - RECORD.size, self.limits.chunk_bytes, self.limits.record_bytes)
                    yield Record(at, Opcode.CHUNK, stream.read(most)), fault
                else:
                    self._lose(at, fault)
                at, crc = self._next(stream, at + 1), None
            else:
                length = RECORD.unpack(head)[1]
                require_record(length, self.limits)
                record = Record(at, head[0], stream.read(length))
                head = stream.read(RECORD.size)
                if record.opcode == Opcode.FOOTER:
                    self._finish(record, head, crc)
                    yield record, ""
                    return
                inside = self._start_inside(stream, record, head)
                is_short = record.opcode == Opcode.CHUNK and _chunk_bytes(record.body) > record.end - at
                if (inside is not None or is_short) and (own := self._of_own_length(stream, record)):
                    words = f"chunk: its record states {record.end - at} bytes, its fields {own.end - at}"
                    self.losses.note(at, words)
                    record, head, inside, crc = own, stream.read(RECORD.size), None, None
                if inside is None:
                    crc = self._checked(record, crc)
                    yield record, ""
                    at = record.end
                    continue
                self._lose(at, f"{record.name}: a record of {len(record.body)} bytes leads to no other record")
                at, crc = inside, None
            if at is not None:
                stream.seek(at)
                head = stream.read(RECORD.size)

    def _fault(self, at: int, head: bytes, *, in_data: bool) -> str:
        """Return why no record can start with these bytes; empty if one can."""
        if len(head) < RECORD.size:
            why = self.file.fault or f"the file ends after {self.size_bytes} bytes, before its footer"
            return f"cut off: {why}"
        opcode, length = RECORD.unpack(head)
        left = self.size_bytes - at - RECORD.size
        if opcode == 0:
            return "no record starts here: opcode 0x00"
        if length > left:
            return f"cut off or damaged: a record of {length} bytes starts here, {left} bytes are left"
        expected = {Opcode.HEADER} if at == len(MAGIC) else _OF_DATA if in_data else _OF_SUMMARY
        is_foreign = opcode not in expected and (opcode in NAMES or at == len(MAGIC))
        if is_foreign or (opcode == Opcode.DATA_END and length > _MOST_END_BYTES):
            return f"a {NAMES.get(opcode, hex(opcode))} record does not belong here"
        return ""

    def _start_inside(self, stream: IO[bytes], record: Record, head: bytes) -> int | None:
        """Return where the next record starts if the length of this one is wrong; None if it is right.

        ``head`` are the bytes behind it. If it leads to no other record and none starts inside it, only the next one is
        damaged.
        """
        is_end = record.opcode == Opcode.DATA_END
        if not self._in_data or record.end >= self.size_bytes or not self._fault(record.end, head, in_data=not is_end):
            return None
        if record.opcode == Opcode.CHUNK and _is_chunk(record):
            return None
        inside = self._next(stream, record.start + 1)
        return inside if inside is not None and (inside < record.end or is_end) else None

    def _of_own_length(self, stream: IO[bytes], record: Record) -> Record | None:
        """Return a chunk with the length that its own fields state; None if it is not intact, or no record follows."""
        length = self._searching(stream).chunk_bytes(record.start)
        if record.opcode != Opcode.CHUNK or not length or length > self.limits.record_bytes:
            return None
        stream.seek(record.start + RECORD.size)
        own = Record(record.start, Opcode.CHUNK, stream.read(length - RECORD.size))
        _, fault, _ = outline_of(layout.chunk_head(own.body), self.limits.chunk_messages)
        return None if fault else own

    def _next(self, stream: IO[bytes], at: int) -> int | None:
        """Return the next place where a record starts; None behind the data section."""
        if not self._in_data:
            return None
        return self._searching(stream).next_record(at, chunked=bool(self.chunks or self._indexed))

    def _searching(self, stream: IO[bytes]) -> _Search:
        self._search = self._search or _Search(stream, self._is_message)
        return self._search

    def _lose(self, at: int, fault: str) -> None:
        """Note a place without a record; behind the data section no message is lost."""
        self.losses.note(at, fault, self.losses.unread if self._in_data else None, is_loss=self._in_data)

    def _is_message(self, body: bytes | memoryview) -> bool:
        """Return whether these are the first bytes of a message of this log, judged by its channel and log time."""
        if len(body) < MESSAGE.size or int.from_bytes(body[:2], "little") not in self.channels:
            return False  # checked first because it is cheap: there may be millions
        first_ns, last_ns, time_ns = self.losses.first_ns, self.losses.last_ns, layout.message_head(body).log_time_ns
        return first_ns is None or last_ns is None or first_ns - _FAR_NS < time_ns < last_ns + _FAR_NS

    def _checked(self, record: Record, crc: int | None) -> int | None:
        """Return the CRC of the section with a record, None if it is unknown; compare that of the data at its end."""
        if record.opcode != Opcode.DATA_END:
            return None if crc is None else record.crc(crc)
        self._in_data, expected = False, record.number(0)
        self._is_sealed = bool(expected) and crc == expected
        if expected and crc not in (None, expected):
            is_in_checked_chunks = self.inside and self.all_in_chunks and not self._without_crc
            words = f"CRC of the data section is {crc:#010x}, expected {expected:#010x}"
            self.losses.note(record.start, words, None if is_in_checked_chunks else ANY_TIME)
        return 0

    def _finish(self, footer: Record, end: bytes, crc: int | None) -> None:
        """Check the CRC of the summary, and the end of the file."""
        found, expected = footer.crc(crc or 0, _SUMMARY_CRC_AT), footer.number(_SUMMARY_CRC_AT)
        self._is_ended, self.is_summary_sealed = end == MAGIC, found == expected
        if expected not in {0, found}:
            self.losses.note(footer.start, f"CRC of the summary is {found:#010x}, expected {expected:#010x}")
        if not self._is_ended:
            left = self.size_bytes - footer.end
            self.losses.note(footer.end, f"expected the closing magic, found {left} bytes behind the footer")

    def _messages_of(self, record: Record, cut: str, *, with_content: bool) -> Iterator[Found]:
        """Yield the messages of a record; store the content of any other record."""
        if record.opcode != Opcode.MESSAGE_INDEX:
            self._close_chunk()
        try:
            if record.opcode == Opcode.CHUNK:
                yield from self._messages_in(record, cut, with_content=with_content)
            elif record.opcode == Opcode.MESSAGE:
                self.all_in_chunks = False
                yield self._counted(record.body), record.body
            elif record.opcode == Opcode.MESSAGE_INDEX:
                self._add_index(record)
            elif record.opcode in layout.PARSED:
                self._describe(record.opcode, record.body, record.start)
            elif self._in_data and (self._is_message(record.body) or _is_chunk(record)):
                self._doubted = record.start
        except layout.UNREADABLE as error:
            if isinstance(error, LimitError) and record.opcode != Opcode.CHUNK:
                raise
            # In a log without chunks it may be a message with a damaged opcode.
            is_loss = self._in_data and not (record.opcode in _BESIDE_MESSAGES and (self.chunks or self._indexed))
            span = self._span_at(record.start, self.losses.unread) if is_loss else None
            if self._chunk is not None:
                span = self._chunk.span
            self.losses.note(record.start, cut or f"{record.name}: {layout.fault_of(error)}", span, is_loss=is_loss)

    def _span_at(self, start: int, otherwise: LostSpan) -> LostSpan:
        """Return the times of the chunk at a byte by the index, if it names the chunk."""
        entry = self._indexed.get(start)
        return LostSpan(entry.message_start_time, entry.message_end_time) if entry else otherwise

    def _messages_in(self, record: Record, cut: str, *, with_content: bool) -> Iterator[Found]:
        """Yield the messages of a chunk if it is to be opened.

        Raises:
            ValueError, McapError: its fields are not valid, or exceed the limits.
        """
        head = layout.chunk_head(record.body)
        require_chunk(head, self.limits)
        self.chunks[head.compression] += 1
        self._without_crc += not head.crc
        chunk, entry = (
            _Chunk(layout.entry_of(head, record.start, len(record.body)), bool(head.crc)),
            self._indexed.get(record.start),
        )
        if self.inside or entry is None or not entry.message_index_length:
            yield from self._opened(chunk, head, cut, with_content=with_content)
        else:
            self._chunk = chunk

    def _opened(self, chunk: _Chunk, head: layout.ChunkHead, cut: str, *, with_content: bool) -> Iterator[Found]:
        """Yield the messages in a chunk; note what is wrong with it."""
        start, before, held = chunk.entry.chunk_start_offset, self.losses.unread, list[_Entry]()
        items, fault, may_be_altered = outline_of(head, self.limits.chunk_messages)
        if may_be_altered and not (cut and head.stored_bytes > len(head.stored)):
            items = []
        is_loss, is_dropped = bool(cut or fault), False
        for item in items:
            try:
                if item.opcode == Opcode.MESSAGE:
                    message = self._counted(item.body)
                    held.append((message.channel_id, message.log_time_ns, item.start))
                else:
                    self._describe(item.opcode, item.body, start)
            except layout.UNREADABLE as error:
                fault, is_dropped = fault or layout.fault_of(error), is_dropped or item.opcode == Opcode.MESSAGE
        if with_content:
            yield from _contents(head, held)
        beyond = next((ns for _, ns, _ in held if not head.first_ns <= ns <= head.last_ns), None)
        if beyond is not None and not fault:
            fault = f"message at {beyond} ns, its chunk states {head.first_ns} to {head.last_ns} ns"
        if cut:
            self.losses.note(start, cut, before if is_dropped else self.losses.unread, is_loss=True)
        elif fault:
            is_loss |= is_dropped
            span = self._span_at(start, before if is_loss else chunk.span)
            self.losses.note(start, f"chunk: {fault}", span, is_loss=is_loss)
        else:
            self._chunk, chunk.held = chunk, held

    def _add_index(self, record: Record) -> None:
        """Add a message index to the chunk before it; those of damaged chunks are skipped.

        Raises:
            ValueError: it is not valid, or there is no chunk before it.
        """
        if len(record.body) > (self.limits.chunk_messages + 1) * layout.ENTRY.size:
            raise ValueError(too_many(self.limits.chunk_messages))
        if self._chunk is not None:
            self._chunk.add(record)
        elif not self.damages or not self.chunks:
            raise ValueError("there is no chunk before it")

    def _close_chunk(self) -> None:
        """End the message indexes of a chunk: compare them with its messages, or count those of an unopened one."""
        chunk, self._chunk = self._chunk, None
        if chunk is None:
            return
        start, listed, held = chunk.entry.chunk_start_offset, chunk.listed, chunk.held
        share_channels(chunk.entry, self._channel_sets)
        self.index.append(chunk.entry)
        if self._span_at(start, chunk.span) != chunk.span:
            self.losses.note(start, "the index states other log times of the chunk here", chunk.span)
        if held is None:
            for channel_id, time_ns, _ in listed:
                self.losses.count(channel_id, time_ns)
        elif listed and sorted(listed) != sorted(held):
            words = "the message indexes behind the chunk here list other messages"
            is_loss = not chunk.has_crc and not {*listed} <= {*held}
            self.losses.note(start, words, self._span_at(start, chunk.span), is_loss=is_loss)

    def _counted(self, body: bytes | memoryview) -> layout.MessageHead:
        head = layout.message_head(body)
        if head.channel_id not in self.channels:
            raise ValueError(f"message of channel {head.channel_id}, which the log does not describe")
        self.losses.count(head.channel_id, head.log_time_ns)
        return head

    def _describe(self, opcode: int, body: bytes | memoryview, start: int) -> None:
        """Store the content of a record that is not a message; ``start`` is its first byte, or that of its chunk."""
        if opcode in (Opcode.ATTACHMENT, Opcode.METADATA):  # both are kept in memory
            self._held_bytes += len(body)
            require_record(self._held_bytes, self.limits, ATTACHED)
        item = layout.parse(opcode, bytes(body))
        self.described.add(item, in_data=self._in_data)
        if isinstance(item, records.Statistics):
            self._statistics = start, item

    def _conclude(self) -> None:
        """Compare the statistics with what was read, and find optional parts that the writer left out."""
        self._close_chunk()
        self._search, times = None, [self.losses.first_ns]
        if self._doubted is not None and not self._is_sealed:
            self.losses.note(
                self._doubted, "an unknown record has the form of a message or chunk", ANY_TIME, is_loss=True
            )
        if self._statistics is not None:
            if not self.losses.gaps:
                self._compare(*self._statistics)
            if self.damages and self.is_summary_sealed and self._statistics[1].message_count:
                times.append(self._statistics[1].message_start_time)
        self.first_ns = min((time_ns for time_ns in times if time_ns is not None), default=None)
        self.whole = self._is_ended and not self.damages
        lacking = {
            "index": not self._indexed,
            "CRC of the data section": not self._is_sealed,
            f"CRCs of {self._without_crc} chunks": bool(self._without_crc),
        }
        self.absent = tuple(what for what, true in lacking.items() if true)

    def _compare(self, byte: int, said: records.Statistics) -> None:
        """Note if the statistics count other messages; they may leave out the counts of channels."""
        counted, stated = self.counts.total(), +Counter(said.channel_message_counts)
        words = ""
        if said.message_count != counted:
            words = f"{counted} messages found, the statistics count {said.message_count}"
        elif stated and stated != +self.counts:
            words = "the statistics count other messages on some channels"
        found_ns = self.losses.first_ns, self.losses.last_ns
        stated_ns = said.message_start_time, said.message_end_time
        if words:
            self.losses.note(byte, words, None if self._is_sealed else ANY_TIME, is_loss=not self._is_sealed)
        elif counted and found_ns != stated_ns:
            read, written = (f"from {first_ns} to {last_ns} ns" for first_ns, last_ns in (found_ns, stated_ns))
            self.notes = (f"messages {read}, the statistics state them {written}",)


def _contents(head: layout.ChunkHead, held: list[_Entry]) -> Iterator[Found]:
    """Yield messages of a chunk, which it has in this order."""
    coming = iter(held)
    wanted = next(coming, None)
    for item in streamed(head) if wanted else ():
        if wanted is not None and item.start == wanted[2]:
            yield layout.message_head(item.body), item.body
            if (wanted := next(coming, None)) is None:
                return


def audited(source: AnyLog, limits: LimitsConfig = DEFAULT_LIMITS) -> Salvage:
    """Return the finished account of a log. If the data section has a CRC, chunks with message indexes stay closed.

    Raises:
        LogError: the file cannot be read, or is not MCAP.
    """
    quick = Salvage(source, inside=False, limits=limits)
    is_enough = quick.has_data_crc and quick.run().whole and quick.is_summary_sealed
    return quick if is_enough and quick.counts.keys() <= quick.channels.keys() else Salvage(source, limits=limits).run()


def damage_in(found: Salvage) -> LogError:
    """Return the error for a log that is not whole."""
    if not found.counts.total():
        return nothing_saved(found.path, found.damages)
    start_ns, lost_ns = found.first_ns, [gap.first_ns for gap in found.losses.gaps]
    from_ns = min((ns for ns in lost_ns if ns is not None), default=None)
    before = ""
    if start_ns is not None and from_ns is not None and None not in lost_ns and from_ns > start_ns:
        before = f", all before {ns_to_seconds(from_ns - start_ns):.3f} s"
    saved = f"{found.counts.total()} messages can be saved{before}"
    return DamagedLogError(found.path, found.damages, f"{saved}: pass --recover to roadperc-replay or roadperc-view")
