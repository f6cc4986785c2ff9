"""Reads a log once, in file order: checks it, and gives every intact message of a damaged one, with the lost times.

A cut file is read up to the cut, including the readable start of its last chunk. A damaged chunk gives the messages
before the damage, and none if only its CRC is wrong. Reading continues where the next consistent record starts.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import IO, Final, Self

from mcap import records
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log import layout
from roadperc_stream.log.chunks import INSIDE, contents_of, too_many
from roadperc_stream.log.damage import DamagedLogError, LostSpan, nothing_saved, require_magic, unopened
from roadperc_stream.log.index import Described, share_channels, summary_of
from roadperc_stream.log.limits import GuardedFile, LimitError, require_attachments, require_chunk, require_gaps
from roadperc_stream.log.losses import ANY_TIME, Losses
from roadperc_stream.log.records import Message
from roadperc_stream.log.search import is_chunk
from roadperc_stream.log.stored import AnyLog, LogFile
from roadperc_stream.log.walking import Walk
from roadperc_stream.system.time import ns_to_seconds

_INDEX: Final = bytes([Opcode.MESSAGE_INDEX])
_Entry = tuple[int, int, int]
"""A message's channel, log time and offset in the data of its chunk."""
Found = tuple[layout.MessageHead, bytes | memoryview]
"""A message's fields and its record."""


@dataclass
class _Chunk:
    """A chunk whose message indexes come next: the messages that they list, and those that it has if it was opened."""

    entry: records.ChunkIndex
    held: list[_Entry] | None
    listed: list[_Entry] = field(default_factory=list)

    @property
    def span(self) -> LostSpan:
        return LostSpan(self.entry.message_start_time, self.entry.message_end_time)

    def add(self, record: layout.Record) -> None:
        """Add a message index."""
        index = layout.message_index(record.body)
        self.entry.message_index_offsets[index.channel_id] = record.start
        self.entry.message_index_length += record.end - record.start
        self.listed += ((index.channel_id, *place) for place in index.entries)

    def require_within(self, log_time_ns: int) -> None:
        """Check that a message has a log time that the chunk states.

        Raises:
            ValueError: it has not.
        """
        first_ns, last_ns = self.entry.message_start_time, self.entry.message_end_time
        if not first_ns <= log_time_ns <= last_ns:
            raise ValueError(f"message at {log_time_ns} ns, its chunk states {first_ns} to {last_ns} ns")


