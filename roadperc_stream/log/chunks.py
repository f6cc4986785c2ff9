"""Decompresses chunks and reads their records, up to the first fault.

A cut or damaged chunk is decompressed piece by piece up to the fault, and never beyond the size that it declares.
Format: https://mcap.dev/spec.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BufferedReader, BytesIO
from typing import Any, Final

import lz4.frame
import zstandard
from deflate import crc32
from mcap.opcode import Opcode
from zstandard import ZstdDecompressor, ZstdError

from roadperc_stream.log.layout import NAMES, RECORD, TOO_SHORT, ChunkHead, Record, records_in

INSIDE: Final = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))
_PIECE_BYTES: Final = 1024 * 1024
_STREAMS: Final[dict[str, Callable[[ChunkHead], Any]]] = {
    "": lambda head: BytesIO(head.stored),
    "zstd": lambda head: BufferedReader(ZstdDecompressor().stream_reader(head.stored, read_across_frames=True)),
    "lz4": lambda head: lz4.frame.LZ4FrameFile(BytesIO(head.stored)),
}
"""Streams over a chunk's decompressed data, by compression. They read all frames."""


def contents_of(head: ChunkHead, most: int) -> tuple[list[Record], str]:
    """Return a chunk's records up to the first fault, at most ``most``, and the fault; empty without one.

    If the CRC of complete data is wrong, no record is returned, because any of them may be wrong.
    """
    data, broken = _decompressed(head)
    is_whole = len(data) == head.size_bytes
    if head.stored_bytes > len(head.stored) and not is_whole:
        broken = TOO_SHORT
    if head.crc and (is_whole or not broken) and (crc := crc32(data)) != head.crc:
        return [], _wrong_crc(crc, head.crc)
    found, fault = _split(data, most)
    expected = "" if is_whole else f"holds {len(data)} bytes, expected {head.size_bytes}"
    return found, broken or fault or expected


def streamed(head: ChunkHead) -> Iterator[Record]:
    """Yield the records of a checked chunk, one in memory at a time.

    Raises:
        ValueError: it ends early, or its CRC is wrong; the CRC is checked behind the last record.
    """
    stream, at, crc = _STREAMS[head.compression](head), 0, 0

    def taken(length: int) -> bytes:
        nonlocal at, crc
        data: bytes = stream.read(min(length, head.size_bytes - at))
        if len(data) < length:
            raise ValueError(TOO_SHORT)
        at, crc = at + length, crc32(data, crc)
        return data

    while at < head.size_bytes:
        start = at
        opcode, length = RECORD.unpack(taken(RECORD.size))
        yield Record(start, opcode, taken(length))
    if stream.read(1):
        raise ValueError(_too_long(head))
    if head.crc and crc != head.crc:
        raise ValueError(_wrong_crc(crc, head.crc))


@dataclass(frozen=True)
class Unpacked:
    """A chunk's decompressed data."""

    data: memoryview
    is_plain: bool
    """Whether the data is one frame of the declared size: many readers only read the first frame."""


def unpacked(head: ChunkHead, *, check_crc: bool) -> Unpacked:
    """Decompress a chunk whose size was checked with ``limits.require_chunk``, in one step if possible.

    Raises:
        ValueError: the data is not valid, or its CRC is to be checked and is wrong.
    """
    at_once = _at_once(head)
    data, fault = _decompressed(head) if at_once is None else (at_once, "")
    if fault:
        raise ValueError(fault)
    if check_crc and head.crc and (crc := crc32(data)) != head.crc:
        raise ValueError(_wrong_crc(crc, head.crc))
    return Unpacked(data, at_once is not None)


def too_many(most: int) -> str:
    """Return the fault of a chunk with more messages than the limit."""
    return f"more messages in a chunk than {most}"


def _at_once(head: ChunkHead) -> memoryview | None:
    """Return the data of a chunk that is a single frame of the declared size; None for any other."""
    data: bytes | memoryview = head.stored
    try:
        if head.compression == "zstd":
            if zstandard.frame_content_size(head.stored) not in {-1, head.size_bytes}:
                return None  # the library would allocate that size; -1 is unknown
            data = ZstdDecompressor().decompress(head.stored, max_output_size=head.size_bytes)
        elif head.compression == "lz4":
            frame = lz4.frame.LZ4FrameDecompressor()
            data = frame.decompress(head.stored, max_length=head.size_bytes + 1)
            if not frame.eof:
                return None
    except (ZstdError, RuntimeError):
        return None
    return memoryview(data) if len(data) == head.size_bytes else None


def _decompressed(head: ChunkHead) -> tuple[memoryview, str]:
    """Return a chunk's data, at most the declared size, and why it is incomplete; empty if it is complete."""
    if not head.compression:
        return head.stored, ""
    stream, data, fault = _STREAMS[head.compression](head), bytearray(), ""
    try:
        while piece := stream.read1(_PIECE_BYTES):
            data += piece
            if len(data) > head.size_bytes:
                return memoryview(data)[: head.size_bytes], _too_long(head)
    except EOFError:
        fault = TOO_SHORT
    except (ZstdError, RuntimeError) as error:
        fault = " ".join(str(error).split())
    return memoryview(data), fault


def _too_long(head: ChunkHead) -> str:
    return f"holds more than the declared {head.size_bytes} bytes"


def _wrong_crc(found: int, expected: int) -> str:
    return f"crc is {found:#010x}, expected {expected:#010x}"


def _split(data: memoryview, most: int) -> tuple[list[Record], str]:
    """Return the records in a chunk's data, at most ``most``, and why they end early."""
    found: list[Record] = []
    try:
        for record in records_in(data):
            if len(found) == most:
                return found, too_many(most)
            if record.opcode in NAMES and record.opcode not in INSIDE:
                kind = f"a record with opcode {record.opcode:#04x} at its byte {record.start}"
                return found, f"{kind}, expected schema, channel or message"
            found.append(record)
    except ValueError as error:
        return found, str(error)
    return found, ""
