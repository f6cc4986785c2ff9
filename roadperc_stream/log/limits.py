"""What a log declares, compared with the file and the limits before memory is given to it.

The library that reads logs allocates what a record says of itself.
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
"""What is read without a check."""


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
        self.size_bytes, self._most_bytes = self.seek(0, os.SEEK_END), limits.record_bytes
        self.seek(0)

    def read(self, size: int | None = -1, /) -> bytes:
        """As of any file.

        Raises:
            LimitError: that is beyond the limit.
            McapError: the file has fewer bytes left.
        """
        if size is not None and size > _ALWAYS_BYTES:
            left = self.size_bytes - self.tell()
            if size > left:
                raise McapError(f"a record of {size} bytes, {left} are left")
            if size > self._most_bytes:
                raise LimitError(_beyond("a record", size, "record_mb", self._most_bytes))
        return super().read(size)


def require_chunk(head: ChunkHead, limits: LimitsConfig) -> None:
    """Refuse a chunk that declares more bytes, decompressed, than the limit, or fewer than its compressed data do.

    Raises:
        LimitError: it is beyond the limit.
        McapError: the two sizes contradict each other.
    """
    if head.size_bytes > limits.chunk_bytes:
        raise LimitError(_beyond("a chunk", head.size_bytes, "chunk_mb", limits.chunk_bytes))
    if _stated_bytes(head) > head.size_bytes:
        raise McapError(f"holds more than the {head.size_bytes} bytes it promises")


def _stated_bytes(head: ChunkHead) -> int:
    """What the compressed data say that they hold; -1 or 0 where they do not say it."""
    if head.compression == "zstd":
        return int(zstandard.frame_content_size(head.stored))
    return int(lz4.frame.get_frame_info(head.stored)["content_size"]) if head.compression == "lz4" else 0


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


def _beyond(what: str, size_bytes: int, setting: str, most_bytes: int) -> str:
    mebibytes = size_bytes / 1024**2
    return f"{what} of {mebibytes:.0f} MiB: expected limits.{setting} {most_bytes // 1024**2} at most"