@dataclass
class Salvage:
    """Reads a log once and records its state. The account is complete at the end of ``messages`` or ``run``.

    Args:
        source: the log.
        inside: open all chunks. Otherwise only those are opened that have no CRC or no message indexes, and reading
            ends at the first damage.
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
    sealed: bool = False
    """Whether the CRC of the data section covers all messages."""
    whole: bool = False
    """Whether the file is complete and no damage was found."""
    conclusive: bool = False
    """Whether the channels of all messages are known and checked, also those of unopened chunks."""

    def __post_init__(self) -> None:
        self.counts = self.losses.counts
        """Messages read, by ``Channel.source_id``."""
        self.damages = self.losses.damages
        """In file order."""
        self.channels = self.described.channels
        """By ``Channel.source_id``, including channels without messages."""
        self.file = LogFile.of(self.source)
        self.path = self.file.name
        self._spans: dict[int, LostSpan] = {}
        self._statistics: tuple[int, records.Statistics] | None = None
        try:
            with GuardedFile(self.file, self.limits) as stream:
                self.size_bytes = stream.size_bytes
                require_magic(self.path, stream.read(len(layout.MAGIC)))
                self._read_summary(stream)
        except OSError as error:
            raise unopened(self.path, error) from error
        self._chunk: _Chunk | None = None
        self._channel_sets: dict[frozenset[int], dict[int, int]] = {}
        self._kinds = Counter[int]()
        self._first_written_ns: int | None = None
        self._without_crc = self._held_bytes = 0

    def _read_summary(self, stream: IO[bytes]) -> None:
        """Take descriptions and spans from the summary, for messages whose description or chunk is damaged."""
        with suppress(ValueError):  # comes again in reading
            for item in summary_of(stream):
                match item:
                    case records.ChunkIndex() if item.message_start_time <= item.message_end_time:
                        self._spans[item.chunk_start_offset] = LostSpan(item.message_start_time, item.message_end_time)
                    case records.Schema() | records.Channel():
                        self.described.add(item, in_data=False)

    @property
    def first_ns(self) -> int | None:
        """Log time of the first message; of a damaged log the first one written, if the statistics state it."""
        times = (self.losses.first_ns, self._first_written_ns)
        return min((time_ns for time_ns in times if time_ns is not None), default=None)

    @property
    def last_ns(self) -> int | None:
        """Log time of the last message read."""
        return self.losses.last_ns

    def messages(self) -> Iterator[Message]:
        """Yield every readable message, in file order."""
        for head, body in self._found():
            yield head.of(self.channels[head.channel_id], body)

    def run(self) -> Self:
        """Read everything for the account alone."""
        for _ in self._found():
            pass
        return self

    def _found(self) -> Iterator[Found]:
        is_message = partial(_is_message, self.described, self.losses)  # a method would make a reference cycle
        try:
            with GuardedFile(self.file, self.limits) as stream:
                walk = Walk(stream, self.size_bytes, self.losses, is_message, self._spans, self.file.fault)
                for record, cut in walk.records():
                    yield from self._messages_of(record, cut, walk)
                    if self.damages and not self.inside:
                        return
        except OSError as error:
            raise LogError(f"{self.path}: {error.strerror or error}") from error
        except LimitError as error:
            raise LogError(f"{self.path}: {error}") from error
        self._conclude(walk)

    def _messages_of(self, record: layout.Record, cut: str, walk: Walk) -> Iterator[Found]:
        """Yield the messages of a record; store the content of any other record."""
        is_behind_chunk = self._chunk is not None
        if record.opcode != Opcode.MESSAGE_INDEX:
            self._close_chunk()
        try:
            if record.opcode == Opcode.CHUNK:
                yield from self._messages_in(record, cut, walk)
            elif record.opcode == Opcode.MESSAGE:
                yield self._outside(record, is_behind_chunk=is_behind_chunk)
            elif record.opcode == Opcode.MESSAGE_INDEX:
                self._add_index(record)
            elif record.opcode in layout.NAMES:
                self._describe(record.opcode, record.body, record.start, walk)
            elif walk.is_in_data and (self._is_message(record.body) or is_chunk(record.body)):
                words = f"a record with opcode {record.name} has the form of a message or chunk"
                self.losses.note_doubt(record.start, words)
        except layout.UNREADABLE as error:
            if isinstance(error, LimitError) and record.opcode != Opcode.CHUNK:
                raise
            self._note_fault(record, cut, f"{record.name}: {_text_of(error)}", walk)

    def _outside(self, record: layout.Record, *, is_behind_chunk: bool) -> Found:
        """Return a message outside chunks.

        Raises:
            ValueError: it is not valid, or a message index with a damaged opcode.
        """
        if is_behind_chunk and layout.has_form_of_index(record.body):
            raise ValueError("has the form of a message index")
        self.all_in_chunks = False
        return self._counted(record.body)

    def _note_fault(self, record: layout.Record, cut: str, fault: str, walk: Walk) -> None:
        """Note a record that cannot be read; it may be a message or a chunk whose opcode is damaged."""
        chunk = self._chunk if record.opcode == Opcode.MESSAGE_INDEX else None
        is_loss = record.opcode in (Opcode.MESSAGE, Opcode.CHUNK) or is_chunk(record.body)
        is_loss |= chunk is None and self._is_message(record.body)
        if walk.is_in_data and is_loss:
            span = self.losses.unread if cut else self._span_at(record.start)
            self.losses.note(record.start, cut or fault, span, is_loss=True)
        else:
            self.losses.note(record.start, fault, None if chunk is None else chunk.span)

    def _span_at(self, start: int) -> LostSpan:
        """Return the times of a lost chunk from the index, else those up to the next message."""
        return self._spans.get(start, self.losses.unread)

    def _is_message(self, body: bytes | memoryview) -> bool:
        return _is_message(self.described, self.losses, body)

    def _messages_in(self, record: layout.Record, cut: str, walk: Walk) -> Iterator[Found]:
        """Yield the messages of a chunk if it is to be opened.

        Raises:
            ValueError, McapError: its fields are not valid, or exceed the limits.
        """
        head, length = layout.chunk_head(record.body), record.end - record.start
        if not cut:
            require_chunk(head, self.limits)
        walk.is_chunked = True
        self.chunks[head.compression] += 1
        self._without_crc += not head.crc
        if not (head.crc or cut) and head.record_bytes < length:
            words = f"the fields of a chunk of {length} bytes take {head.record_bytes}, and it has no CRC"
            self.losses.note_doubt(record.start, words)
        chunk = _Chunk(layout.entry_of(head, record.start, length), None)
        if self.inside or cut or not head.crc or walk.head[:1] != _INDEX:
            yield from self._opened(chunk, head, cut, walk)
        else:
            self._chunk = chunk

    def _opened(self, chunk: _Chunk, head: layout.ChunkHead, cut: str, walk: Walk) -> Iterator[Found]:
        """Yield the messages in a chunk; note what is wrong with it."""
        start, before = chunk.entry.chunk_start_offset, self.losses.unread
        (found, broken), held = contents_of(head, self.limits.chunk_messages), list[_Entry]()
        faults = [cut, broken and f"chunk: {broken}"]
        for item in found:
            try:
                if item.opcode == Opcode.MESSAGE:
                    message, body = self._counted(item.body)
                    held.append((message.channel_id, message.log_time_ns, item.start))
                    yield message, body
                    chunk.require_within(message.log_time_ns)
                elif item.opcode in INSIDE:
                    self._describe(item.opcode, item.body, start, walk)
                elif not head.crc and self._is_message(item.body):
                    raise ValueError(f"a record with opcode {item.name} has the form of a message")
            except layout.UNREADABLE as error:
                faults.append(f"chunk: {_text_of(error)}")
        is_read = len(held) == sum(item.opcode == Opcode.MESSAGE for item in found)
        fault = next(filter(None, faults), "")
        if not fault:
            self._chunk, chunk.held = chunk, held
        elif cut:
            self.losses.note(start, fault, self.losses.unread if is_read else before, is_loss=True)
        elif broken or not is_read:
            self.losses.note(start, fault, self._spans.get(start, before), is_loss=True)
        else:
            self.losses.note(start, fault, self._spans.get(start, chunk.span))

    def _add_index(self, record: layout.Record) -> None:
        """Add a message index to the chunk before it; those of damaged chunks are skipped.

        Raises:
            ValueError: it is not valid, or there is no chunk before it.
        """
        if len(record.body) > (self.limits.chunk_messages + 1) * layout.ENTRY.size:
            raise ValueError(too_many(self.limits.chunk_messages))
        if self._chunk is not None:
            self._chunk.add(record)
        elif not self.damages:
            raise ValueError("there is no chunk before it")

    def _close_chunk(self) -> None:
        """End the message indexes of a chunk: compare them with its messages, or count those of an unopened one."""
        chunk, self._chunk = self._chunk, None
        if chunk is None:
            return
        start, listed, held = chunk.entry.chunk_start_offset, chunk.listed, chunk.held
        share_channels(chunk.entry, self._channel_sets)
        self.index.append(chunk.entry)
        if self._spans.get(start, chunk.span) != chunk.span:
            self.losses.note(start, "the index states other log times of the chunk here", chunk.span)
        if held is None:
            for channel_id, time_ns, _ in listed:
                self.losses.count(channel_id, time_ns)
            try:
                for _, time_ns, _ in listed:
                    chunk.require_within(time_ns)
            except ValueError as error:
                self.losses.note(start, f"message index: {error}", chunk.span)
        elif chunk.entry.message_index_length and sorted(listed) != sorted(held):
            words, is_loss = "the message indexes behind the chunk here list other messages", not {*listed} <= {*held}
            self.losses.note(start, words, self._span_at(start) if is_loss else chunk.span, is_loss=is_loss)

    def _counted(self, body: bytes | memoryview) -> Found:
        head = layout.message_head(body)
        if head.channel_id not in self.channels:
            raise ValueError(f"message of channel {head.channel_id}, which the log does not describe")
        self.losses.count(head.channel_id, head.log_time_ns)
        return head, body

    def _describe(self, opcode: int, body: bytes | memoryview, start: int, walk: Walk) -> None:
        """Store the content of a record that is not a message; ``start`` is its first byte, or that of its chunk."""
        if opcode not in layout.PARSED:
            return
        if opcode in (Opcode.ATTACHMENT, Opcode.METADATA):  # both are kept in memory
            self._held_bytes += len(body)
            require_attachments(self._held_bytes, self.limits)
        item = layout.parse(opcode, bytes(body))
        self.described.add(item, in_data=walk.is_in_data)
        self._kinds[opcode] += 1
        if isinstance(item, records.Statistics):
            self._statistics = start, item
        if isinstance(item, records.Metadata):
            require_gaps(self.described.metadata[-1], self.limits)

    def _conclude(self, walk: Walk) -> None:
        """Compare the statistics with what was read, and find optional parts that the writer left out."""
        self._close_chunk()
        self.sealed = walk.is_sealed
        if self.inside and self.all_in_chunks and not self._without_crc:
            self.losses.spare_messages()
        if self._statistics is not None and not self.losses.gaps:
            self._compare(*self._statistics)
        self.whole = walk.is_ended and not self.damages
        said = self._statistics[1] if self._statistics and walk.is_summary_sealed and self.damages else None
        self._first_written_ns = said.message_start_time if said and said.message_count else None
        self.conclusive = self.inside or (walk.is_summary_sealed and self.counts.keys() <= self.channels.keys())
        lacking = {
            "index": not self._spans,
            "CRC of the data section": not self.sealed,
            f"CRCs of {self._without_crc} chunks": bool(self._without_crc),
        }
        self.absent = tuple(what for what, true in lacking.items() if true)

    def _compare(self, byte: int, said: records.Statistics) -> None:
        """Note where the statistics differ; wrong times harm nothing, and no counts of channels are allowed."""
        counted, stated = self.counts.total(), +Counter(said.channel_message_counts)
        facts = [
            ("messages found", counted, said.message_count),
            ("chunks found", self.chunks.total(), said.chunk_count),
            ("attachments found", self._kinds[Opcode.ATTACHMENT], said.attachment_count),
            ("metadata records found", self._kinds[Opcode.METADATA], said.metadata_count),
        ]
        if stated and said.message_count == counted:
            facts += [(f"messages found on channel {i}", self.counts[i], stated[i]) for i in {**stated, **self.counts}]
        for what, found, expected in facts:
            if found != expected:
                is_loss = what.startswith(("messages", "chunks"))
                words = f"{found} {what}, the statistics count {expected}"
                self.losses.note(byte, words, ANY_TIME if is_loss else None, is_loss=is_loss)
        span, times = (self.losses.first_ns, self.last_ns), (said.message_start_time, said.message_end_time)
        if counted and span != times:
            found_times = f"log times {span[0]} to {span[1]} ns found"
            self.notes = (f"{found_times}, the statistics state {times[0]} to {times[1]} ns",)


def audited(source: AnyLog, limits: LimitsConfig = DEFAULT_LIMITS, *, check_chunks: bool = False) -> Salvage:
    """Return the finished account of a log.

    Args:
        source: the log.
        limits: of its records and chunks.
        check_chunks: also open chunks that only their own CRC covers. Otherwise that CRC is checked when the chunk is
            read, which is too late for a caller that skips chunks or continues behind damage.

    Raises:
        LogError: the file cannot be read, or is not MCAP.
    """
    quick = Salvage(source, inside=False, limits=limits).run()
    is_checked = quick.sealed or not check_chunks
    return quick if quick.whole and quick.conclusive and is_checked else Salvage(source, limits=limits).run()


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


def _is_message(described: Described, losses: Losses, body: bytes | memoryview) -> bool:
    """Return whether these are the first bytes of a message of this log, judged by its channel and log time."""
    if len(body) < layout.MESSAGE.size or int.from_bytes(body[:2], "little") not in described.channels:
        return False  # checked first because it is cheap: there may be millions
    return losses.is_near(layout.message_head(body).log_time_ns)


def _text_of(error: BaseException) -> str:
    if isinstance(error, EndOfFile):
        return layout.TOO_SHORT
    return " ".join(str(error).split()) or type(error).__name__
