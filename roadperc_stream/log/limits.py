"""What a log declares, held against the file and against the limits before memory is given to it.

The library that reads logs allocates what a record or a chunk says of itself. Layout: https://mcap.dev/spec.
"""

import io
import os
import struct
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Final

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, ChunkIndex, Metadata

from roadperc_stream.core.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.log.integrity import MAGIC

_HEAD: Final = struct.Struct("<BQ")
_CHUNK: Final = struct.Struct("<QQQII")
_LENGTH: Final = struct.Struct("<Q")
_ALWAYS_BYTES: Final = 1024 * 1024
"""What is read unasked."""
_FRAME_HEAD_BYTES: Final = 32
"""More than the header of a frame of zstd (18) or lz4 (19) takes."""
_LZ4_RATIO: Final = 255
"""Bytes that one byte of lz4 stands for at most."""
_PIECE_BYTES: Final = 4 * 1024 * 1024


class LimitError(McapError):
    """Something larger than a setting allows; the message names it."""


class GuardedFile(io.BufferedReader):
    """A file that is not asked for more bytes than it has, nor for a larger record than the limit."""

    def __init__(self, path: Path, limits: LimitsConfig = DEFAULT_LIMITS) -> None:
        super().__init__(io.FileIO(path))
        self._size_bytes, self._most_bytes = os.fstat(self.fileno()).st_size, limits.record_bytes

    def read(self, size: int | None = -1, /) -> bytes:
        """As of any file.

        Raises:
            LimitError: that is beyond the limit.
            McapError: the file has fewer bytes left.
        """
        if size is not None and size > _ALWAYS_BYTES:
            left = self._size_bytes - self.tell()
            if size > left:
                raise McapError(f"a record of {size} bytes, {left} are left")
            require_record(size, self._most_bytes)
        return super().read(size)


def require_record(size_bytes: int, most_bytes: int) -> None:
    """Refuse a record that is too large.

    Raises:
        LimitError: it is.
    """
    if size_bytes > most_bytes:
        raise LimitError(_beyond("a record", size_bytes, "record_mb", most_bytes))


def require_affordable(stream: IO[bytes], index: Iterable[ChunkIndex], limits: LimitsConfig = DEFAULT_LIMITS) -> None:
    """Look at the chunks that an index names, before any is decompressed.

    Raises:
        LimitError: one is beyond the limit.
        McapError: one is not as large as it, or the index, says.
    """
    for entry in index:
        stream.seek(entry.chunk_start_offset + _HEAD.size)
        declared = check_chunk(stream, limits)
        if declared != entry.uncompressed_size:
            raise McapError(f"a chunk of {declared} bytes, the index says {entry.uncompressed_size}")


def check_chunk(stream: IO[bytes], limits: LimitsConfig = DEFAULT_LIMITS) -> int:
    """Look at a chunk without decompressing it; lz4 that does not say its size is measured piece by piece.

    Args:
        stream: behind the head of the chunk's record; it is left anywhere.
        limits: of the chunk.

    Returns:
        The bytes it declares to have, decompressed.

    Raises:
        LimitError: it has more than the limit.
        McapError: it has more than it declares.
    """
    _, _, declared, _, name_bytes = _CHUNK.unpack(stream.read(_CHUNK.size))
    name = stream.read(min(name_bytes, _FRAME_HEAD_BYTES)).decode("ascii", "replace")
    (stored,) = _LENGTH.unpack(stream.read(_LENGTH.size))
    if declared > limits.chunk_bytes:
        raise LimitError(_beyond("a chunk", declared, "chunk_mb", limits.chunk_bytes))
    content = _content_bytes(stream, name, stored, declared)
    if content > limits.chunk_bytes:
        raise LimitError(_beyond("a chunk", content, "chunk_mb", limits.chunk_bytes))
    if content > declared:
        raise McapError(f"a chunk of {content} bytes or more that declares {declared}")
    return int(declared)


def _content_bytes(stream: IO[bytes], name: str, stored: int, declared: int) -> int:
    """What a chunk's data decompress to, as far as it may be more than is declared."""
    if name == "zstd":
        # Without a size in it, the library decompresses no more than the chunk declares.
        found = int(zstandard.get_frame_parameters(stream.read(min(stored, _FRAME_HEAD_BYTES))).content_size)
        return declared if found == zstandard.CONTENTSIZE_UNKNOWN else found
    if name == "lz4" and stored * _LZ4_RATIO > declared:
        return _lz4_bytes(stream.read(stored), declared)
    return declared


def _lz4_bytes(data: bytes, enough: int) -> int:
    """Length of a frame's contents; of longer ones than enough a little more than that."""
    found: int = lz4.frame.get_frame_info(data)["content_size"]
    if found:
        return found
    decompressor, given, length = lz4.frame.LZ4FrameDecompressor(), data, 0
    while not decompressor.eof and length <= enough:
        piece = decompressor.decompress(given, max_length=_PIECE_BYTES)
        given = b""
        if not piece and decompressor.needs_input:
            break  # cut off: reading it says so
        length += len(piece)
    return length


def chunk_starts(stream: IO[bytes]) -> Iterator[int]:
    """Where the bodies of all chunks start; the stream is left anywhere."""
    return (start for opcode, start, _ in _records(stream) if opcode == Opcode.CHUNK)


def attachments_in(stream: IO[bytes]) -> list[Attachment]:
    """All attachments of a file, whether its index names them or not; no chunk is decompressed.

    Raises:
        McapError: one is not what it declares.
    """
    return [Attachment.read(body) for body in _bodies(stream, Opcode.ATTACHMENT)]


def metadata_in(stream: IO[bytes]) -> list[Metadata]:
    """All metadata of a file, as ``attachments_in``."""
    return [Metadata.read(body) for body in _bodies(stream, Opcode.METADATA)]


def _bodies(stream: IO[bytes], wanted: Opcode) -> Iterator[ReadDataStream]:
    for opcode, start, length in _records(stream):
        if opcode == wanted:
            stream.seek(start)
            yield ReadDataStream(io.BytesIO(stream.read(length)))


def _records(stream: IO[bytes]) -> Iterator[tuple[int, int, int]]:
    """Type, start and length of the bodies of all records of the data section."""
    at = len(MAGIC)
    while True:
        stream.seek(at)
        head = stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return
        opcode, length = _HEAD.unpack(head)
        yield opcode, at + _HEAD.size, length
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return
        at += _HEAD.size + length


def _beyond(what: str, size_bytes: int, setting: str, most_bytes: int) -> str:
    mebibytes = size_bytes / 1024**2
    return f"{what} of {mebibytes:.0f} MiB: expected limits.{setting} {most_bytes // 1024**2} at most"
