"""Finds where records start behind invalid bytes. Format: https://mcap.dev/spec."""

import re
from collections.abc import Callable, Iterator
from typing import IO, Final

from mcap.opcode import Opcode

from roadperc_stream.log.layout import MESSAGE, RECORD, chunk_head

IsMessage = Callable[[bytes], bool]
"""Returns whether the first bytes of a message record belong to a message of this log."""
_BLOCK_BYTES: Final = 1024 * 1024
_OVERLAP_BYTES: Final = 128
"""Overlap of two blocks: longer than the head of a record and the fields of a chunk."""
_FIELDS_BYTES: Final = 64
_CHUNK: Final = rb"(?=\x06.{5}\x00{3}.{28}(?:\x00{4}|\x03\x00{3}lz4|\x04\x00{3}zstd))"
_CHUNKS: Final = re.compile(_CHUNK, re.DOTALL)
_BESIDE_CHUNKS: Final = re.compile(_CHUNK + rb"|(?=[\x09\x0c].{5}\x00{3})", re.DOTALL)
"""First bytes of a chunk, or of a record between chunks; lengths are below 2^40 bytes."""
_ANYWHERE: Final = re.compile(_CHUNK + rb"|(?=[\x03\x04\x05\x09\x0c].{5}\x00{3})", re.DOTALL)
_LEAST_BYTES: Final = {
    int(Opcode.SCHEMA): 14,
    int(Opcode.CHANNEL): 16,
    int(Opcode.MESSAGE): MESSAGE.size,
    int(Opcode.CHUNK): 40,
    int(Opcode.ATTACHMENT): 36,
    int(Opcode.METADATA): 8,
}
"""Smallest length of each kind of record: all its variable fields are empty."""


class RecordSearch:
    """Finds where records start behind invalid bytes. It moves the position of the stream.

    It keeps a block of the file and checks it in place, because millions of places may look like a record.
    """

    def __init__(self, stream: IO[bytes], size_bytes: int, is_message: IsMessage) -> None:
        self._stream, self._size_bytes, self._is_message = stream, size_bytes, is_message
        self._block, self._block_at = b"", 0

    def next_record(self, at: int, *, chunked: bool) -> int | None:
        """Return the byte where the next consistent record starts, from byte ``at`` on; None without any.

        A message of this log also counts if no record follows it, unless a consistent record starts inside it.

        Args:
            at: first byte to check.
            chunked: skip messages, channels and schemas, because those inside a chunk look like those outside.
        """
        alone: tuple[int, int] | None = None
        for start in self._likely(at, _BESIDE_CHUNKS if chunked else _ANYWHERE):
            if alone is not None and start >= alone[1]:
                break
            end, is_certain = self._end(start)
            if self._is_consistent(end, is_certain):
                return start
            if end and self._block[start - self._block_at] == Opcode.MESSAGE:
                alone = start, end
        return None if alone is None else alone[0]

    def has_chunk(self, at: int) -> bool:
        """Return whether a chunk starts behind a byte."""
        return any(self._is_consistent(*self._end(start)) for start in self._likely(at, _CHUNKS))

    def _is_consistent(self, end: int, is_certain: bool) -> bool:
        return bool(end) and (is_certain or self.leads_on(end))

    def leads_on(self, end: int) -> bool:
        """Return whether a record can start at a byte, or the file ends there."""
        left = self._size_bytes - end
        return left >= 0 and follows(self._bytes(end, RECORD.size), left)

    def chunk_end(self, start: int) -> int | None:
        """Return the byte behind the chunk at ``start`` by its own fields; None if no record follows there."""
        try:
            end = start + chunk_head(self._bytes(start + RECORD.size, _FIELDS_BYTES)).record_bytes
        except ValueError:
            return None
        return end if end <= self._size_bytes and self.leads_on(end) else None

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

    def _end(self, start: int) -> tuple[int, bool]:
        """Return the byte behind a likely record, 0 if it is none, and whether its fields alone make that certain."""
        opcode, length = RECORD.unpack_from(self._block, start - self._block_at)
        fields_at = start + RECORD.size
        if fields_at + length > self._size_bytes or length < _LEAST_BYTES[opcode]:
            return 0, False
        if opcode == Opcode.MESSAGE and not self._is_message(self._bytes(fields_at, MESSAGE.size)):
            return 0, False
        if opcode != Opcode.CHUNK:
            return fields_at + length, False
        stated = _chunk_bytes(self._bytes(fields_at, min(length, _FIELDS_BYTES)))
        return (fields_at + length if 0 < stated <= RECORD.size + length else 0), stated == RECORD.size + length


def follows(head: bytes, left: int) -> bool:
    """Return whether these first bytes can begin a record of the ``left`` bytes of the file; true at its end."""
    if len(head) < RECORD.size:
        return not head
    opcode, length = RECORD.unpack(head)
    return bool(opcode) and bool(RECORD.size + length <= left)


def is_chunk(body: bytes | memoryview) -> bool:
    """Return whether a record's body has the form of a chunk of just its length."""
    return _chunk_bytes(body) == RECORD.size + len(body)


def _chunk_bytes(fields: bytes | memoryview) -> int:
    """Return the length of the whole record that a chunk's first fields state; 0 if they are none of a chunk."""
    try:
        head = chunk_head(fields)
    except ValueError:
        return 0
    return head.record_bytes if head.first_ns <= head.last_ns else 0
