"""Where reading can go on behind bytes that make no sense, where no index says so."""

import re
import struct
from collections.abc import Callable, Iterator
from typing import IO, Final

from mcap.opcode import Opcode

from roadperc_stream.log.chunks import chunk_head

_HEAD: Final = struct.Struct("<BQ")
_BLOCK_BYTES: Final = 1024 * 1024
_OVERLAP_BYTES: Final = 64
"""More than what ``_LIKELY`` looks at."""
_CHUNK_FIELDS_BYTES: Final = 64
_LIKELY: Final = re.compile(
    rb"(?=\x06.{5}\x00{3}.{28}(?:\x00{4}|\x03\x00{3}lz4|\x04\x00{3}zstd))|(?=[\x03\x04\x05\x09\x0c\x0f].{5}\x00{3})",
    re.DOTALL,
)
"""What a chunk, or another record of the data section, begins with; lengths are below 2^40 bytes."""
_INSIDE_CHUNKS: Final = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))

IsMessage = Callable[[bytes], bool]
"""Whether the first bytes of a message record are those of a message of this log."""


def next_record(stream: IO[bytes], at: int, size_bytes: int, *, chunked: bool, is_message: IsMessage) -> int | None:
    """The byte from ``at`` on where the next record starts whose fields fit together, and with what follows it.

    Args:
        stream: of the file.
        at: first byte that is looked at.
        size_bytes: of the file.
        chunked: look for no messages, channels and schemas outside chunks: those inside one look the same.
        is_message: tells messages from what only looks like one.

    Returns:
        None where there is none.
    """
    for start in _likely(stream, at):
        stream.seek(start)
        opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
        if start + _HEAD.size + length > size_bytes or (chunked and opcode in _INSIDE_CHUNKS):
            continue
        fields = stream.read(min(length, _CHUNK_FIELDS_BYTES))
        if opcode == Opcode.CHUNK and _is_chunk(fields, length):
            return start
        plausible = opcode != Opcode.MESSAGE or is_message(fields)
        if opcode != Opcode.CHUNK and plausible and _leads_on(stream, start + _HEAD.size + length, size_bytes):
            return start
    return None


def _likely(stream: IO[bytes], at: int) -> Iterator[int]:
    while True:
        stream.seek(at)
        block = stream.read(_BLOCK_BYTES)
        for found in _LIKELY.finditer(block):
            yield at + found.start()
        if len(block) < _BLOCK_BYTES:
            return
        at += len(block) - _OVERLAP_BYTES


def _is_chunk(fields: bytes, length: int) -> bool:
    try:
        head = chunk_head(fields)
    except ValueError:
        return False
    return head.first_ns <= head.last_ns and head.record_bytes == _HEAD.size + length


def _leads_on(stream: IO[bytes], end: int, size_bytes: int) -> bool:
    """Whether a record that ends here is followed by another, or by nothing."""
    stream.seek(end)
    head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return not head
    opcode, length = _HEAD.unpack(head)
    return opcode in set(Opcode) and end + _HEAD.size + length <= size_bytes
