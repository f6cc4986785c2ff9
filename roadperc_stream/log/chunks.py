"""What a chunk holds: its records as far as they can be read, and why not all of them can.

A chunk that is cut or damaged is decompressed piece by piece: what comes before the fault is read, and never more than
the chunk declares. Layout: https://mcap.dev/spec.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BufferedReader, BytesIO
from typing import Any, Final

import lz4.frame
import zstandard
from deflate import crc32
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from zstandard import ZstdDecompressor, ZstdError

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.log.layout import RECORD, TOO_SHORT, ChunkHead, Record, records_in
from roadperc_stream.log.limits import LimitError, beyond

INSIDE: Final = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))
_PIECE_BYTES: Final = 1024 * 1024
_FRAME_HEAD_BYTES: Final = 32
"""More than the header of a frame of zstd (18) or lz4 (19) takes."""
_LZ4_RATIO: Final = 255
"""Bytes that one byte of lz4 stands for at most."""
_STREAMS: Final[dict[str, Callable[[ChunkHead], Any]]] = {
    "": lambda head: BytesIO(head.stored),
    "zstd": lambda head: BufferedReader(ZstdDecompressor().stream_reader(head.stored, read_across_frames=True)),
    "lz4": lambda head: lz4.frame.LZ4FrameFile(BytesIO(head.stored)),
}
"""Streams over all that a chunk's data decompress to, by its compression."""
_AT_ONCE: Final[dict[str, Callable[[ChunkHead], bytes | memoryview]]] = {
    "": lambda head: head.stored,
    "zstd": lambda head: ZstdDecompressor().decompress(head.stored, max_output_size=head.size_bytes),
    "lz4": lambda head: lz4.frame.decompress(head.stored),
}
"""The data of a chunk in one frame; of several, zstd gives the first alone."""


@dataclass(frozen=True)
class Contents:
    """A chunk's records up to the first fault, which is empty where there is none."""

    records: tuple[Record, ...]
    fault: str = ""


def contents_of(head: ChunkHead, limits: LimitsConfig = DEFAULT_LIMITS) -> Contents:
    """A chunk's records.

    Where the bytes make no sense, or end, those before are given: they were read as they were written. Where they do
    but their CRC is wrong, nothing says which of them is, and no record is given.
    """
    data, broken = _decompressed(head)
    found = _split(data, limits.chunk_messages)
    if head.stored_bytes > len(head.stored):
        return Contents(found.records, TOO_SHORT)
    if broken or found.fault:
        return Contents(found.records, broken or found.fault)
    if head.crc and (crc := crc32(data)) != head.crc:
        return Contents((), _wrong_crc(crc, head.crc))
    if len(data) != head.size_bytes:
        return Contents(found.records, f"holds {len(data)} bytes, expected {head.size_bytes}")
    return found


def streamed(head: ChunkHead) -> Iterator[Record]:
    """The records of a chunk that was checked before, one in memory at a time.

    Raises:
        ValueError: it ends early, or its CRC is wrong, which shows behind the last record.
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
    if head.crc and crc != head.crc:
        raise ValueError(_wrong_crc(crc, head.crc))


@dataclass(frozen=True)
class Unpacked:
    """A chunk's decompressed data."""

    data: memoryview
    is_plain: bool
    """Whether they are as many bytes as the chunk says, in one frame: many readers see no other than the first."""


def unpacked(head: ChunkHead, *, check_crc: bool) -> Unpacked:
    """A chunk's data, decompressed at once where that can be; ``check_chunk`` comes first.

    Raises:
        ValueError: the bytes make no sense, or the CRC is to be checked, and is wrong.
    """
    data, fault, is_plain = memoryview(b""), "", False
    with suppress(ZstdError, RuntimeError):
        data = memoryview(_AT_ONCE[head.compression](head))
        is_plain = len(data) == head.size_bytes
    if not is_plain:
        data, fault = _decompressed(head)
    if fault:
        raise ValueError(fault)
    if check_crc and head.crc and (crc := crc32(data)) != head.crc:
        raise ValueError(_wrong_crc(crc, head.crc))
    return Unpacked(data, is_plain)


def check_chunk(head: ChunkHead, limits: LimitsConfig) -> None:
    """Compare what a chunk declares with the limits; lz4 that does not say its size is measured piece by piece.

    Raises:
        LimitError: it has more bytes, decompressed, than the limit.
        McapError: it has more than it declares.
    """
    _require_within(head.size_bytes, limits)
    content = _content_bytes(head)
    _require_within(content, limits)
    if content > head.size_bytes:
        raise McapError(f"a chunk of {content} bytes or more that declares {head.size_bytes}")


def too_many(most: int) -> str:
    """What is wrong with a chunk of more messages than the limit."""
    return f"more messages in a chunk than limits.chunk_messages, which is {most}"


def _require_within(size_bytes: int, limits: LimitsConfig) -> None:
    if size_bytes > limits.chunk_bytes:
        raise LimitError(beyond("a chunk", size_bytes, "chunk_mb", limits.chunk_bytes))


def _content_bytes(head: ChunkHead) -> int:
    """What a chunk's data decompress to, as far as it may be more than is declared."""
    if head.compression == "zstd":
        # Without a size in it, the library decompresses no more than the chunk declares.
        found = int(zstandard.get_frame_parameters(head.stored[:_FRAME_HEAD_BYTES]).content_size)
        return head.size_bytes if found == zstandard.CONTENTSIZE_UNKNOWN else found
    if head.compression == "lz4" and head.stored_bytes * _LZ4_RATIO > head.size_bytes:
        return int(lz4.frame.get_frame_info(head.stored)["content_size"]) or _measured(head)
    return head.size_bytes


def _measured(head: ChunkHead) -> int:
    """What a chunk's data decompress to, up to a little more than is declared."""
    length = 0
    with suppress(EOFError):  # cut off: reading it says so
        for piece in _pieces(head):
            length += len(piece)
            if length > head.size_bytes:
                break
    return length


def _pieces(head: ChunkHead) -> Iterator[bytes]:
    """A chunk's data, decompressed piece by piece."""
    stream = _STREAMS[head.compression](head)
    while piece := stream.read1(_PIECE_BYTES):
        yield piece


def _decompressed(head: ChunkHead) -> tuple[memoryview, str]:
    """A chunk's data, no more than it declares, and why that is not all of them; empty where it is."""
    if not head.compression:
        return head.stored, ""
    data, fault = bytearray(), ""
    try:
        for piece in _pieces(head):
            data += piece
            if len(data) > head.size_bytes:
                return memoryview(data)[: head.size_bytes], f"holds more than the {head.size_bytes} bytes it promises"
    except EOFError:
        fault = TOO_SHORT
    except (ZstdError, RuntimeError) as error:
        fault = " ".join(str(error).split())
    return memoryview(data), fault


def _wrong_crc(found: int, expected: int) -> str:
    return f"crc is {found:#010x}, expected {expected:#010x}"


def _split(data: memoryview, most: int) -> Contents:
    """The records that stand in the decompressed data of a chunk, so many at most, and why they end early."""
    found: list[Record] = []
    fault = ""
    try:
        for record in records_in(data):
            if len(found) == most:
                fault = too_many(most)
            elif record.opcode not in INSIDE:
                kind = f"a record of type {record.opcode:#04x} at its byte {record.start}"
                fault = f"{kind}, expected schema, channel or message"
            if fault:
                break
            found.append(record)
    except ValueError as error:
        fault = str(error)
    return Contents(tuple(found), fault)
