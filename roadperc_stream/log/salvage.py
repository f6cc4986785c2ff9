"""Reading all that can be read of a log, in the order of the file, whatever happened to it.

A file that is cut is read up to the cut, what is whole of its last chunk included. A chunk that is damaged gives what
stands before the damage, and reading goes on at the next record: the one the index names, or else the next one whose
fields fit together. What was read is compared with index and statistics.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import IO, Final

from mcap import records
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log.chunks import contents_of, too_many
from roadperc_stream.log.damage import Damage, require_log, unopened
from roadperc_stream.log.framing import BREAK, Framing, is_chunk
from roadperc_stream.log.index import Described, data_end_of, index_of, places_of, summary_fits
from roadperc_stream.log.inventory import Gap, Inventory, Losses, Positions, expected_messages, lost_in_chunk
from roadperc_stream.log.layout import (
    ENTRY,
    MESSAGE,
    PARSED,
    TOO_SHORT,
    UNREADABLE,
    ChunkHead,
    MessageHead,
    Record,
    chunk_head,
    message_head,
    parse,
)
from roadperc_stream.log.limits import GuardedFile, LimitError, require_attachments, require_chunk, require_gaps
from roadperc_stream.log.records import Message

_PRIVATE_BIT: Final = 0x80
_OF_MESSAGES: Final = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.MESSAGE_INDEX))
"""Records of the data section without which messages are lost, or that say something else of them."""
_FAR_NS: Final = 24 * 3600 * 1_000_000_000
"""Messages of a log are closer together than this."""

Found = tuple[MessageHead, bytes | memoryview]
"""A message's fields, and its record."""


