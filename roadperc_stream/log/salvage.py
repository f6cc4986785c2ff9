"""Reads everything that can be read of a damaged log, in file order, and finds what was lost.

A cut file is read up to the cut, including the readable start of its last chunk. A damaged chunk gives the messages
before the damage. Reading continues at the next record that the index names, or else at the next one whose fields are
consistent. The messages found are compared with index and statistics.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import IO, Final, Self

from mcap import records
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import LogError
from roadperc_stream.log import layout
from roadperc_stream.log.chunks import contents_of, too_many
from roadperc_stream.log.damage import Damage, require_magic, unopened
from roadperc_stream.log.framing import BREAK, Framing, is_chunk
from roadperc_stream.log.index import Described, data_end_of, index_of, places_of, summary_fits
from roadperc_stream.log.inventory import Gap, Inventory, Losses, Positions, expected_messages, lost_in_chunk, span_of
from roadperc_stream.log.limits import GuardedFile, LimitError, require_attachments, require_chunk, require_gaps
from roadperc_stream.log.records import Message
from roadperc_stream.log.stored import StoredLog

_OF_MESSAGES: Final = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.MESSAGE_INDEX))
"""Records of the data section whose damage affects messages."""
_FAR_NS: Final = 24 * 3600 * 1_000_000_000
"""Limit for the time between messages of a log."""

Found = tuple[layout.MessageHead, bytes | memoryview]
"""A message's fields and its record."""


