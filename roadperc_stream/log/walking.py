"""Walks through the records of a file, with their positions, and checks the CRCs of its sections.

Behind invalid bytes, reading continues where the next consistent record starts. Format: https://mcap.dev/spec.
"""

from collections.abc import Iterator, Mapping
from typing import IO, Final

from deflate import crc32
from mcap.opcode import Opcode

from roadperc_stream.log.chunks import INSIDE
from roadperc_stream.log.damage import LostSpan
from roadperc_stream.log.layout import MAGIC, NAMES, RECORD, Record
from roadperc_stream.log.losses import ANY_TIME, Losses
from roadperc_stream.log.search import IsMessage, RecordSearch, follows, is_chunk

_OF_DATA: Final = frozenset(
    (*INSIDE, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END)
)
_OF_SUMMARY: Final = frozenset(Opcode) - _OF_DATA - {Opcode.HEADER} | {Opcode.SCHEMA, Opcode.CHANNEL}
_IN_SUMMARY: Final = frozenset(bytes([opcode]) for opcode in _OF_SUMMARY)
_SUMMARY_CRC_AT: Final = 16
"""Offset of the summary's CRC in the footer's body."""
_MOST_END_BYTES: Final = 13
"""Largest length of the record that ends the data section; those of damaged opcodes are longer."""
_MOST_CUT_BYTES: Final = 256 * 1024 * 1024
"""Bytes read of a chunk that exceeds the file: perhaps only its length is wrong."""


