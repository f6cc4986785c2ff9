"""Stamps of frames in a table whose first line names its columns, such as EuRoC's ``data.csv``."""

import csv
import re
from collections.abc import Callable, Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError

from .json_files import frame_number

_UNITS: Final = {"ns": 9, "nsec": 9, "nanoseconds": 9, "us": 6, "ms": 3, "s": 0, "sec": 0, "seconds": 0}
"""Digits behind the decimal point of seconds."""
_STAMPS: Final = ("timestamp", "stamp", "time", "sim_time", "elapsed", "t", "secs", "seconds")
_FRAMES: Final = ("frame", "frame_number", "frame_id", "index", "idx", "number", "id")
_FILES: Final = ("filename", "file", "file_name", "image", "name", "path")
_UNIX_FROM_S: Final = 1_000_000_000
_UNIX_TO_S: Final = 2**31
_SEPARATORS: Final = (",", ";", "\t")


def column_table(
    path: Path, lines: Sequence[str], stamp_of_seconds: Callable[[str], int | None]
) -> list[tuple[int | None, int, int]]:
    """Frame number where there is one, stamp in nanoseconds and line of each row; empty where no line names columns.

    The stamps are in the column ``timestamp``, ``stamp_ns``, ``#timestamp [ns]`` or one of a like name, in the unit
    it names, or the one in which they are Unix time; else seconds. Frames are those of a column of their numbers, else
    those of the numbers in the names of files.

    Args:
        path: of the table, for messages.
        lines: its lines.
        stamp_of_seconds: nanoseconds of seconds as a text; None of no time.

    Raises:
        DumpError: no column is known for stamps, or a row has none.
    """
    header = next(((place, line) for place, line in enumerate(lines) if line.strip()), None)
    separator = next((sign for sign in _SEPARATORS if header and sign in header[1]), None)
    if header is None or separator is None or any(field[:1].isdigit() for field in header[1].split(separator)):
        return []
    names = [_plain(name) for name in header[1].split(separator)]
    stamps = next((k for k, (name, _) in enumerate(names) if name in _STAMPS), None)
    if stamps is None:
        raise DumpError(f"{path}: columns {header[1].strip()!r}: expected one of {', '.join(_STAMPS)} among them")
    frames = next((k for k, (name, _) in enumerate(names) if name in _FRAMES), None)
    files = next((k for k, (name, _) in enumerate(names) if name in _FILES), None)
    found: list[tuple[int | None, int, int]] = []
    for line, row in enumerate(csv.reader(lines[header[0] + 1 :], delimiter=separator), header[0] + 2):
        if not row or row[0].startswith("#"):
            continue
        stamp = stamp_of_seconds(_in_seconds(row[stamps].strip(), names[stamps][1])) if stamps < len(row) else None
        if stamp is None:
            raise DumpError(f"{path}: line {line}: expected a time in column {stamps + 1}, got {separator.join(row)!r}")
        named = frames if frames is not None else files
        number = frame_number(Path(row[named].strip()).stem) if named is not None and named < len(row) else None
        found.append((number, stamp, line))
    return found


def _plain(name: str) -> tuple[str, str]:
    """A column's name in small letters without its unit, and the unit; ``#timestamp [ns]`` is timestamp and ns."""
    words = re.sub(r"[^a-z_]+", " ", name.casefold()).split()
    joined = "_".join(words)
    start, _, unit = joined.rpartition("_")
    return (start, unit) if start and unit in _UNITS else (joined, "")


def _in_seconds(text: str, unit: str) -> str:
    """A time as seconds; without a unit that in which it lies between 2001 and 2038, if there is one."""
    try:
        value = Decimal(text)
    except InvalidOperation:
        return text
    if not value.is_finite():
        return text
    digits = _UNITS.get(unit)
    if digits is None:
        fits = (d for d in (0, 3, 6, 9) if _UNIX_FROM_S <= value.scaleb(-d) < _UNIX_TO_S)
        digits = next(fits, 0)
    return str(value.scaleb(-digits))
