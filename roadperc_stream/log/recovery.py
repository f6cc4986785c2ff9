"""Reads a log once, in file order: checks it, and gives every intact message of a damaged one, with the lost times.

A cut file is read up to the cut, including the readable start of its last chunk. A damaged chunk gives the messages
before the damage, and none if only its CRC is wrong. Reading continues where the next consistent record starts.
"""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import IO, Final, Self

from deflate import crc32
from mcap import records
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log import layout
from roadperc_stream.log.chunks import INSIDE, contents_of, too_many
from roadperc_stream.log.damage import Damage, DamagedLogError, LostSpan, nothing_saved, require_magic, unopened
from roadperc_stream.log.index import Described, share_channels, summary_of
from roadperc_stream.log.limits import GuardedFile, LimitError, require_attachments, require_chunk, require_gaps
from roadperc_stream.log.records import Message
from roadperc_stream.log.search import RecordSearch, chunk_bytes, follows
from roadperc_stream.log.stored import StoredLog
from roadperc_stream.system.time import ns_to_seconds

_OF_DATA: Final = frozenset((*INSIDE, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA))
_OF_SUMMARY: Final = frozenset(Opcode) - _OF_DATA - {Opcode.HEADER, Opcode.DATA_END} | {Opcode.SCHEMA, Opcode.CHANNEL}
_SUMMARY_OPCODES: Final = frozenset(bytes([opcode]) for opcode in _OF_SUMMARY)
_MOST_END_BYTES: Final = 13
"""Largest length of the record that ends the data section; those of damaged opcodes are longer."""
_SUMMARY_CRC_AT: Final = 16
"""Offset of the summary's CRC in the footer's body."""
_MOST_LISTED: Final = 1000
"""Damages that are listed individually."""
_MOST_CUT_BYTES: Final = 256 * 1024 * 1024
"""Bytes read of a chunk that exceeds the file: perhaps only its length is wrong."""
_FAR_NS: Final = 24 * 3600 * 1_000_000_000
"""Limit for the time between messages of a log, to recognise one."""
_ANY_TIME: Final = LostSpan(None, None)
_Entry = tuple[int, int, int]
"""A message's channel, log time and offset in the data of its chunk."""
Found = tuple[layout.MessageHead, bytes | memoryview]
"""A message's fields and its record."""


@dataclass
class _Tally:
    """The messages read, by channel, and their log times."""

    counts: Counter[int] = field(default_factory=Counter)
    first_ns: int | None = None
    last_ns: int | None = None
    behind_ns: int = -1
    """Largest step back of log time from an earlier message to a later one; -1 if log times strictly ascend."""
    recent: deque[int] = field(default_factory=lambda: deque(maxlen=3))
    """The last log times; one of them may be damaged."""

    def add(self, channel_id: int, log_time_ns: int) -> None:
        """Count a message."""
        self.counts[channel_id] += 1
        self.recent.append(log_time_ns)
        latest_ns = log_time_ns if self.last_ns is None else self.last_ns
        self.first_ns = log_time_ns if self.first_ns is None else min(self.first_ns, log_time_ns)
        if self.last_ns is not None:
            self.behind_ns = max(self.behind_ns, latest_ns - log_time_ns)
        self.last_ns = max(latest_ns, log_time_ns)

    @property
    def next_ns(self) -> int | None:
        """The earliest log time expected of the next message; None before the first one."""
        return None if self.last_ns is None else self.last_ns - self.behind_ns


