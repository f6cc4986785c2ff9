"""The records of a file one after the other, with their places, and whether its sections are what was written.

The library reads records too, but neither says where one starts nor stops at a length that makes no sense. Layout:
https://mcap.dev/spec.
"""

import bisect
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import IO, Final

from mcap.opcode import Opcode

from roadperc_stream.log.integrity import CRC_BYTES, MAGIC

_HEAD: Final = struct.Struct("<BQ")
_OPCODES: Final = frozenset(int(opcode) for opcode in Opcode)
_FIRST_PRIVATE: Final = 0x80
"""Opcodes from here on are an application's own."""


@dataclass(frozen=True)
class Damage:
    """Where a file is not what it should be, and how."""

    byte: int
    words: str


@dataclass(frozen=True)
class Record:
    """A record outside any chunk, and the byte it starts at."""

    start: int
    opcode: int
    body: bytes

    @property
    def name(self) -> str:
        """The kind of record, as the specification calls it."""
        return Opcode(self.opcode).name.lower().replace("_", " ") if self.opcode in _OPCODES else f"{self.opcode:#04x}"

    @property
    def end(self) -> int:
        """The byte behind it."""
        return self.start + _HEAD.size + len(self.body)

    def crc(self, before: int, *, without_last: int = 0) -> int:
        """The CRC of what came before and of this record, but for its last bytes."""
        head = _HEAD.pack(self.opcode, len(self.body))
        return zlib.crc32(memoryview(self.body)[: len(self.body) - without_last], zlib.crc32(head, before))


@dataclass
class Framing:
    """Reads the records of a file once: ``damages``, ``ended`` and ``sealed`` are complete when that is done.

    Args:
        size_bytes: of the file.
        chunk_starts: where the index says that chunks start, ascending: there reading goes on after a break.
    """

    size_bytes: int
    chunk_starts: Sequence[int] = ()
    damages: list[Damage] = field(default_factory=list)
    ended: bool = False
    """Whether the file ends as a log does, with footer and magic."""
    sealed: bool = False
    """Whether there is a CRC over the whole data section."""
    _data_crc: int | None = None
    _summary_crc: int | None = None

    def damaged(self, byte: int, words: str) -> None:
        """Take note of a damage."""
        self.damages.append(Damage(byte, words))

    def records(self, stream: IO[bytes]) -> Iterator[Record]:
        """The file's records outside chunks, up to its end or to where nothing follows that makes sense."""
        self._data_crc = zlib.crc32(stream.read(len(MAGIC)))
        at: int | None = len(MAGIC)
        while at is not None:
            head = stream.read(_HEAD.size)
            fault = self._fault(at, head)
            if fault:
                self.damaged(at, fault)
                at = self._resume(stream, at)
                continue
            opcode, length = _HEAD.unpack(head)
            record = Record(at, opcode, stream.read(length))
            self._check(record)
            yield record
            at = record.end
            if opcode == Opcode.FOOTER:
                self._close(at, stream.read())
                return

    def _fault(self, at: int, head: bytes) -> str | None:
        """Why no record can start here; None where one can."""
        if len(head) < _HEAD.size:
            return f"cut off: the file ends after {self.size_bytes} bytes, before its footer"
        opcode, length = _HEAD.unpack(head)
        left = self.size_bytes - at - _HEAD.size
        if opcode not in _OPCODES and opcode < _FIRST_PRIVATE:
            return f"no record starts here: its type would be {opcode:#04x}"
        if length > left:
            return f"cut off or damaged: a record of {length} bytes starts here, {left} bytes are left"
        return None

    def _resume(self, stream: IO[bytes], at: int) -> int | None:
        """Go to the next chunk that the index names; None where there is none."""
        following = bisect.bisect_right(self.chunk_starts, at)
        if following == len(self.chunk_starts):
            return None
        self._data_crc = None
        return stream.seek(self.chunk_starts[following])

    def _close(self, at: int, rest: bytes) -> None:
        self.ended = rest == MAGIC
        if not self.ended:
            self.damaged(at, f"the closing magic is missing: {len(rest)} bytes follow the footer")

    def _check(self, record: Record) -> None:
        """Go on with the CRC of the section a record stands in, and compare it where the section ends."""
        if record.opcode == Opcode.DATA_END:
            self.sealed = self._compare("data section", record, self._data_crc)
            self._summary_crc = 0
        elif self._summary_crc is not None:
            without_last = CRC_BYTES if record.opcode == Opcode.FOOTER else 0
            self._summary_crc = record.crc(self._summary_crc, without_last=without_last)
            if record.opcode == Opcode.FOOTER:
                self._compare("summary", record, self._summary_crc)
        elif self._data_crc is not None:
            self._data_crc = record.crc(self._data_crc)
        if record.opcode == Opcode.ATTACHMENT:
            self._compare("attachment", record, zlib.crc32(memoryview(record.body)[:-CRC_BYTES]))

    def _compare(self, what: str, record: Record, found: int | None) -> bool:
        """Whether a CRC, the record's last bytes, was there to be compared; zero says that the writer gave none."""
        expected = int.from_bytes(record.body[-CRC_BYTES:], "little")
        if expected and found is not None and found != expected:
            self.damaged(record.start, f"CRC of the {what} is {found:#010x}, expected {expected:#010x}")
        return bool(expected)