class Walk:
    """Walks through a file once.

    Args:
        stream: the file, at its first byte.
        size_bytes: of the file.
        losses: gets the damages.
        is_message: finds messages behind damage.
        spans: times of the chunks that the summary names, by their first byte.
        why_cut: why the file ends too early, if that is known.
    """

    def __init__(
        self,
        stream: IO[bytes],
        size_bytes: int,
        losses: Losses,
        is_message: IsMessage,
        spans: Mapping[int, LostSpan],
        why_cut: str,
    ) -> None:
        self._stream, self._size_bytes, self._losses, self._spans = stream, size_bytes, losses, spans
        self._search = RecordSearch(stream, size_bytes, is_message)
        self._why_cut = why_cut or f"the file ends after {size_bytes} bytes, before its footer"
        self.is_in_data = True
        """Whether the data section did not end yet."""
        self.is_sealed = self.is_summary_sealed = False
        """Whether the data section, or the summary, has a correct CRC."""
        self.is_ended = False
        """Whether the file ends with footer and magic."""
        self.is_chunked = bool(spans)
        """Whether messages are in chunks, so that those found elsewhere may be parts of a damaged chunk."""
        self._crc: int | None = crc32(stream.read(len(MAGIC)))
        self._at: int | None = len(MAGIC)
        self._known_end = len(MAGIC)
        self.head = stream.read(RECORD.size)
        """The first bytes behind the current record."""

    def records(self) -> Iterator[tuple[Record, str]]:
        """Yield the records outside chunks, each with the reason if it is a chunk cut by the end of the file."""
        while self._at is not None:
            at, fault, length = self._at, self._fault(self._at), self._length(self._at)
            if length is None:
                if cut := self._cut_chunk(at):
                    yield cut, fault
                else:
                    self._lose(at, fault)
                self._resume(self._known_end + 1)
                continue
            record = self._read(at, length)
            if record.opcode == Opcode.FOOTER:
                self._finish(record)
                yield record, ""
                return
            if self._is_damaged(record):
                continue
            self._check(record)
            yield record, ""
            self._at = record.end
            self._known_end = record.end if record.opcode in NAMES else self._known_end

    def _length(self, at: int) -> int | None:
        """Return the length of the record here, None if none can start; a chunk's fields may correct a wrong one."""
        fault = self._fault(at)
        if self.is_in_data and self.head[:1] == bytes([Opcode.CHUNK]) and len(self.head) == RECORD.size:
            _, stated = RECORD.unpack(self.head)
            end = None if self._search.leads_on(at + RECORD.size + stated) else self._search.chunk_end(at)
            self._stream.seek(at + RECORD.size)
            if end is not None and end != at + RECORD.size + stated:
                words = fault or f"chunk: a record of {stated} bytes leads to no other record"
                self._losses.note(at, words, self._spans.get(at))
                return end - at - RECORD.size
        return None if fault else int(RECORD.unpack(self.head)[1])

    def _read(self, at: int, length: int) -> Record:
        record = Record(at, self.head[0], self._stream.read(length))
        self.head = self._stream.read(RECORD.size)
        return record

    def _cut_chunk(self, at: int) -> Record | None:
        """Return the available bytes of a chunk that exceeds the file; None if another record is here."""
        if not self.is_in_data or len(self.head) < RECORD.size or self.head[0] != Opcode.CHUNK:
            return None
        self._stream.seek(at + RECORD.size)
        return Record(at, Opcode.CHUNK, self._stream.read(min(self._size_bytes - at - RECORD.size, _MOST_CUT_BYTES)))

    def _lose(self, at: int, fault: str) -> None:
        """Note a place without a record; behind the data section no message is lost."""
        self._losses.note(at, fault, self._losses.unread if self.is_in_data else None, is_loss=self.is_in_data)

    def _resume(self, at: int) -> None:
        """Go to the next record from a byte on; to none behind the data section."""
        self._crc = None
        self._go(self._next(at) if self.is_in_data else None)

    def _go(self, at: int | None) -> None:
        self._at = at
        if at is not None:
            self._stream.seek(at)
            self.head, self._known_end = self._stream.read(RECORD.size), at

    def _next(self, at: int) -> int | None:
        self.is_chunked = self.is_chunked or self._search.has_chunk(at)
        return self._search.next_record(at, chunked=self.is_chunked)

    def _is_damaged(self, record: Record) -> bool:
        """Return whether a record has a wrong length; then go to the one that starts inside it.

        It leads to no other record. If none starts inside, only the next one is damaged.
        """
        is_end = record.opcode == Opcode.DATA_END
        leads_on = follows(self.head, self._size_bytes - record.end) and (not is_end or self.head[:1] in _IN_SUMMARY)
        if leads_on or not self.is_in_data or record.end >= self._size_bytes:
            return False
        inside = None if record.opcode == Opcode.CHUNK and is_chunk(record.body) else self._next(record.start + 1)
        if inside is None or (inside >= record.end and not is_end):
            self._stream.seek(record.end + len(self.head))
            return False
        self._lose(record.start, f"{record.name}: a record of {len(record.body)} bytes leads to no other record")
        self._crc = None
        self._go(inside)
        return True

    def _fault(self, at: int) -> str:
        """Return why no record can start here; empty if one can."""
        if len(self.head) < RECORD.size:
            return f"cut off: {self._why_cut}"
        opcode, length = RECORD.unpack(self.head)
        left = self._size_bytes - at - RECORD.size
        if opcode == 0:
            return "no record starts here: opcode 0x00"
        if length > left:
            return f"cut off or damaged: a record of {length} bytes starts here, {left} bytes are left"
        expected = {Opcode.HEADER} if at == len(MAGIC) else _OF_DATA if self.is_in_data else _OF_SUMMARY
        is_foreign = opcode not in expected and (opcode in NAMES or at == len(MAGIC))
        if is_foreign or (opcode == Opcode.DATA_END and length > _MOST_END_BYTES):
            return f"a {NAMES.get(opcode, hex(opcode))} record does not belong here"
        return ""

    def _check(self, record: Record) -> None:
        """Add a record to the CRC of its section, and compare that of the data section at its end."""
        if record.opcode != Opcode.DATA_END:
            self._crc = None if self._crc is None else record.crc(self._crc)
            return
        expected, found = record.number(0), self._crc
        self.is_in_data, self._crc = False, 0
        if not expected or found is None:
            return
        self.is_sealed = found == expected
        if self.is_sealed:
            self._losses.dispel_doubts()
        else:
            words = f"CRC of the data section is {found:#010x}, expected {expected:#010x}"
            self._losses.note(record.start, words, ANY_TIME)

    def _finish(self, footer: Record) -> None:
        """Check the CRC of the summary, and the end of the file."""
        found, expected = footer.crc(self._crc or 0, _SUMMARY_CRC_AT), footer.number(_SUMMARY_CRC_AT)
        self.is_ended, self.is_summary_sealed = self.head == MAGIC, found == expected
        if expected not in {0, found}:
            self._losses.note(footer.start, f"CRC of the summary is {found:#010x}, expected {expected:#010x}")
        if not self.is_ended:
            left = self._size_bytes - footer.end
            self._losses.note(footer.end, f"expected the closing magic, found {left} bytes behind the footer")
