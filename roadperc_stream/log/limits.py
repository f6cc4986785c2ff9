"""What a log declares, held against the file and against the limits before memory is given to it.

The library that reads logs allocates what a record or a chunk says of itself.
"""

import io
import os
import re
from pathlib import Path
from typing import Final

import lz4.frame
import zstandard
from mcap.exceptions import McapError

from roadperc_stream.config import LimitsConfig
from roadperc_stream.log.layout import ChunkHead
from roadperc_stream.log.records import RECOVERY_RECORD, Metadata

_STRING: Final = re.compile(r'"(?:[^"\\]|\\.)*"', re.DOTALL)
"""In JSON."""
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

    def __init__(self, path: Path, limits: LimitsConfig) -> None:
        """Open a log.

        Raises:
            OSError: the system does not.
        """
        super().__init__(path.open("rb").detach())
        self._size_bytes, self._most_bytes = self.seek(0, os.SEEK_END), limits.record_bytes
        self.seek(0)

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
            if size > self._most_bytes:
                raise LimitError(_beyond("a record", size, "record_mb", self._most_bytes))
        return super().read(size)


def require_attachments(size_bytes: int, limits: LimitsConfig) -> None:
    """Refuse more attachments and metadata than may be held.

    Args:
        size_bytes: of all of them.
        limits: of the log.

    Raises:
        LimitError: they are too many.
    """
    if size_bytes > limits.attachments_bytes:
        raise LimitError(_beyond("attachments and metadata", size_bytes, "attachments_mb", limits.attachments_bytes))


def require_gaps(metadata: Metadata, limits: LimitsConfig) -> None:
    """Refuse a record of more gaps than there may be, before it is decoded.

    Raises:
        LimitError: it is one.
    """
    if metadata.name != RECOVERY_RECORD:
        return
    text = dict(metadata.values).get("gaps", "")
    if text.count("[") - 1 > limits.gaps and (found := _STRING.sub("", text).count("[") - 1) > limits.gaps:
        raise LimitError(f"metadata {RECOVERY_RECORD} of {found} gaps: expected limits.gaps {limits.gaps} at most")


def check_chunk(head: ChunkHead, limits: LimitsConfig) -> None:
    """Look at a chunk without decompressing it; lz4 that does not say its size is measured piece by piece.

    Raises:
        LimitError: it has more bytes, decompressed, than the limit.
        McapError: it has more than it declares.
    """
    _require_chunk(head.size_bytes, limits)
    content = _content_bytes(head)
    _require_chunk(content, limits)
    if content > head.size_bytes:
        raise McapError(f"a chunk of {content} bytes or more that declares {head.size_bytes}")


def _require_chunk(size_bytes: int, limits: LimitsConfig) -> None:
    if size_bytes > limits.chunk_bytes:
        raise LimitError(_beyond("a chunk", size_bytes, "chunk_mb", limits.chunk_bytes))


def _content_bytes(head: ChunkHead) -> int:
    """What a chunk's data decompress to, as far as it may be more than is declared."""
    if head.compression == "zstd":
        # Without a size in it, the library decompresses no more than the chunk declares.
        found = int(zstandard.get_frame_parameters(head.stored[:_FRAME_HEAD_BYTES]).content_size)
        return head.size_bytes if found == zstandard.CONTENTSIZE_UNKNOWN else found
    if head.compression == "lz4" and head.stored_bytes * _LZ4_RATIO > head.size_bytes:
        return _lz4_bytes(head.stored, head.size_bytes)
    return head.size_bytes


def _lz4_bytes(data: memoryview, enough: int) -> int:
    """Length of a frame's contents; of longer ones than enough a little more than that."""
    found: int = lz4.frame.get_frame_info(data)["content_size"]
    if found:
        return found
    decompressor, length = lz4.frame.LZ4FrameDecompressor(), 0
    given: bytes | memoryview = data
    while not decompressor.eof and length <= enough:
        piece = decompressor.decompress(given, max_length=_PIECE_BYTES)
        given = b""
        if not piece and decompressor.needs_input:
            break  # cut off: reading it says so
        length += len(piece)
    return length


def _beyond(what: str, size_bytes: int, setting: str, most_bytes: int) -> str:
    mebibytes = size_bytes / 1024**2
    return f"{what} of {mebibytes:.0f} MiB: expected limits.{setting} {most_bytes // 1024**2} at most"
