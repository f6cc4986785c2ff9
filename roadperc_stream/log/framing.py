"""The records of a file one after the other, with their places, and whether its sections are what was written.

Behind bytes that make no sense reading goes on where the index says, else at the next bytes that a record can start
with. Layout: https://mcap.dev/spec.
"""

import bisect
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import IO, Final

from deflate import crc32
from mcap.opcode import Opcode

from roadperc_stream.log.damage import Damage
from roadperc_stream.log.layout import CRC_BYTES, MAGIC, MESSAGE, NAMES, RECORD, Record, chunk_head

BREAK: Final = 0
"""Opcode of the record that says where reading broke off in the data section; the specification has none of this."""
_BLOCK_BYTES: Final = 1024 * 1024
_OVERLAP_BYTES: Final = 128
"""More than what is looked at from where a record may start: its head and the fields of a chunk."""
_FIELDS_BYTES: Final = 64
_CHUNK_BEGINS: Final = rb"(?=\x06.{5}\x00{3}.{28}(?:\x00{4}|\x03\x00{3}lz4|\x04\x00{3}zstd))"
_BESIDE_CHUNKS: Final = re.compile(_CHUNK_BEGINS + rb"|(?=[\x09\x0c\x0f].{5}\x00{3})", re.DOTALL)
"""What a chunk, or a record between chunks, begins with; lengths are below 2^40 bytes."""
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
"""What the fields of a record take that has nothing in those of any length."""
IsMessage = Callable[[bytes], bool]
"""Whether the first bytes of a message record are those of a message of this log."""
_FIRST_PRIVATE: Final = 0x80
"""Opcodes from here on are an application's own."""
_OF_INDEX: Final = frozenset(
    (
        Opcode.STATISTICS,
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT_INDEX,
        Opcode.METADATA_INDEX,
        Opcode.SUMMARY_OFFSET,
        Opcode.FOOTER,
    )
)
_OF_SUMMARY: Final[frozenset[int]] = _OF_INDEX | {Opcode.SCHEMA, Opcode.CHANNEL}
_OF_DATA: Final[frozenset[int]] = frozenset(Opcode) - _OF_INDEX - {Opcode.HEADER}
_MOST_LISTED: Final = 1000
"""Damages that are listed one by one."""
_MOST_CUT_BYTES: Final = 256 * 1024 * 1024
"""What is read of a record that does not end: its chunk may be whole, and only its length wrong."""


class RecordSearch:
    """Finds where records start in bytes that make no sense.

    A block of the file is held, and looked at in place: of what only looks like records there may be millions.
    """

    def __init__(self, stream: IO[bytes], size_bytes: int, is_message: IsMessage) -> None:
        """Search a file.

        Args:
            stream: of the file; it is left anywhere.
            size_bytes: of the file.
            is_message: tells messages from what only looks like one.
        """
        self._stream, self._size_bytes, self._is_message = stream, size_bytes, is_message
        self._block, self._block_at = b"", 0

    def next_record(self, at: int, *, chunked: bool) -> int | None:
        """The byte from ``at`` on where the next record starts whose fields fit together, and with what follows it.

        Args:
            at: first byte that is looked at.
            chunked: look for no messages, channels and schemas outside chunks: those inside one look the same.

        Returns:
            None without one.
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
        """Have the block in memory that a record's first fields are in."""
        held = self._block_at + len(self._block)
        is_held = self._block_at <= at and (at + _OVERLAP_BYTES < held or held == self._size_bytes)
        if not is_held or at >= held:
            self._stream.seek(at)
            self._block, self._block_at = self._stream.read(min(_BLOCK_BYTES, self._size_bytes - at)), at

    def _bytes(self, at: int, length: int) -> bytes:
        """Some of the file's bytes, fewer at its end."""
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
        """Whether a record that ends here is followed by another, or by nothing."""
        head = self._bytes(end, RECORD.size)
        if len(head) < RECORD.size:
            return not head
        opcode, length = RECORD.unpack(head)
        return opcode in NAMES and end + RECORD.size + length <= self._size_bytes


def is_chunk(fields: bytes | memoryview, length: int) -> bool:
    """Whether a record of this length that begins with these fields is a chunk by its form."""
    try:
        head = chunk_head(fields)
    except ValueError:
        return False
    return head.first_ns <= head.last_ns and head.record_bytes == RECORD.size + length


