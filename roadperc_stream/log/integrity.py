"""Whether a file is a whole MCAP log, and whether its bytes are those that were written.

The library checks the CRC of every chunk when asked to, but not those of the data section and of the summary, which
alone cover logs without chunks, the index and the attachments. Layout: https://mcap.dev/spec.
"""

import os
import shlex
import struct
from pathlib import Path
from typing import IO, Final

from deflate import crc32

from roadperc_stream.core.folders import not_a_log
from roadperc_stream.errors import LogError

MAGIC: Final = b"\x89MCAP0\r\n"
_FOOTER: Final = struct.Struct("<BQQQI")
_FOOTER_OPCODE: Final = 0x02
_DATA_END: Final = struct.Struct("<BQI")
_DATA_END_OPCODE: Final = 0x0F
CRC_BYTES: Final = 4
_BLOCK_BYTES: Final = 1024 * 1024


def damaged(path: Path, what: str) -> LogError:
    """The error of a log that is not whole; of a file it names the command that says what can still be read."""
    return LogError(f"{path}: {what}{says_more(path)}")


def says_more(path: Path) -> str:
    """The command that says where a log is damaged, behind other words; nothing of what is no file."""
    return f"; roadperc-info {shlex.quote(str(path))} tells what is whole" if path.is_file() else ""


def unopened(path: Path, error: OSError) -> LogError:
    """The error of a log that the system does not open; of a folder, what to do with it."""
    return LogError(not_a_log(path) if path.is_dir() else f"{path}: {error.strerror or error}")


def require_whole(path: Path, stream: IO[bytes]) -> None:
    """Tell an empty, a foreign and a cut file apart: the library's own words do not.

    Raises:
        LogError: it is one of these.
    """
    require_log(path, stream)
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(size - len(MAGIC), 0))
    if stream.read(len(MAGIC)) != MAGIC or size < 2 * len(MAGIC):
        raise damaged(path, f"cut off: the MCAP footer is missing after {size} bytes")
    stream.seek(0)


def require_log(path: Path, stream: IO[bytes]) -> None:
    """Refuse a file that does not even start as an MCAP log; the stream is then at the first record.

    Raises:
        LogError: it is empty, or something else.
    """
    stream.seek(0)
    require_magic(path, stream.read(len(MAGIC)))


def require_magic(path: Path, magic: bytes) -> None:
    """Refuse what does not start as an MCAP log.

    Args:
        path: of the file or the pipe.
        magic: its first bytes, as many as the magic has, or all there are.

    Raises:
        LogError: it is empty, or something else.
    """
    if not magic:
        raise LogError(f"{path}: empty file, expected an MCAP log")
    if magic != MAGIC:
        raise LogError(f"{path}: not an MCAP log (it does not start with the MCAP magic)")


def data_end_of(stream: IO[bytes]) -> int | None:
    """The byte where the data section's last record starts, by the footer; None where no such record does."""
    footer_start = stream.seek(0, os.SEEK_END) - len(MAGIC) - _FOOTER.size
    opcode, _, summary_start, _, _ = _unpack(stream, _FOOTER, footer_start)
    data_end = (summary_start or footer_start) - _DATA_END.size
    is_data_end = opcode == _FOOTER_OPCODE and _unpack(stream, _DATA_END, data_end)[0] == _DATA_END_OPCODE
    return data_end if is_data_end else None


def summary_fits(stream: IO[bytes]) -> bool:
    """Whether the summary's bytes are those that were written, as far as a CRC says so."""
    footer_start = stream.seek(0, os.SEEK_END) - len(MAGIC) - _FOOTER.size
    opcode, _, summary_start, _, expected = _unpack(stream, _FOOTER, footer_start)
    if opcode != _FOOTER_OPCODE or not expected or not summary_start:
        return True
    if summary_start >= footer_start:
        return False
    crc, left = 0, footer_start + _FOOTER.size - CRC_BYTES - stream.seek(summary_start)
    while left > 0 and (block := stream.read(min(left, _BLOCK_BYTES))):
        crc, left = crc32(block, crc), left - len(block)
    return crc == expected


def _unpack(stream: IO[bytes], record: struct.Struct, start: int) -> tuple[int, ...]:
    """The fields of a record; zeros where the file has none there."""
    stream.seek(max(start, 0))
    content = stream.read(record.size) if start >= 0 else b""
    return record.unpack(content.ljust(record.size, b"\0"))
