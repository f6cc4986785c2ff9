"""Where reading can go on behind bytes that make no sense, where no index says so."""

import re
import struct
from collections.abc import Callable, Iterator
from typing import IO, Final

from mcap.opcode import Opcode

from roadperc_stream.log.chunks import MESSAGE_HEAD_BYTES, chunk_head

_HEAD: Final = struct.Struct("<BQ")
_BLOCK_BYTES: Final = 1024 * 1024
_OVERLAP_BYTES: Final = 128
"""More than what is looked at from where a record may start: its head and the fields of a chunk."""
_FIELDS_BYTES: Final = 64
_CHUNK_BEGINS: Final = rb"(?=\x06.{5}\x00{3}.{28}(?:\x00{4}|\x03\x00{3}lz4|\x04\x00{3}zstd))"
_BESIDE_CHUNKS: Final = re.compile(_CHUNK_BEGINS + rb"|(?=[\x09\x0c\x0f].{5}\x00{3})", re.DOTALL)
"""What a chunk, or a record between chunks, begins with; lengths are below 2^40 bytes."""
_ANYWHERE: Final = re.compile(_CHUNK_BEGINS + rb"|(?=[\x03\x04\x05\x09\x0c\x0f].{5}\x00{3})", re.DOTALL)
_OPCODES: Final = frozenset(map(int, Opcode))
_LEAST_BYTES: Final = {
    int(Opcode.SCHEMA): 14,
    int(Opcode.CHANNEL): 16,
    int(Opcode.MESSAGE): MESSAGE_HEAD_BYTES,
    int(Opcode.CHUNK): 40,
    int(Opcode.ATTACHMENT): 36,
    int(Opcode.METADATA): 8,
    int(Opcode.DATA_END): 4,
}
"""What the fields of a record take that has nothing in those of any length."""

IsMessage = Callable[[bytes], bool]
"""Whether the first bytes of a message record are those of a message of this log."""


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
            None where there is none.
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
        opcode, length = _HEAD.unpack_from(self._block, start - self._block_at)
        fields_at = start + _HEAD.size
        if fields_at + length > self._size_bytes or length < _LEAST_BYTES[opcode]:
            return False
        if opcode == Opcode.CHUNK:
            return _is_chunk(self._bytes(fields_at, min(length, _FIELDS_BYTES)), length)
        if opcode == Opcode.MESSAGE and not self._is_message(self._bytes(fields_at, MESSAGE_HEAD_BYTES)):
            return False
        return self._leads_on(fields_at + length)

    def _leads_on(self, end: int) -> bool:
        """Whether a record that ends here is followed by another, or by nothing."""
        head = self._bytes(end, _HEAD.size)
        if len(head) < _HEAD.size:
            return not head
        opcode, length = _HEAD.unpack(head)
        return opcode in _OPCODES and end + _HEAD.size + length <= self._size_bytes


def _is_chunk(fields: bytes, length: int) -> bool:
    try:
        head = chunk_head(fields)
    except ValueError:
        return False
    return head.first_ns <= head.last_ns and head.record_bytes == _HEAD.size + length