@dataclass
class Framing:
    """Reads the records of a file once: ``damages``, ``ended`` and ``sealed`` are complete when that is done.

    Args:
        size_bytes: of the file.
        resume_at: where the index says that records start, ascending: there reading goes on after a break.
        is_message: tells messages from what only looks like one, where there is no index.
    """

    size_bytes: int
    resume_at: Sequence[int] = ()
    is_message: IsMessage = bool
    damages: list[Damage] = field(default_factory=list)
    ended: bool = False
    """Whether the file ends as a log does, with footer and magic."""
    sealed: bool = False
    """Whether there is a CRC over the whole data section."""
    summary_sealed: bool = False
    """Whether there is one over the summary."""
    summary_start: int | None = None
    """The first byte behind the data section; None before it was found."""
    _chunked: bool = False
    """Whether a chunk was seen: then messages stand in chunks."""
    _data_crc: int | None = None
    _data_crc_damage: Damage | None = None
    _summary_crc: int | None = None

    def explain_data_crc(self) -> None:
        """The CRCs of the messages fit: other damage says where the data section is wrong, or it is beside messages."""
        damage = self._data_crc_damage
        if damage in self.damages:
            self.damages.remove(damage)
            self.note(None if self.damages else replace(damage, of_messages=False))

    @property
    def has_place(self) -> bool:
        """Whether there are damages that say where the file is wrong: not that only the data section's CRC is."""
        return self.damages not in ([], [self._data_crc_damage])

    def damaged(self, byte: int, words: str, first_ns: int | None = None, last_ns: int | None = None) -> None:
        """Take note of a damage; behind the data section it concerns no messages."""
        self.note(Damage(byte, words, first_ns, last_ns, of_messages=self.summary_start is None))

    def records(self, stream: IO[bytes]) -> Iterator[Record]:
        """The file's records outside chunks, up to its end or to where nothing follows that makes sense.

        A chunk that the file's end cuts off, or whose length makes no sense, comes with what there is of it. Where
        reading breaks off in the data section, a record ``BREAK`` follows.
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
                self._close(at, stream.read(len(MAGIC) + 1))
                return

    def _fault(self, at: int, head: bytes) -> str | None:
        """Why no record can start here; None where one can."""
        if len(head) < RECORD.size:
            return f"cut off: the file ends after {self.size_bytes} bytes, before its footer"
        opcode, length = RECORD.unpack(head)
        left = self.size_bytes - at - RECORD.size
        if opcode not in NAMES and opcode < _FIRST_PRIVATE:
            return f"no record starts here: its type would be {opcode:#04x}"
        if length > left:
            return f"cut off or damaged: a record of {length} bytes starts here, {left} bytes are left"
        if opcode < _FIRST_PRIVATE and opcode not in self._belonging(at):
            return f"a {Record(at, opcode, b'').name} record does not belong here"
        return None

    def _belonging(self, at: int) -> frozenset[int]:
        """The types of record that may start here."""
        if self.summary_start is not None:
            return _OF_SUMMARY
        return _OF_DATA if at > len(MAGIC) else frozenset((Opcode.HEADER,))

    def _broken(self, stream: IO[bytes], at: int, head: bytes, fault: str) -> Iterator[Record]:
        """Note a fault; a chunk that does not end in the file is given as far as it goes."""
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
        """Go to the next record that the index names, or else to the next one whose fields fit; None without any."""
        self._data_crc = self._summary_crc = None
        following = bisect.bisect_right(self.resume_at, at)
        if following < len(self.resume_at):
            return stream.seek(self.resume_at[following])
        if self.resume_at or self.summary_start is not None:
            return None
        found = search.next_record(at + 1, chunked=self._chunked)
        return None if found is None else stream.seek(found)

    def _close(self, at: int, rest: bytes) -> None:
        self.ended = rest == MAGIC
        if not self.ended:
            self.damaged(at, f"the closing magic is missing: {self.size_bytes - at} bytes follow the footer")

    def _check(self, record: Record) -> None:
        """Go on with the CRC of the section a record stands in, and compare it where the section ends."""
        self._chunked |= record.opcode == Opcode.CHUNK
        if record.opcode == Opcode.DATA_END:
            self.summary_start = record.end
            self.sealed = bool(_crc_in(record))
            self._data_crc_damage = _crc_damage("data section", record, self._data_crc)
            self.note(self._data_crc_damage)
            self._summary_crc = 0
        elif self._summary_crc is not None:
            without_last = CRC_BYTES if record.opcode == Opcode.FOOTER else 0
            self._summary_crc = record.crc(self._summary_crc, without_last=without_last)
            if record.opcode == Opcode.FOOTER:
                self.summary_sealed = bool(_crc_in(record))
                self.note(_crc_damage("summary", record, self._summary_crc, of_messages=False))
        elif self._data_crc is not None:
            self._data_crc = record.crc(self._data_crc)
        if record.opcode == Opcode.ATTACHMENT:
            found = crc32(memoryview(record.body)[:-CRC_BYTES])
            self.note(_crc_damage("attachment", record, found, of_messages=False))

    def note(self, damage: Damage | None) -> None:
        """Take note of a damage, where there is one; the last one that is listed stands for all that follow it."""
        if damage is None:
            return
        if len(self.damages) < _MOST_LISTED:
            self.damages.append(damage)
        else:
            self.damages[-1] = self.damages[-1].with_more(damage)


def _crc_in(record: Record) -> int:
    """The CRC that is a record's last bytes; zero says that the writer gave none."""
    return int.from_bytes(record.body[-CRC_BYTES:], "little")


def _crc_damage(what: str, record: Record, found: int | None, *, of_messages: bool = True) -> Damage | None:
    """That a CRC, where there is one to be compared, is not the one that the record gives."""
    expected = _crc_in(record)
    if not expected or found in (None, expected):
        return None
    words = f"CRC of the {what} is {found:#010x}, expected {expected:#010x}"
    return Damage(record.start, words, of_messages=of_messages)
