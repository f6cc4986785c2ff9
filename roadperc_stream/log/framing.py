"""Reads the records of a file in order, with their positions, and checks the CRCs of its sections.

Behind invalid bytes, reading continues where the index names a record, or else where the next record can start.
Format: https://mcap.dev/spec.
"""

import bisect
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import IO, Final

from deflate import crc32
from mcap.opcode import Opcode

from roadperc_stream.log.damage import Damage
from roadperc_stream.log.layout import MAGIC, MESSAGE, NAMES, RECORD, UNREADABLE, Record, attachment_crcs, chunk_head

BREAK: Final = 0
"""Opcode of the record that marks invalid bytes in the data section; the specification does not use it."""
_BLOCK_BYTES: Final = 1024 * 1024
_OVERLAP_BYTES: Final = 128
"""Overlap of two blocks: longer than the head of a record and the fields of a chunk, which the search reads."""
_FIELDS_BYTES: Final = 64
_CHUNK_BEGINS: Final = rb"(?=\x06.{5}\x00{3}.{28}(?:\x00{4}|\x03\x00{3}lz4|\x04\x00{3}zstd))"
_BESIDE_CHUNKS: Final = re.compile(_CHUNK_BEGINS + rb"|(?=[\x09\x0c\x0f].{5}\x00{3})", re.DOTALL)
"""First bytes of a chunk, or of a record between chunks; lengths are below 2^40 bytes."""
_ANYWHERE: Final = re.compile(_CHUNK_BEGINS + rb"|(?=[\x03\x04\x05\x09\x0c\x0f].{5}\x00{3})", re.DOTALL)
_LEAST_BYTES: Final = {
    int(Opcode.SCHEMA): 14,
    int(Opcode.CHANNEL): 16,
    int(Opcode.MESSAGE): MESSAGE.size,
    int(Opcode.CHUNK): 40,
    int(Opcode.ATTACHMENT): 36,
    int(Opcode.METADATA): 8,
    int(Opcode.DATA_END): 4,
}
"""Smallest length of each kind of record: all its variable fields are empty."""
IsMessage = Callable[[bytes], bool]
"""Returns whether the first bytes of a message record belong to a message of this log."""
_SUMMARY_CRC_AT: Final = 16
"""Offset of the summary's CRC in the footer's body."""
_OF_DATA: Final = frozenset(_LEAST_BYTES) | {Opcode.MESSAGE_INDEX}
_OF_SUMMARY: Final = frozenset(Opcode) - _OF_DATA - {Opcode.HEADER} | {Opcode.SCHEMA, Opcode.CHANNEL}
_MOST_LISTED: Final = 1000
"""Damages that are listed individually."""
_MOST_CUT_BYTES: Final = 256 * 1024 * 1024
"""Bytes read of a chunk that exceeds the file: perhaps only its length is wrong."""


class RecordSearch:
    """Finds where records start behind invalid bytes. It moves the position of the stream.

    It keeps a block of the file and checks it in place, because millions of places may look like a record.
    """

    def __init__(self, stream: IO[bytes], size_bytes: int, is_message: IsMessage) -> None:
        self._stream, self._size_bytes, self._is_message = stream, size_bytes, is_message
        self._block, self._block_at = b"", 0

    def next_record(self, at: int, *, chunked: bool) -> int | None:
        """Return the byte where the next consistent record starts, from byte ``at`` on; None without any.

        Args:
            at: first byte to check.
            chunked: skip messages, channels and schemas, because those inside a chunk look like those outside.
        """
        pattern = _BESIDE_CHUNKS if chunked else _ANYWHERE
        return next((start for start in self._likely(at, pattern) if self._fits(start)), None)

    def _likely(self, at: int, pattern: re.Pattern[bytes]) -> Iterator[int]:
        while at < self._size_bytes:
            self._hold(at)
            block, block_at = self._block, self._block_at
            end = block_at + len(block)
            end -= 0 if end == self._size_bytes else _OVERLAP_BYTES
            for found in pattern.finditer(block, at - block_at):
                start = block_at + found.start()
                if start >= end:
                    break
                yield start
            at = end

    def _hold(self, at: int) -> None:
        """Load the block with the first fields of a record at ``at``."""
        held = self._block_at + len(self._block)
        is_held = self._block_at <= at and (at + _OVERLAP_BYTES < held or held == self._size_bytes)
        if not is_held or at >= held:
            self._stream.seek(at)
            self._block, self._block_at = self._stream.read(min(_BLOCK_BYTES, self._size_bytes - at)), at

    def _bytes(self, at: int, length: int) -> bytes:
        """Return bytes of the file, fewer at its end."""
        start = at - self._block_at
        if start >= 0 and start + length <= len(self._block):
            return self._block[start : start + length]
        self._stream.seek(at)
        return self._stream.read(max(min(length, self._size_bytes - at), 0))

    def _fits(self, start: int) -> bool:
        opcode, length = RECORD.unpack_from(self._block, start - self._block_at)
        fields_at = start + RECORD.size
        if fields_at + length > self._size_bytes or length < _LEAST_BYTES[opcode]:
            return False
        if opcode == Opcode.CHUNK:
            return is_chunk(self._bytes(fields_at, min(length, _FIELDS_BYTES)), length)
        if opcode == Opcode.MESSAGE and not self._is_message(self._bytes(fields_at, MESSAGE.size)):
            return False
        return self._leads_on(fields_at + length)

    def _leads_on(self, end: int) -> bool:
        """Return whether a record follows at ``end``, or the file ends there."""
        head = self._bytes(end, RECORD.size)
        if len(head) < RECORD.size:
            return not head
        opcode, length = RECORD.unpack(head)
        return opcode in NAMES and end + RECORD.size + length <= self._size_bytes