@dataclass
class Salvage:
    """Reads a log once and records its state. The account is complete at the end of ``messages`` or ``run``.

    Args:
        path: the log.
        inside: open all chunks. Otherwise only those are opened that have no CRC or no message indexes, and reading
            ends at the first damage.
        limits: of its records and chunks.

    Raises:
        LogError: the file cannot be opened, is empty, or does not start as an MCAP log; while reading: it exceeds the
            limits.
    """

    path: Path
    inside: bool = True
    limits: LimitsConfig = DEFAULT_LIMITS
    size_bytes: int = 0
    chunks: Counter[str] = field(default_factory=Counter)
    """Number of chunks by compression; "" for uncompressed ones."""
    index: list[records.ChunkIndex] = field(default_factory=list)
    """The intact chunks, in file order."""
    described: Described = field(default_factory=Described)
    damages: list[Damage] = field(default_factory=list)
    absent: tuple[str, ...] = ()
    """Optional parts that the log lacks: its index, CRCs."""
    notes: tuple[str, ...] = ()
    """What is wrong in the log without harm."""
    last_good_ns: int | None = None
    """Log time of the last message before the first damage."""
    all_in_chunks: bool = True
    """Whether every message is in a chunk."""
    sealed: bool = False
    """Whether the CRC of the data section covers all messages."""

    def __post_init__(self) -> None:
        self._spans: dict[int, LostSpan] = {}
        self._statistics: tuple[int, records.Statistics] | None = None
        try:
            with GuardedFile(self.path, self.limits) as stream:
                self.size_bytes = stream.size_bytes
                require_magic(self.path, stream.read(len(layout.MAGIC)))
                self._read_summary(stream)
        except OSError as error:
            raise unopened(self.path, error) from error
        self._tally = _Tally()
        self.counts = self._tally.counts
        """Messages read, by ``Channel.source_id``."""
        self.channels = self.described.channels
        """By ``Channel.source_id``, including channels without messages."""
        self._ended = self._summary_sealed = self._is_chunked = False
        self._in_data, self._covered = True, True
        self._crc: int | None = 0
        self._chunk: records.ChunkIndex | None = None
        self._held: list[_Entry] | None = None
        self._listed: list[_Entry] = []
        self._channel_sets: dict[frozenset[int], dict[int, int]] = {}
        self._follower = b""
        self._open_from = _MOST_LISTED
        self._doubts = set[int]()
        self._without_crc = self._held_bytes = self._attachments = self._metadata = 0

    def _read_summary(self, stream: IO[bytes]) -> None:
        """Take descriptions and spans from the summary, for messages whose description or chunk is damaged."""
        for item in summary_of(stream):
            match item:
                case records.Statistics():
                    self._statistics = 0, item
                case records.ChunkIndex() if item.message_start_time <= item.message_end_time:
                    self._spans[item.chunk_start_offset] = LostSpan(item.message_start_time, item.message_end_time)
                case records.Schema() | records.Channel():
                    try:
                        self.described.add(item, in_data=False)
                    except ValueError:  # comes again in reading
                        return

    @property
    def whole(self) -> bool:
        """Whether the file is complete and no damage was found."""
        return self._ended and not self.damages

    @property
    def conclusive(self) -> bool:
        """Whether the channels of all messages are known and checked, also those of unopened chunks."""
        return self.inside or (self._summary_sealed and self.counts.keys() <= self.channels.keys())

    @property
    def gaps(self) -> tuple[LostSpan, ...]:
        """The log times at which messages are lost, in file order."""
        return tuple(dict.fromkeys(damage.span for damage in self.damages if damage.span and damage.is_loss))

    @property
    def first_ns(self) -> int | None:
        """Log time of the first message; of a damaged log the first one written, if the statistics state it."""
        said = self._statistics[1] if self._statistics and self._summary_sealed and not self.whole else None
        times = (self._tally.first_ns, said.message_start_time if said and said.message_count else None)
        return min((time_ns for time_ns in times if time_ns is not None), default=None)

    @property
    def last_ns(self) -> int | None:
        """Log time of the last message read."""
        return self._tally.last_ns

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
        try:
            with GuardedFile(self.path, self.limits) as stream:
                for record, cut in self._records(stream):
                    yield from self._messages_of(record, cut)
                    if self.damages and not self.inside:
                        return
        except OSError as error:
            raise LogError(f"{self.path}: {error.strerror or error}") from error
        except LimitError as error:
            raise LogError(f"{self.path}: {error}") from error
        self._conclude()

    def _records(self, stream: IO[bytes]) -> Iterator[tuple[layout.Record, str]]:
        """Yield the file's records outside chunks, each with the reason if it is cut; empty if complete."""
        is_message = partial(_is_message, self.described, self._tally)  # a method would make a reference cycle
        search = RecordSearch(stream, self.size_bytes, is_message)
        self._crc = crc32(stream.read(len(layout.MAGIC)))
        at: int | None = len(layout.MAGIC)
        head = stream.read(layout.RECORD.size)
        known_end = at  # behind the last record of a known kind
        while at is not None:
            fault, left = self._fault(at, head), self.size_bytes - at - layout.RECORD.size
            opcode, length = layout.RECORD.unpack(head) if len(head) == layout.RECORD.size else (0, 0)
            is_chunk = opcode == Opcode.CHUNK and self._in_data
            is_cut, chunk_end = is_chunk and length > left, None
            if is_chunk and not search.leads_on(at + layout.RECORD.size + length):
                chunk_end = search.chunk_end(at)
            if fault and chunk_end is None:
                if is_cut:
                    stream.seek(at + layout.RECORD.size)
                    yield layout.Record(at, opcode, stream.read(min(left, _MOST_CUT_BYTES))), fault
                else:
                    self._lose(at, fault, self._unread)
                at = self._next(search, known_end + 1)
                known_end, head = at or 0, self._head_at(stream, at)
                continue
            if chunk_end is not None:
                words = fault or f"chunk: a record of {length} bytes leads to no other record"
                self._note(Damage(at, words, self._spans.get(at)))
                length = chunk_end - at - layout.RECORD.size
            if is_chunk:
                stream.seek(at + layout.RECORD.size)
            record = layout.Record(at, opcode, stream.read(length))
            head = stream.read(layout.RECORD.size)
            if opcode == Opcode.FOOTER:
                self._end(record, head)
                yield record, ""
                return
            if self._in_data and record.end < self.size_bytes and not self._leads_on(record, head):
                inside = self._next_inside(search, record)
                if inside is not None:
                    self._lose(at, f"{record.name}: a record of {length} bytes leads to no other record", self._unread)
                    at, known_end, head = inside, inside, self._head_at(stream, inside)
                    continue
                stream.seek(record.end + len(head))
            self._follower = head
            self._check(record)
            yield record, ""
            at = record.end
            known_end = at if opcode in layout.NAMES else known_end

    def _leads_on(self, record: layout.Record, head: bytes) -> bool:
        """Return whether a record can follow another one; ``head`` are the first bytes behind it."""
        is_summary = record.opcode != Opcode.DATA_END or head[:1] in _SUMMARY_OPCODES
        return is_summary and follows(head, self.size_bytes - record.end)

    @property
    def _unread(self) -> LostSpan:
        """The times of messages that are lost before the next one is read."""
        return LostSpan(self._tally.next_ns, None)

    def _head_at(self, stream: IO[bytes], at: int | None) -> bytes:
        if at is None:
            return b""
        stream.seek(at)
        return stream.read(layout.RECORD.size)

    def _next(self, search: RecordSearch, at: int) -> int | None:
        """Return where the next record starts behind invalid bytes; None without any, or behind the data section."""
        self._crc = None
        if not self._in_data:
            return None
        self._is_chunked = self._is_chunked or bool(self._spans) or search.has_chunk(at)
        return search.next_record(at, chunked=self._is_chunked)

    def _next_inside(self, search: RecordSearch, record: layout.Record) -> int | None:
        """Return where a record starts inside one that leads to no other; None if only the next one is damaged."""
        if record.opcode == Opcode.CHUNK and _is_chunk(record):
            return None
        crc = self._crc
        found = self._next(search, record.start + 1)
        self._crc = crc
        return found if found is not None and (found < record.end or record.opcode == Opcode.DATA_END) else None

    def _fault(self, at: int, head: bytes) -> str:
        """Return why no record can start here; empty if one can."""
        if len(head) < layout.RECORD.size:
            known = self.path.fault if isinstance(self.path, StoredLog) else ""
            return f"cut off: {known or f'the file ends after {self.size_bytes} bytes, before its footer'}"
        opcode, length = layout.RECORD.unpack(head)
        left = self.size_bytes - at - layout.RECORD.size
        if opcode == 0:
            return "no record starts here: opcode 0x00"
        if length > left:
            return f"cut off or damaged: a record of {length} bytes starts here, {left} bytes are left"
        allowed = _OF_DATA | {Opcode.DATA_END} if self._in_data else _OF_SUMMARY
        if at == len(layout.MAGIC):
            return "" if opcode == Opcode.HEADER else "no header is here"
        is_long = opcode == Opcode.DATA_END and length > _MOST_END_BYTES
        if (opcode in layout.NAMES and opcode not in allowed) or is_long:
            return f"a {layout.NAMES[opcode]} record does not belong here"
        return ""

    def _check(self, record: layout.Record) -> None:
        """Add a record to the CRC of its section, and compare that of the data section at its end."""
        if record.opcode != Opcode.DATA_END:
            self._crc = None if self._crc is None else record.crc(self._crc)
            return
        expected, found = record.number(0), self._crc
        self._in_data, self._crc = False, 0
        if not expected or found is None:
            return
        if found == expected:
            self.sealed = True
            self.damages[:] = [damage for damage in self.damages if damage.byte not in self._doubts]
        else:
            words = f"CRC of the data section is {found:#010x}, expected {expected:#010x}"
            self._note(Damage(record.start, words, _ANY_TIME))

    def _end(self, footer: layout.Record, behind: bytes) -> None:
        """Check the CRC of the summary, and the end of the file."""
        self._ended, expected = behind == layout.MAGIC, footer.number(_SUMMARY_CRC_AT)
        found = footer.crc(self._crc or 0, _SUMMARY_CRC_AT)
        self._summary_sealed = found == expected
        if expected not in {0, found}:
            words = f"CRC of the summary is {found:#010x}, expected {expected:#010x}"
            self._note(Damage(footer.start, words))
        if not self._ended:
            left = self.size_bytes - footer.end
            self._note(Damage(footer.end, f"expected the closing magic, found {left} bytes behind the footer"))

    def _messages_of(self, record: layout.Record, cut: str) -> Iterator[Found]:
        """Yield the messages of a record; store the content of any other record."""
        is_behind_chunk = self._chunk is not None
        if record.opcode != Opcode.MESSAGE_INDEX:
            self._close_chunk()
        if record.opcode == Opcode.CHUNK:
            yield from self._messages_in(record, cut)
            return
        if record.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):  # both are kept in memory
            self._held_bytes += len(record.body)
            require_attachments(self._held_bytes, self.limits)
        try:
            if record.opcode == Opcode.MESSAGE:
                if is_behind_chunk and layout.has_form_of_index(record.body):
                    raise ValueError("has the form of a message index")
                self.all_in_chunks = self._covered = False
                yield self._counted(record.body)
            elif record.opcode == Opcode.MESSAGE_INDEX:
                self._add_index(record)
            elif record.opcode not in layout.NAMES:
                self._doubt(record)
            else:
                self._describe(record.opcode, record.body, record.start)
        except LimitError:
            raise
        except layout.UNREADABLE as error:
            self._note_fault(record, error)

    def _note_fault(self, record: layout.Record, error: BaseException) -> None:
        fault = f"{record.name}: {_text_of(error)}"
        chunk = self._chunk if record.opcode == Opcode.MESSAGE_INDEX else None
        if record.opcode == Opcode.MESSAGE or _is_chunk(record) or (chunk is None and self._is_message(record.body)):
            self._lose(record.start, fault, self._unread)
        else:
            self._note(Damage(record.start, fault, None if chunk is None else _span_of(chunk)))

    def _is_message(self, body: bytes | memoryview) -> bool:
        return _is_message(self.described, self._tally, body)

    def _messages_in(self, record: layout.Record, cut: str) -> Iterator[Found]:
        """Yield the messages of a chunk if it is to be opened."""
        try:
            head = layout.chunk_head(record.body)
            if not cut:
                require_chunk(head, self.limits)
                if head.stored_bytes > len(head.stored):
                    raise ValueError(layout.TOO_SHORT)
        except layout.UNREADABLE as error:
            span = self._unread if cut else self._spans.get(record.start, self._unread)
            self._lose(record.start, cut or f"{record.name}: {_text_of(error)}", span)
            return
        self._is_chunked = True
        self.chunks[head.compression] += 1
        self._without_crc += not head.crc
        self._covered &= bool(head.crc)
        if not head.crc and head.record_bytes < record.end - record.start and not cut:
            words = (
                f"the fields of a chunk of {record.end - record.start} bytes take {head.record_bytes}, without a CRC"
            )
            self._lose_in_doubt(record.start, words)
        before = self._unread
        entry, held, faults = layout.entry_of(head, record.start, record.end - record.start), list[_Entry](), [cut]
        is_indexed = self._follower[:1] == bytes([Opcode.MESSAGE_INDEX])
        if not (self.inside or cut) and head.crc and is_indexed:
            self._chunk, self._held = entry, None
            return
        found, broken = contents_of(head, self.limits.chunk_messages)
        faults.append(broken and f"{record.name}: {broken}")
        for item in found:
            try:
                if item.opcode == Opcode.MESSAGE:
                    message, body = self._counted(item.body)
                    held.append((message.channel_id, message.log_time_ns, item.start))
                    yield message, body
                    _require_within(message.log_time_ns, entry)
                elif item.opcode in INSIDE:
                    self._describe(item.opcode, item.body)
                elif not head.crc and self._is_message(item.body):
                    raise ValueError(f"a record with opcode {item.name} has the form of a message")
            except layout.UNREADABLE as error:
                faults.append(f"{record.name}: {_text_of(error)}")
        fault = next(filter(None, faults), "")
        if not fault:
            self._chunk, self._held = entry, held
            return
        messages = sum(item.opcode == Opcode.MESSAGE for item in found)
        if not cut and not broken and messages == len(held):
            self._note(Damage(record.start, fault, self._spans.get(record.start) or _span_of(entry)))
        else:
            since = self._unread if messages == len(held) else before
            self._lose(record.start, fault, since if cut else self._spans.get(record.start, since))

    def _add_index(self, record: layout.Record) -> None:
        """Add a message index to the chunk before it; those of damaged chunks are skipped.

        Raises:
            ValueError: it is not valid, or there is no chunk before it.
        """
        if len(record.body) > (self.limits.chunk_messages + 1) * layout.ENTRY.size:
            raise ValueError(too_many(self.limits.chunk_messages))
        index = layout.message_index(record.body)
        if self._chunk is not None:
            self._chunk.message_index_offsets[index.channel_id] = record.start
            self._chunk.message_index_length += record.end - record.start
            self._listed += ((index.channel_id, *entry) for entry in index.entries)
        elif not self.damages:
            raise ValueError("there is no chunk before it")

    def _close_chunk(self) -> None:
        """End the message indexes of the last chunk: compare them with its messages, or count those of an unopened one."""
        chunk, listed, held = self._chunk, self._listed, self._held
        if chunk is None:
            return
        self._chunk, self._listed, self._held = None, [], None
        share_channels(chunk, self._channel_sets)
        self.index.append(chunk)
        if self._spans.get(chunk.chunk_start_offset, _span_of(chunk)) != _span_of(chunk):
            words = "the index states other log times of the chunk here"
            self._note(Damage(chunk.chunk_start_offset, words, _span_of(chunk)))
        if held is not None:
            if chunk.message_index_length and sorted(listed) != sorted(held):
                words = "the message indexes behind the chunk here list other messages than it has"
                is_loss = bool(set(listed) - set(held))
                span = self._spans.get(chunk.chunk_start_offset, self._unread if is_loss else _span_of(chunk))
                self._note(Damage(chunk.chunk_start_offset, words, span, is_loss))
            return
        for channel_id, time_ns, _ in listed:
            self._tally.add(channel_id, time_ns)
        try:
            for _, time_ns, _ in listed:
                _require_within(time_ns, chunk)
        except ValueError as error:
            self._note(Damage(chunk.chunk_start_offset, f"message index: {error}", _span_of(chunk)))

    def _counted(self, body: bytes | memoryview) -> Found:
        head = layout.message_head(body)
        if head.channel_id not in self.channels:
            raise ValueError(f"message of channel {head.channel_id}, which the log does not describe")
        self._tally.add(head.channel_id, head.log_time_ns)
        if self._open_from < _MOST_LISTED:
            self._end_gap(head.log_time_ns + self._tally.behind_ns)
        if not self.damages:
            self.last_good_ns = head.log_time_ns
        return head, body

    def _describe(self, opcode: int, body: bytes | memoryview, start: int | None = None) -> None:
        """Store the content of a record that is not a message; ``start`` is its first byte, None inside a chunk."""
        if opcode not in layout.PARSED:
            return
        item = layout.parse(opcode, bytes(body))
        self.described.add(item, in_data=self._in_data)
        self._attachments += opcode == Opcode.ATTACHMENT
        self._metadata += opcode == Opcode.METADATA
        if isinstance(item, records.Statistics) and start is not None:
            self._statistics = start, item
        if isinstance(item, records.Metadata):
            require_gaps(self.described.metadata[-1], self.limits)

    def _doubt(self, record: layout.Record) -> None:
        """Note a record of an unknown kind with the form of a message or chunk, unless the data section's CRC fits."""
        is_message = self._is_message(record.body)
        if self._in_data and (is_message or _is_chunk(record)):
            form = "message" if is_message else "chunk"
            self._lose_in_doubt(record.start, f"a record with opcode {record.name} has the form of a {form}")

    def _lose_in_doubt(self, byte: int, words: str) -> None:
        """Note a damage that is none if the CRC of the data section fits."""
        self._lose(byte, words, self._unread)
        self._doubts.add(byte)

    def _lose(self, byte: int, words: str, span: LostSpan) -> None:
        """Note a damage that lost messages; behind the data section there are none."""
        self._note(Damage(byte, words, span, is_loss=True) if self._in_data else Damage(byte, words))

    def _note(self, damage: Damage) -> None:
        """Add a damage; the last listed one also stands for all later ones."""
        if len(self.damages) == _MOST_LISTED:
            self.damages[-1] = self.damages[-1].with_more(damage)
        else:
            self.damages.append(damage)
        if damage.span is not None and damage.span.last_ns is None:
            self._open_from = min(self._open_from, len(self.damages) - 1)

    def _end_gap(self, last_ns: int) -> None:
        """End the spans without an end at a log time, because a message was read."""
        for number in range(self._open_from, len(self.damages)):
            damage = self.damages[number]
            if damage.span is not None and damage.span.last_ns is None:
                span = LostSpan(damage.span.first_ns, max(last_ns, damage.span.first_ns or 0))
                self.damages[number] = replace(damage, span=span)
        self._open_from = _MOST_LISTED

    def _conclude(self) -> None:
        """Compare the statistics with what was read, and find optional parts that the writer left out."""
        self._close_chunk()
        is_of_crc = [damage.span == _ANY_TIME and not damage.is_loss for damage in self.damages]
        if self.inside and self._covered and any(is_of_crc):  # the CRCs of all messages fit
            self.damages[:] = [
                replace(damage, span=None) if of_crc else damage
                for damage, of_crc in zip(self.damages, is_of_crc, strict=True)
            ]
        if self._statistics is not None and not any(damage.is_loss for damage in self.damages):
            self._compare(*self._statistics)
        lacking = {
            "index": not self._spans,
            "CRC of the data section": not self.sealed,
            f"CRCs of {self._without_crc} chunks": bool(self._without_crc),
        }
        self.absent = tuple(what for what, true in lacking.items() if true)

    def _compare(self, byte: int, said: records.Statistics) -> None:
        """Note where the statistics differ; counts of channels and times are no damage if they are not available."""
        counted = self.counts.total()
        for what, found, stated in (
            ("messages", counted, said.message_count),
            ("chunks", self.chunks.total(), said.chunk_count),
            ("attachments", self._attachments, said.attachment_count),
            ("metadata records", self._metadata, said.metadata_count),
        ):
            if found != stated:
                span = _ANY_TIME if what in ("messages", "chunks") else None
                self._note(Damage(byte, f"{found} {what} found, the statistics count {stated}", span, span is not None))
        stated_counts = +Counter(said.channel_message_counts)
        if said.message_count == counted and stated_counts and stated_counts != +self.counts:
            wrong = next(i for i in sorted({*stated_counts, *self.counts}) if stated_counts[i] != self.counts[i])
            words = f"{self.counts[wrong]} messages found on channel {wrong}, the statistics count"
            self._note(Damage(byte, f"{words} {stated_counts[wrong]}", _ANY_TIME, is_loss=True))
        span, times = LostSpan(self._tally.first_ns, self.last_ns), (said.message_start_time, said.message_end_time)
        if counted and span != LostSpan(*times):
            found_times = f"log times {span.first_ns} to {span.last_ns} ns found"
            self.notes = (f"{found_times}, the statistics state {times[0]} to {times[1]} ns",)


