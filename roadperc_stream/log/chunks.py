"""Decompresses chunks and reads their records, never beyond the size that they declare.

Format: https://mcap.dev/spec.
"""

from collections.abc import Callable, Iterator
from io import BufferedReader, BytesIO
from typing import Any, Final

import lz4.frame
from deflate import crc32
from mcap.opcode import Opcode
from zstandard import ZstdDecompressor

from roadperc_stream.log.layout import (
    MESSAGE,
    NAMES,
    RECORD,
    TOO_SHORT,
    UNREADABLE,
    ChunkHead,
    Record,
    fault_of,
    require_crc,
)

INSIDE: Final = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))
_BUFFER_BYTES: Final = 64 * 1024
_STREAMS: Final[dict[str, Callable[[ChunkHead], Any]]] = {
    "": lambda head: BytesIO(head.stored),
    "zstd": lambda head: BufferedReader(
        ZstdDecompressor().stream_reader(head.stored, read_across_frames=True), _BUFFER_BYTES
    ),
    "lz4": lambda head: lz4.frame.LZ4FrameFile(BytesIO(head.stored)),
}
"""Streams over a chunk's decompressed data, by compression. They read all frames."""


class SizeError(ValueError):
    """A chunk that declares too many bytes, although its CRC is that of its data."""


def streamed(head: ChunkHead) -> Iterator[Record]:
    """Yield the records of a chunk, one in memory at a time.

    Raises:
        ValueError: it ends early, or its CRC is wrong; the CRC is checked behind the last record.
        RuntimeError, EOFError, ZstdError: it cannot be decompressed.
    """
    stream, at, crc = _STREAMS[head.compression](head), 0, 0

    def taken(length: int) -> bytes:
        nonlocal at, crc
        left = head.size_bytes - at
        data: bytes = stream.read(min(length, left))
        if not data and head.crc and crc == head.crc:
            raise SizeError(f"holds {at} bytes, declares {head.size_bytes}")
        if len(data) < length:
            raise ValueError(_too_long(head) if len(data) == left else TOO_SHORT)
        at, crc = at + length, crc32(data, crc)
        return data

    while at < head.size_bytes:
        start = at
        opcode, length = RECORD.unpack(taken(RECORD.size))
        yield Record(start, opcode, taken(length))
    if stream.read(1):
        raise ValueError(_too_long(head))
    require_crc("chunk", crc, head.crc)


def outline_of(head: ChunkHead, most: int) -> tuple[list[Record], str, bool]:
    """Return a chunk's records up to the first fault, of messages only the fields.

    Then the fault, empty without one, and whether the records may be altered, because the chunk's CRC does not show
    that they are right.
    """
    found: list[Record] = []
    try:
        for record in streamed(head):
            if record.opcode in INSIDE:
                if len(found) == most:
                    return found, too_many(most), bool(head.crc)
                is_message = record.opcode == Opcode.MESSAGE
                found.append(record._replace(body=record.body[: MESSAGE.size]) if is_message else record)
            elif record.opcode in NAMES:
                fault = f"{record.name} record at its byte {record.start}, expected schema, channel or message"
                return found, fault, bool(head.crc)
    except UNREADABLE as error:
        return found, fault_of(error), bool(head.crc) and not isinstance(error, SizeError)
    return found, "", False


def unpacked(head: ChunkHead) -> memoryview:
    """Return the data of a chunk whose size was checked with ``limits.require_chunk``.

    Raises:
        ValueError: the data is not valid, or its CRC is wrong.
        RuntimeError, EOFError, ZstdError: it cannot be decompressed.
    """
    data = head.stored
    if head.compression:
        data = memoryview(_STREAMS[head.compression](head).read(head.size_bytes + 1))
    if len(data) != head.size_bytes:
        raise ValueError(_too_long(head) if len(data) > head.size_bytes else TOO_SHORT)
    require_crc("chunk", crc32(data), head.crc)
    return data


def too_many(most: int) -> str:
    """Return the fault of a chunk with more messages than the limit."""
    return f"more messages in a chunk than {most}"


def _too_long(head: ChunkHead) -> str:
    return f"holds more than the declared {head.size_bytes} bytes"
