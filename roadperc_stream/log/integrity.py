"""Whether a file is a whole MCAP log, and whether its bytes are those that were written.

The library checks the CRC of every chunk when asked to, but not those of the data section and of the summary, which
alone cover logs without chunks, the index and the attachments. Layout: https://mcap.dev/spec.
"""

import os
import shlex
import struct
import zlib
from pathlib import Path
from typing import IO, Final

from roadperc_stream.core.folders import not_a_log
from roadperc_stream.errors import LogError

MAGIC: Final = b"\x89MCAP0\r\n"
_FOOTER: Final = struct.Struct("<BQQQI")
_FOOTER_OPCODE: Final = 0x02
_DATA_END: Final = struct.Struct("<BQI")
_DATA_END_OPCODE: Final = 0x0F
CRC_BYTES: Final = 4
_BLOCK_BYTES: Final = 4 * 1024 * 1024


def damaged(path: Path, what: str) -> LogError:
    """The error of a log that is not whole; of a file it names the command that says what can still be read."""
    hint = f"; roadperc-info {shlex.quote(str(path))} tells what is whole" if path.is_file() else ""
    return LogError(f"{path}: {what}{hint}")


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
    magic = stream.read(len(MAGIC))
    if not magic:
        raise LogError(f"{path}: empty file, expected an MCAP log")
    if magic != MAGIC:
        raise LogError(f"{path}: not an MCAP log (it does not start with the MCAP magic)")


def check_sections(path: Path, stream: IO[bytes]) -> bool:
    """Check the CRCs of summary and data section, where the writer gave them.

    Returns:
        Whether there was a CRC over the data section.

    Raises:
        LogError: a CRC is wrong.
    """
    footer_start = stream.seek(0, os.SEEK_END) - len(MAGIC) - _FOOTER.size
    opcode, _, summary_start, _, summary_crc = _unpack(stream, _FOOTER, footer_start)
    if opcode != _FOOTER_OPCODE:
        raise damaged(path, f"damaged MCAP: no footer record at byte {footer_start}")
    if summary_start and summary_crc:
        _require_crc(path, stream, "summary", summary_start, footer_start + _FOOTER.size - CRC_BYTES, summary_crc)
    data_end = (summary_start or footer_start) - _DATA_END.size
    opcode, _, data_crc = _unpack(stream, _DATA_END, data_end)
    if opcode != _DATA_END_OPCODE or not data_crc:
        return False
    _require_crc(path, stream, "data section", 0, data_end, data_crc)
    return True


def _unpack(stream: IO[bytes], record: struct.Struct, start: int) -> tuple[int, ...]:
    stream.seek(max(start, 0))
    return record.unpack(stream.read(record.size))


def _require_crc(path: Path, stream: IO[bytes], what: str, start: int, end: int, expected: int) -> None:
    stream.seek(start)
    crc, left = 0, end - start
    while left > 0 and (block := stream.read(min(left, _BLOCK_BYTES))):
        crc, left = zlib.crc32(block, crc), left - len(block)
    if crc != expected:
        raise damaged(path, f"damaged MCAP: CRC of the {what} is {crc:#010x}, expected {expected:#010x}")