def audited(path: Path, limits: LimitsConfig = DEFAULT_LIMITS, *, check_chunks: bool = False) -> Salvage:
    """Return the finished account of a log.

    Args:
        path: the log.
        limits: of its records and chunks.
        check_chunks: also open chunks that only their own CRC covers. Otherwise that CRC is checked when the chunk is
            read, which is too late for a caller that skips chunks or continues behind damage.

    Raises:
        LogError: the file cannot be read, or is not MCAP.
    """
    quick = Salvage(path, inside=False, limits=limits).run()
    is_checked = quick.sealed or not check_chunks
    return quick if quick.whole and quick.conclusive and is_checked else Salvage(path, limits=limits).run()


def damage_in(found: Salvage) -> LogError:
    """Return the error for a log that is not whole."""
    if not found.counts.total():
        return nothing_saved(found.path, found.damages)
    start_ns, lost_ns = found.first_ns, [gap.first_ns for gap in found.gaps]
    from_ns = min((ns for ns in lost_ns if ns is not None), default=None)
    before = ""
    if start_ns is not None and from_ns is not None and None not in lost_ns and from_ns > start_ns:
        before = f", all before {ns_to_seconds(from_ns - start_ns):.3f} s"
    saved = f"{found.counts.total()} messages can be saved{before}"
    return DamagedLogError(found.path, found.damages, f"{saved}: pass --recover to roadperc-replay or roadperc-view")