@dataclass
class Salvage:
    """Reads a log once and keeps account of its state: complete when ``messages`` or ``run`` has come to its end.

    Args:
        path: the log.
        inside: look inside chunks. Without that, only what stands around them is compared, up to the first damage:
            enough for a whole log whose bytes are covered by CRCs, where ``conclusive``.
        limits: of its records and chunks.

    Raises:
        LogError: the file cannot be opened, is empty, or does not start as an MCAP log; while it is read, that it is
            beyond the limits.
    """

    path: Path
    inside: bool = True
    limits: LimitsConfig = DEFAULT_LIMITS
    size_bytes: int = 0
    chunks: Counter[str] = field(default_factory=Counter)
    """Chunks by their compression, empty for none."""
    described: Described = field(default_factory=Described)
    absent: tuple[str, ...] = ()
    """What a log may do without, and this one does: its index, CRCs."""
    last_good_ns: int | None = None
    """Log time of the last message before the first damage."""
    all_in_chunks: bool = True
    """Whether every message that was read is in a chunk: no index names the others."""

    def __post_init__(self) -> None:
        try:
            with GuardedFile(self.path, self.limits) as stream:
                self.size_bytes = stream.size_bytes
                require_log(self.path, stream)
                parsed = index_of(stream)
                resume_at = () if parsed is None else places_of(parsed, data_end_of(stream))
                self._is_without_index = parsed is None
                self.index = parsed if summary_fits(stream) else None
                """What the file says at its end, where its CRC fits and it names all of the file."""
        except OSError as error:
            raise unopened(self.path, error) from error
        self._entries = {entry.chunk_start_offset: entry for entry in self.index.chunk_indexes} if self.index else {}
        if parsed is not None:  # also with a wrong CRC: what the data describe differently takes its place
            self.described.add_index(parsed)
        self._inventory, self._losses = Inventory(), Losses()
        is_message = partial(_is_message, self.described, self._inventory)  # not of this object: it is freed at once
        self._framing = Framing(self.size_bytes, resume_at, is_message)
        self.damages = self._framing.damages
        """Where the file is not what it should be, in its order."""
        self.counts = self._inventory.counts
        """Messages read, by ``Channel.source_id``."""
        self.channels = self.described.channels
        """By ``Channel.source_id``, also those without messages."""
        self._chunks_without_crc = self._open_at = self._held_bytes = 0
        self._covered = True
        """Whether every message that was read is in a chunk with a CRC."""
        self._stream: IO[bytes] | None = None

    @property
    def whole(self) -> bool:
        """Whether everything that was written is there, as far as the file lets anybody know."""
        return self._framing.ended and not self.damages

    @property
    def conclusive(self) -> bool:
        """Whether the messages of all chunks that were not opened were counted and are covered by CRCs."""
        is_covered = (self._covered or self._framing.sealed) and self._framing.summary_sealed
        return self.inside or (self._inventory.conclusive and is_covered)

    @property
    def sealed(self) -> bool:
        """Whether the bytes of the messages were checked: not those of chunks that were not opened."""
        return self.inside or self._framing.sealed

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """Where messages were lost, in the order of the file."""
        return self._losses.all

    @property
    def undescribed(self) -> dict[int, int]:
        """Messages of channels that nothing describes, by channel; they are lost."""
        return dict(self._losses.undescribed)

    @property
    def first_ns(self) -> int | None:
        """Log time of the first message that was written, as far as the index says, else of the first one read."""
        return self._inventory.first_ns if self._statistics is None else self._statistics.message_start_time

    @property
    def last_ns(self) -> int | None:
        """Log time of the last message that was read."""
        return self._inventory.last_ns

    @property
    def written(self) -> dict[int, int] | None:
        """Messages that were written, by ``Channel.source_id``; None without an index."""
        return None if self._statistics is None else dict(self._statistics.channel_message_counts)

    @property
    def _statistics(self) -> records.Statistics | None:
        """What the index says in numbers."""
        return self.index.statistics if self.index else None

    def messages(self) -> Iterator[Message]:
        """Every message that can be read, in the order of the file."""
        for head, body in self._found():
            yield head.of(self.channels[head.channel_id], body)

    def run(self) -> None:
        """Read everything for the account alone."""
        for _ in self._found():
            pass

    def _found(self) -> Iterator[Found]:
        try:
            with GuardedFile(self.path, self.limits) as stream:
                self._stream = stream
                for record in self._framing.records(stream):
                    if record.opcode == BREAK:
                        self._note_break(record)
                    else:
                        yield from self._messages_of(record)
                    if self.damages and not self.inside:
                        return
        except OSError as error:
            raise LogError(f"{self.path}: {error.strerror or error}") from error
        except LimitError as error:
            raise LogError(f"{self.path}: {error}") from error
        self._conclude()

    def _messages_of(self, record: Record) -> Iterator[Found]:
        """The messages of a record: one, a chunk's, or none of any other, which is taken note of."""
        if record.opcode != Opcode.MESSAGE_INDEX:
            self._framing.note(self._inventory.close_chunk())
        if record.opcode == Opcode.CHUNK:
            yield from self._chunk(record)
            return
        if record.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):  # they are held in memory
            self._held_bytes += len(record.body)
            require_attachments(self._held_bytes, self.limits)
        try:
            if record.opcode == Opcode.MESSAGE:
                self.all_in_chunks = self._covered = False
                yield self._counted(record.body)
            elif record.opcode == Opcode.MESSAGE_INDEX:
                if len(record.body) > (self.limits.chunk_messages + 1) * ENTRY.size:
                    raise ValueError(too_many(self.limits.chunk_messages))
                self._inventory.add_message_index(record)
            elif record.opcode >= _PRIVATE_BIT:
                self._require_private(record)
            else:
                self._note(record.opcode, bytes(record.body), record.start)
        except LimitError:
            raise
        except UNREADABLE as error:
            of_messages = record.opcode in _OF_MESSAGES and self._framing.summary_start is None
            words, span_ns = f"{record.name}: {_in_words(error)}", self._inventory.span_ns
            self._framing.note(Damage(record.start, words, *span_ns, of_messages))

    def _chunk(self, record: Record) -> Iterator[Found]:
        try:
            head = chunk_head(record.body)
            if not record.fault:
                require_chunk(head, self.limits)
        except UNREADABLE as error:
            self._lose(record, None, Positions(), record.fault or f"{record.name}: {_in_words(error)}")
            return
        self.chunks[head.compression] += 1
        self._chunks_without_crc += not head.crc
        self._covered &= bool(head.crc)
        if not self.inside and not record.fault:
            self._inventory.add_chunk(record, head, None)
            return
        (found, broken), positions = contents_of(head, self.limits.chunk_messages), Positions()
        faults = [record.fault, broken and f"{record.name}: {broken}"]
        for item in found:
            try:
                if item.opcode != Opcode.MESSAGE:
                    self._note(item.opcode, bytes(item.body))
                    continue
                message, body = self._counted(item.body)
            except UNREADABLE as error:
                faults.append(f"{record.name}: {_in_words(error)}")
                continue
            positions.setdefault(message.channel_id, []).append((message.log_time_ns, item.start))
            yield message, body
            if not head.first_ns <= message.log_time_ns <= head.last_ns:
                span = f"{head.first_ns} to {head.last_ns} ns"
                faults.append(f"{record.name}: message at {message.log_time_ns} ns, its chunk says {span}")
        if fault := next(filter(None, faults), ""):
            messages = sum(item.opcode == Opcode.MESSAGE for item in found)
            all_read = not broken and messages == sum(map(len, positions.values()))
            self._lose(record, head, positions, fault, all_read=all_read)
        else:
            self._inventory.add_chunk(record, head, positions)

    def _counted(self, body: bytes | memoryview) -> Found:
        head = message_head(body)
        if head.channel_id not in self.channels:
            self._losses.add_undescribed(head.channel_id, head.log_time_ns)
            raise ValueError(f"message of channel {head.channel_id}, which nothing describes")
        self._inventory.add_message(head.channel_id, head.log_time_ns)
        last_ns = head.log_time_ns + self._inventory.behind_ns
        if self._losses.settle(last_ns):
            self._bound_damages(None, last_ns)
        if not self.damages:
            self.last_good_ns = head.log_time_ns
        return head, body

    def _lose(
        self, record: Record, head: ChunkHead | None, saved: Positions, fault: str, *, all_read: bool = False
    ) -> None:
        """Take note of a damaged chunk, and of which of its messages were lost."""
        entry = self._entries.get(record.start)
        self._inventory.lose_chunk()
        span: tuple[int, int] | None = None
        end, next_ns = record.end, self._inventory.next_ns
        if entry is not None:
            span = entry.message_start_time, entry.message_end_time
            end = record.start + entry.chunk_length
        elif head is not None:
            span = (head.first_ns, head.last_ns) if head.first_ns <= head.last_ns else None
            end = record.start + head.record_bytes if record.fault else end
        assert self._stream is not None
        gap = lost_in_chunk(expected_messages(self._stream, end), saved, span, next_ns, all_read=all_read)
        is_open = entry is None and (bool(record.fault) or span is None)
        if gap is not None:
            self._open_at = record.start
            self._losses.add(gap, is_open=is_open)
        first_ns, last_ns = span or (next_ns, None)
        self._framing.damaged(record.start, fault, first_ns, None if is_open else last_ns)

    def _note_break(self, record: Record) -> None:
        """Where no record could start, messages are lost up to the next one."""
        if not self._losses.is_open:
            self._open_at = record.start
        self._losses.add(Gap(self._inventory.next_ns, None), is_open=True)
        self._bound_damages(self._inventory.next_ns, None)

    def _bound_damages(self, first_ns: int | None, last_ns: int | None) -> None:
        """The damages of the gap that is open, or just ended, concern messages between these log times."""
        for number in range(len(self.damages) - 1, -1, -1):
            damage = self.damages[number]
            if damage.byte < self._open_at:
                return
            self.damages[number] = replace(damage, first_ns=damage.first_ns or first_ns, last_ns=last_ns)

    def _require_private(self, record: Record) -> None:
        """An application's own record does not have the form of messages: then its type is not what was written."""
        opcode = record.opcode & ~_PRIVATE_BIT
        if opcode == Opcode.MESSAGE and self._framing.is_message(bytes(record.body)):
            raise ValueError("is a message by its form")
        if opcode == Opcode.CHUNK and is_chunk(record.body, len(record.body)):
            raise ValueError("is a chunk by its form")

    def _note(self, opcode: int, body: bytes, start: int | None = None) -> None:
        """Keep what a record other than a message says; ``start`` is its first byte, None inside a chunk."""
        if opcode in PARSED:
            item = parse(opcode, body, spare_allowed=start is None)
            if start is not None:
                self._inventory.note(start, item)
            self.described.add(item, in_data=self._framing.summary_start is None)
            if isinstance(item, records.Metadata):
                require_gaps(self.described.metadata[-1], self.limits)

    def _conclude(self) -> None:
        """What only the end shows: records that fell out without a trace, and what the writer left out."""
        self._framing.note(self._inventory.close_chunk())
        if not self._framing.has_place and self.conclusive:
            for damage in self._inventory.discrepancies(self._framing.summary_start):
                self._framing.note(damage)
        if self._covered and self.inside:
            self._framing.explain_data_crc()
        lacking = {
            "index": self._is_without_index,
            "CRC of the data section": not self._framing.sealed,
            f"CRCs of {self._chunks_without_crc} chunks": bool(self._chunks_without_crc),
        }
        self.absent = tuple(what for what, true in lacking.items() if true)


def _is_message(described: Described, inventory: Inventory, body: bytes) -> bool:
    """Whether these are the first bytes of a message of this log, by its channel and its log time."""
    if len(body) < MESSAGE.size or int.from_bytes(body[:2], "little") not in described.channels:
        return False  # cheap: there may be millions
    head = message_head(body)
    near_ns = inventory.last_ns or head.log_time_ns
    return abs(head.log_time_ns - near_ns) < _FAR_NS


def _in_words(error: BaseException) -> str:
    if isinstance(error, EndOfFile):
        return TOO_SHORT
    return " ".join(str(error).split()) or type(error).__name__
