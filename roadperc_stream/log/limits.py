"""Compares the sizes that a log declares with the limits, before memory is allocated."""

from typing import Final

from mcap.exceptions import McapError

from roadperc_stream.config import LimitsConfig
from roadperc_stream.log.layout import ChunkHead

ATTACHED: Final = "attachments and metadata"
"""All of a log, which are kept in memory."""


class LimitError(McapError):
    """Something exceeds a limit; the message names the setting."""


def require_record(size_bytes: int, limits: LimitsConfig, what: str = "a record") -> None:
    """Check the size of a record, or of ``what`` else has the same limit.

    Raises:
        LimitError: it exceeds the limit.
    """
    if size_bytes > limits.record_bytes:
        raise LimitError(_beyond(what, size_bytes, "record_mb", limits.record_bytes))


def require_chunk(head: ChunkHead, limits: LimitsConfig) -> None:
    """Check the decompressed size that a chunk declares.

    Raises:
        LimitError: it exceeds the limit.
    """
    if head.size_bytes > limits.chunk_bytes:
        raise LimitError(_beyond("a chunk", head.size_bytes, "chunk_mb", limits.chunk_bytes))


def _beyond(what: str, size_bytes: int, setting: str, most_bytes: int) -> str:
    mebibytes = size_bytes / 1024**2
    return f"{what} of {mebibytes:.0f} MiB: expected limits.{setting} {most_bytes // 1024**2} at most"