def is_chunk(fields: bytes | memoryview, length: int) -> bool:
    """Return whether a record of this length with these first fields has the form of a chunk."""
    try:
        head = chunk_head(fields)
    except ValueError:
        return False
    return head.first_ns <= head.last_ns and head.record_bytes == RECORD.size + length


@dataclass
class Framing:
    """Reads the records of a file once. Its fields are complete at the end of ``records``.

    Args:
        size_bytes: of the file.
        resume_at: where records start according to the index, ascending. Reading continues there behind damage.
        is_message: finds messages behind damage if there is no index.
        fault: why the file ends too early, if that is known.
    """

    size_bytes: int
    resume_at: Sequence[int] = ()
    is_message: IsMessage = bool
    fault: str = ""
    damages: list[Damage] = field(default_factory=list)
    doubts: list[Damage] = field(default_factory=list)
    """Damages of the data section, unless its CRC is correct."""
    ended: bool = False
    """Whether the file ends with footer and magic, as a complete log does."""
    sealed: bool = False
    """Whether the data section has a CRC."""
    summary_sealed: bool = False
    """Whether the summary has a CRC."""
    summary_start: int | None = None
    """The first byte behind the data section; None until it is found."""
    _chunked: bool = False
    """Whether a chunk was seen: then all messages are in chunks."""
    _data_crc: int | None = None
    _data_crc_damage: Damage | None = None
    _summary_crc: int | None = None

    def explain_data_crc(self) -> None:
        """Correct the damage by the data section's CRC: all CRCs of messages fit, so it affects none of them."""
        damage = self._data_crc_damage
        if damage in self.damages:
            self.damages.remove(damage)
            self.note(None if self.damages else replace(damage, of_messages=False))

    @property
    def has_place(self) -> bool:
        """Whether the place of a damage is known; a wrong CRC of the data section does not show the place."""
        return self.damages not in ([], [self._data_crc_damage])

    def damaged(self, byte: int, words: str, first_ns: int | None = None, last_ns: int | None = None) -> None:
        """Add a damage; behind the data section it affects no messages."""
        self.note(Damage(byte, words, first_ns, last_ns, of_messages=self.summary_start is None))

    def records(self, stream: IO[bytes]) -> Iterator[Record]:
        """Yield the file's records outside chunks, up to its end or to the last valid one.

        A chunk that exceeds the file is yielded with its available bytes and a fault. A record ``BREAK`` marks each
        place with invalid bytes in the data section.
        """
        self._data_crc = crc32(stream.read(len(MAGIC)))
        search = RecordSearch(stream, self.size_bytes, self.is_message)
        at: int | None = len(MAGIC)
        while at is not None:
            head = stream.read(RECORD.size)
            if fault := self._fault(at, head):
                yield from self._broken(stream, at, head, fault)
                at = self._resume(stream, at, search)
                continue
            opcode, length = RECORD.unpack(head)
            record = Record(at, opcode, stream.read(length))
            self._check(record)
            yield record
            at = record.end
            if opcode == Opcode.FOOTER:
                self.ended = stream.read(len(MAGIC) + 1) == MAGIC
                if not self.ended:
                    self.damaged(
                        at, f"expected the closing magic, found {self.size_bytes - at} bytes behind the footer"
                    )
                return

    def _fault(self, at: int, head: bytes) -> str | None:
        """Return why no record can start here; None if one can."""
        if len(head) < RECORD.size:
            return f"cut off: {self.fault or f'the file ends after {self.size_bytes} bytes, before its footer'}"
        opcode, length = RECORD.unpack(head)
        left = self.size_bytes - at - RECORD.size
        if opcode == 0:
            return "no record starts here: opcode 0x00"
        if length > left:
            return f"cut off or damaged: a record of {length} bytes starts here, {left} bytes are left"
        in_section = _OF_DATA if self.summary_start is None else _OF_SUMMARY
        expected = in_section if at > len(MAGIC) else {Opcode.HEADER}
        if opcode not in expected and (opcode in NAMES or at == len(MAGIC)):
            return f"a {Record(at, opcode, b'').name} record does not belong here"
        return None

    def _broken(self, stream: IO[bytes], at: int, head: bytes, fault: str) -> Iterator[Record]:
        """Add the damage; yield the available bytes of a chunk that exceeds the file."""
        opcode, length = RECORD.unpack(head) if len(head) == RECORD.size else (BREAK, 0)
        left = self.size_bytes - at - RECORD.size
        if opcode == Opcode.CHUNK and length > left and self.summary_start is None:
            self._chunked = True
            yield Record(at, opcode, stream.read(min(left, _MOST_CUT_BYTES)), fault)
        else:
            self.damaged(at, fault)
        if self.summary_start is None:
            yield Record(at, BREAK, b"", fault)

    def _resume(self, stream: IO[bytes], at: int, search: RecordSearch) -> int | None:
        """Go to the next record that the index names, or else to the next consistent one; None without any."""
        self._data_crc = self._summary_crc = None
        following = bisect.bisect_right(self.resume_at, at)
        if following < len(self.resume_at):
            return stream.seek(self.resume_at[following])
        if self.resume_at or self.summary_start is not None:
            return None
        found = search.next_record(at + 1, chunked=self._chunked)
        return None if found is None else stream.seek(found)

    def _check(self, record: Record) -> None:
        """Add a record to the CRC of its section, and compare that CRC at the section's end."""
        self._chunked |= record.opcode == Opcode.CHUNK
        if record.opcode == Opcode.DATA_END:
            self.summary_start = record.end
            self.sealed = bool(record.number(0))
            self._data_crc_damage = _crc_damage("data section", record, record.number(0), self._data_crc)
            self.note(self._data_crc_damage)
            if not self.sealed or self._data_crc_damage or self._data_crc is None:
                for damage in self.doubts:
                    self.note(damage)
            self._summary_crc = 0
        elif self._summary_crc is not None:
            is_footer = record.opcode == Opcode.FOOTER
            self._summary_crc = record.crc(self._summary_crc, _SUMMARY_CRC_AT if is_footer else None)
            if is_footer:
                expected = record.number(_SUMMARY_CRC_AT)
                self.summary_sealed = bool(expected)
                self.note(_crc_damage("summary", record, expected, self._summary_crc, of_messages=False))
        elif self._data_crc is not None:
            self._data_crc = record.crc(self._data_crc)
        if record.opcode == Opcode.ATTACHMENT:
            with suppress(UNREADABLE):  # reported when its fields are read
                self.note(_crc_damage("attachment", record, *attachment_crcs(bytes(record.body)), of_messages=False))

    def note(self, damage: Damage | None) -> None:
        """Add a damage, if any; the last listed damage also represents all later ones."""
        if damage is None:
            return
        if len(self.damages) < _MOST_LISTED:
            self.damages.append(damage)
        else:
            self.damages[-1] = self.damages[-1].with_more(damage)


def _crc_damage(
    what: str, record: Record, expected: int, found: int | None, *, of_messages: bool = True
) -> Damage | None:
    """Return the damage if a computed CRC differs from the record's; None if equal, or if one of them is missing."""
    if not expected or found in (None, expected):
        return None
    words = f"CRC of the {what} is {found:#010x}, expected {expected:#010x}"
    return Damage(record.start, words, of_messages=of_messages)