def _is_message(described: Described, tally: _Tally, body: bytes | memoryview) -> bool:
    """Return whether these are the first bytes of a message of this log, judged by its channel and log time."""
    if len(body) < layout.MESSAGE.size or int.from_bytes(body[:2], "little") not in described.channels:
        return False  # checked first because it is cheap: there may be millions
    time_ns = layout.message_head(body).log_time_ns
    return not tally.recent or any(abs(time_ns - near_ns) < _FAR_NS for near_ns in tally.recent)


def _is_chunk(record: layout.Record) -> bool:
    """Return whether the body of a record has the form of a chunk."""
    return chunk_bytes(record.body) == record.end - record.start


def _span_of(chunk: records.ChunkIndex) -> LostSpan:
    return LostSpan(chunk.message_start_time, chunk.message_end_time)


def _require_within(log_time_ns: int, chunk: records.ChunkIndex) -> None:
    """Check that a message has a log time that its chunk states.

    Raises:
        ValueError: it has not.
    """
    first_ns, last_ns = chunk.message_start_time, chunk.message_end_time
    if not first_ns <= log_time_ns <= last_ns:
        raise ValueError(f"message at {log_time_ns} ns, its chunk states {first_ns} to {last_ns} ns")


def _text_of(error: BaseException) -> str:
    if isinstance(error, EndOfFile):
        return layout.TOO_SHORT
    return " ".join(str(error).split()) or type(error).__name__