@dataclass
class Salvage:
    """Reads a log once and records its state. The account is complete at the end of ``messages`` or ``run``.

    Args:
        path: the log.
        inside: open chunks. Otherwise only the records around them are compared, up to the first damage. This is
            enough for a whole log that CRCs cover, if the result is ``conclusive``.
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
    described: Described = field(default_factory=Described)
    absent: tuple[str, ...] = ()
    """Optional parts that the log lacks: its index, CRCs."""
    last_good_ns: int | None = None
    """Log time of the last message before the first damage."""
    all_in_chunks: bool = True
    """Whether every message is in a chunk: an index names no others."""

    def __post_init__(self) -> None:
        try:
            with GuardedFile(self.path, self.limits) as stream:
                self.size_bytes = stream.size_bytes
                require_magic(self.path, stream.read(len(layout.MAGIC)))
                parsed = index_of(stream)
                resume_at = () if parsed is None else places_of(parsed, data_end_of(stream))
                self._is_without_index = parsed is None
                self.index = parsed if summary_fits(stream) else None
                """The file's index, if its CRC is correct and it covers the whole file."""
        except OSError as error:
            raise unopened(self.path, error) from error
        self._entries = {entry.chunk_start_offset: entry for entry in self.index.chunk_indexes} if self.index else {}
        if parsed is not None:  # even with a wrong CRC: descriptions in the data section replace these
            self.described.add_index(parsed)
        self._inventory, self.losses = Inventory(), Losses()
        is_message = partial(_is_message, self.described, self._inventory)  # a method would make a reference cycle
        fault = self.path.fault if isinstance(self.path, StoredLog) else ""
        self._framing = Framing(self.size_bytes, resume_at, is_message, fault)
        self.damages = self._framing.damages
        """In file order."""
        self.counts = self._inventory.counts
        """Messages read, by ``Channel.source_id``."""
        self.channels = self.described.channels
        """By ``Channel.source_id``, including channels without messages."""
        self._chunks_without_crc = self._open_at = self._held_bytes = 0
        self._covered = True
        """Whether every message read is in a chunk with a CRC."""
        self._stream: IO[bytes] | None = None

    @property
    def whole(self) -> bool:
        """Whether the file is complete and no damage was found."""
        return self._framing.ended and not self.damages

    @property
    def conclusive(self) -> bool:
        """Whether the messages of all unopened chunks are counted and covered by CRCs."""
        is_covered = (self._covered or self._framing.sealed) and self._framing.summary_sealed
        return self.inside or (self._inventory.conclusive and is_covered)

    @property
    def sealed(self) -> bool:
        """Whether the bytes of all messages were checked, including those of unopened chunks."""
        return self.inside or self._framing.sealed

    @property
    def first_ns(self) -> int | None:
        """Log time of the first message written, from the index; without one, of the first message read."""
        return self._inventory.first_ns if self._statistics is None else self._statistics.message_start_time

    @property
    def last_ns(self) -> int | None:
        """Log time of the last message read."""
        return self._inventory.last_ns

    @property
    def written(self) -> dict[int, int] | None:
        """Number of messages written, by ``Channel.source_id``; None without an index."""
        return None if self._statistics is None else dict(self._statistics.channel_message_counts)

    @property
    def _statistics(self) -> records.Statistics | None:
        return self.index.statistics if self.index else None

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
                self._stream = stream
                for record in self._framing.records(stream):
                    if record.opcode == BREAK:  # the messages up to the next record are lost
                        if not self.losses.is_open:
                            self._open_at = record.start
                        self.losses.add(Gap(self._inventory.next_ns, None), is_open=True)
                        self._bound_damages(self._inventory.next_ns, None)
                    else:
                        yield from self._messages_of(record)
                    if self.damages and not self.inside:
                        return
        except OSError as error:
            raise LogError(f"{self.path}: {error.strerror or error}") from error
        except LimitError as error:
            raise LogError(f"{self.path}: {error}") from error
        self._conclude()

    def _messages_of(self, record: layout.Record) -> Iterator[Found]:
        """Yield the messages of a record; store the content of any other record."""
        if record.opcode != Opcode.MESSAGE_INDEX:
            self._framing.note(self._inventory.close_chunk())
        if record.opcode == Opcode.CHUNK:
            yield from self._chunk(record)
            return
        if record.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):  # both are kept in memory
            self._held_bytes += len(record.body)
            require_attachments(self._held_bytes, self.limits)
        try:
            if record.opcode == Opcode.MESSAGE:
                self.all_in_chunks = self._covered = False
                yield self._counted(record.body)
            elif record.opcode == Opcode.MESSAGE_INDEX:
                if len(record.body) > (self.limits.chunk_messages + 1) * layout.ENTRY.size:
                    raise ValueError(too_many(self.limits.chunk_messages))
                self._inventory.add_message_index(record)
            elif record.opcode not in layout.NAMES:
                self._require_unknown(record)
            else:
                self._note(record.opcode, bytes(record.body), record.start)
        except LimitError:
            raise
        except layout.UNREADABLE as error:
            of_messages = record.opcode in _OF_MESSAGES and self._framing.summary_start is None
            chunk, fault = self._inventory.chunk, f"{record.name}: {_text_of(error)}"
            first_ns, last_ns = (None, None) if chunk is None else span_of(chunk)
            self._framing.note(Damage(record.start, fault, first_ns, last_ns, of_messages))

    def _chunk(self, record: layout.Record) -> Iterator[Found]:
        try:
            head = layout.chunk_head(record.body)
            if not record.fault:
                require_chunk(head, self.limits)
        except layout.UNREADABLE as error:
            fault = record.fault or f"{record.name}: {_text_of(error)}"
            self._lose(record, None, Positions(), fault, all_read=False)
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
            except layout.UNREADABLE as error:
                faults.append(f"{record.name}: {_text_of(error)}")
                continue
            positions.setdefault(message.channel_id, []).append((message.log_time_ns, item.start))
            yield message, body
            if not head.first_ns <= message.log_time_ns <= head.last_ns:
                span = f"{head.first_ns} to {head.last_ns} ns"
                faults.append(f"{record.name}: message at {message.log_time_ns} ns, its chunk states {span}")
        if fault := next(filter(None, faults), ""):
            messages = sum(item.opcode == Opcode.MESSAGE for item in found)
            all_read = not broken and messages == sum(map(len, positions.values()))
            self._lose(record, head, positions, fault, all_read=all_read)
        else:
            self._inventory.add_chunk(record, head, positions)

    def _counted(self, body: bytes | memoryview) -> Found:
        head = layout.message_head(body)
        if head.channel_id not in self.channels:
            self.losses.add_undescribed(head.channel_id, head.log_time_ns)
            raise ValueError(f"message of channel {head.channel_id}, which the log does not describe")
        self._inventory.add_message(head.channel_id, head.log_time_ns)
        last_ns = head.log_time_ns + self._inventory.behind_ns
        if self.losses.settle(last_ns):
            self._bound_damages(None, last_ns)
        if not self.damages:
            self.last_good_ns = head.log_time_ns
        return head, body

    def _lose(
        self, record: layout.Record, head: layout.ChunkHead | None, saved: Positions, fault: str, *, all_read: bool
    ) -> None:
        """Record a damaged chunk and the messages that it lost."""
        entry = self._entries.get(record.start)
        self._inventory.lost = True
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
            self.losses.add(gap, is_open=is_open)
        first_ns, last_ns = span or (next_ns, None)
        self._framing.damaged(record.start, fault, first_ns, None if is_open else last_ns)

    def _bound_damages(self, first_ns: int | None, last_ns: int | None) -> None:
        """Limit the damages of the open gap, or of the one that just ended, to messages between these log times."""
        for number in range(len(self.damages) - 1, -1, -1):
            damage = self.damages[number]
            if damage.byte < self._open_at:
                return
            self.damages[number] = replace(damage, first_ns=damage.first_ns or first_ns, last_ns=last_ns)

    def _require_unknown(self, record: layout.Record) -> None:
        """Note a record of an unknown kind that has the form of a message or chunk: its opcode may be damaged."""
        is_message = self._framing.is_message(bytes(record.body[: layout.MESSAGE.size]))
        if is_message or is_chunk(record.body, len(record.body)):
            words = f"a record with opcode {record.name} has the form of a {'message' if is_message else 'chunk'}"
            self._framing.doubts.append(Damage(record.start, words))
            self._open_at = record.start
            self.losses.add(Gap(self._inventory.next_ns, None), is_open=True)

    def _note(self, opcode: int, body: bytes, start: int | None = None) -> None:
        """Store the content of a record that is not a message; ``start`` is its first byte, None inside a chunk."""
        if opcode in layout.PARSED:
            item = layout.parse(opcode, body)
            if start is not None:
                self._inventory.note(start, item)
            self.described.add(item, in_data=self._framing.summary_start is None)
            if isinstance(item, records.Metadata):
                require_gaps(self.described.metadata[-1], self.limits)

    def _conclude(self) -> None:
        """Check at the end of the file: find missing records, and optional parts that the writer left out."""
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
    """Return whether these are the first bytes of a message of this log, judged by its channel and log time."""
    if len(body) < layout.MESSAGE.size or int.from_bytes(body[:2], "little") not in described.channels:
        return False  # checked first because it is cheap: there may be millions
    head = layout.message_head(body)
    near_ns = inventory.last_ns or head.log_time_ns
    return abs(head.log_time_ns - near_ns) < _FAR_NS


def _text_of(error: BaseException) -> str:
    if isinstance(error, EndOfFile):
        return layout.TOO_SHORT
    return " ".join(str(error).split()) or type(error).__name__
