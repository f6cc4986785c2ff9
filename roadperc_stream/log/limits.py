"""Compares the sizes that a log declares with the file and the limits, before memory is allocated.

The mcap library allocates any size that a record declares.
"""

import io
import os
from typing import Final

from mcap.exceptions import McapError

from roadperc_stream.config import LimitsConfig
from roadperc_stream.log.layout import ChunkHead
from roadperc_stream.log.stored import LogFile

_ALWAYS_BYTES: Final = 1024 * 1024
"""Reads up to this size are not checked."""


class LimitError(McapError):
    """Something exceeds a limit; the message names the setting."""


class GuardedFile(io.BufferedReader):
    """A file that raises an error for reads beyond its end, or of a record beyond the limit."""

    def __init__(self, file: LogFile, limits: LimitsConfig) -> None:
        super().__init__(file.path.open("rb").detach())
        self.size_bytes, self._most_bytes = self.seek(0, os.SEEK_END), limits.record_bytes
        self.seek(0)

    def read(self, size: int | None = -1, /) -> bytes:
        """Read bytes.

        Raises:
            LimitError: more than a record may have.
            McapError: more than the file has left.
        """
        if size is not None and size > _ALWAYS_BYTES:
            left = self.size_bytes - self.tell()
            if size > left:
                raise McapError(f"a record of {size} bytes, {left} bytes are left")
            if size > self._most_bytes:
                raise LimitError(_beyond("a record", size, "record_mb", self._most_bytes))
        return super().read(size)

    def exactly(self, size: int) -> bytes:
        """Read bytes.

        Raises:
            McapError: the file has fewer left; else as ``read``.
        """
        data = self.read(size)
        if len(data) < size:
            raise McapError(f"expected {size} bytes, found {len(data)}")
        return data


def require_chunk(head: ChunkHead, limits: LimitsConfig) -> None:
    """Check the decompressed size that a chunk declares.

    Raises:
        LimitError: it exceeds the limit.
    """
    if head.size_bytes > limits.chunk_bytes:
        raise LimitError(_beyond("a chunk", head.size_bytes, "chunk_mb", limits.chunk_bytes))


def require_attachments(size_bytes: int, limits: LimitsConfig) -> None:
    """Check the total size of a log's attachments and metadata.

    Raises:
        LimitError: it exceeds the limit.
    """
    if size_bytes > limits.record_bytes:
        raise LimitError(_beyond("attachments and metadata", size_bytes, "record_mb", limits.record_bytes))


def _beyond(what: str, size_bytes: int, setting: str, most_bytes: int) -> str:
    mebibytes = size_bytes / 1024**2
    return f"{what} of {mebibytes:.0f} MiB: expected limits.{setting} {most_bytes // 1024**2} at most"
