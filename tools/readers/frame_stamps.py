"""Stamps of frames: from a file, or from frame numbers and a rate, relative to one fixed epoch.

A file has one stamp per line, or is a table whose first line names the columns, such as EuRoC's ``data.csv``.

Raises everywhere:
    DumpError: a stamp cannot be read, is missing or does not increase; the message names file and line, or the frame.
"""

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Final

from roadperc_stream.errors import DumpError
from roadperc_stream.system.text import in_brief, whole_number
from roadperc_stream.system.time import NS_PER_S

from .documents import EPOCH_NS, frame_number, read_lines, read_rows

_UNITS: Final = {"ns": 9, "nsec": 9, "nanoseconds": 9, "us": 6, "ms": 3, "s": 0, "sec": 0, "seconds": 0}
"""Powers of ten of the units: 10^n per second."""
_STAMPS: Final = ("timestamp", "stamp", "time", "sim_time", "elapsed", "t", "secs", "seconds")
_FRAMES: Final = ("frame", "frame_number", "frame_id", "index", "idx", "number", "id")
_FILES: Final = ("filename", "file", "file_name", "image", "name", "path")
_SEPARATORS: Final = (",", ";", "\t")
DEFAULT_RATE_HZ: Final = 20.0
_UNIX_TIME_FROM_S: Final = 1_000_000_000
"""Larger values in seconds (from 2001 on) are Unix time; a simulation does not run for 31 years."""
_LIMIT_S: Final = 2**31
"""Limit of stamps in ROS messages, in 2038."""
_DATE: Final = re.compile(r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(\.\d+)?Z?")
_MOST_DIGITS: Final = 100
_Stamp = tuple[int | None, int, int]
"""Frame number, or None if the line has none, stamp in nanoseconds, and line number."""


def _column_table(path: Path, lines: Sequence[str]) -> list[_Stamp]:
    """Return the stamps of a table's rows; empty without column names.

    Stamps are in a column such as ``timestamp``, ``stamp_ns`` or ``#timestamp [ns]``. The unit is that of the name,
    else the unit in which the values are Unix time, else seconds. Frame numbers are in their own column, else in the
    names of files.
    """
    header = next(((place, line) for place, line in enumerate(lines) if line.strip()), None)
    separator = next((sign for sign in _SEPARATORS if header and sign in header[1]), None)
    if header is None or separator is None or any(field[:1].isdigit() for field in header[1].split(separator)):
        return []
    names = [_plain(name) for name in header[1].split(separator)]
    stamps = next((k for k, (name, _) in enumerate(names) if name in _STAMPS), None)
    if stamps is None:
        raise DumpError(f"{path}: columns {in_brief(header[1].strip())}: expected one of {', '.join(_STAMPS)}")
    frames = next((k for k, (name, _) in enumerate(names) if name in _FRAMES), None)
    files = next((k for k, (name, _) in enumerate(names) if name in _FILES), None)
    found: list[_Stamp] = []
    for line, row in enumerate(read_rows(path, lines[header[0] + 1 :], separator), header[0] + 2):
        if not row or row[0].startswith("#"):
            continue
        stamp = stamp_of_seconds(_in_seconds(row[stamps].strip(), names[stamps][1])) if stamps < len(row) else None
        if stamp is None:
            raise DumpError(
                f"{path}: line {line}: expected a time in column {stamps + 1}, got {in_brief(separator.join(row))}"
            )
        named = frames if frames is not None else files
        number = frame_number(Path(row[named].strip()).stem) if named is not None and named < len(row) else None
        found.append((number, stamp, line))
    return found


def _plain(name: str) -> tuple[str, str]:
    """Return a column's name in lower case without unit, and the unit: timestamp and ns of ``#timestamp [ns]``."""
    words = re.sub(r"[^a-z_]+", " ", name.casefold()).split()
    joined = "_".join(words)
    start, _, unit = joined.rpartition("_")
    return (start, unit) if start and unit in _UNITS else (joined, "")


def _in_seconds(text: str, unit: str) -> str:
    """Return a time in seconds; without a unit, the unit is the one that puts it between 2001 and 2038."""
    value = _decimal(text)
    if value is None:
        return text
    digits = _UNITS.get(unit)
    if digits is None:
        fits = (d for d in (0, 3, 6, 9) if _UNIX_TIME_FROM_S <= value.scaleb(-d) < _LIMIT_S)
        digits = next(fits, 0)
    return str(value.scaleb(-digits))


def stamps_of_rate(frames: Sequence[int], rate_hz: float) -> dict[int, int]:
    """Return the stamp in nanoseconds of each frame number: its distance from the first number over the rate."""
    step_ns = NS_PER_S / Fraction(rate_hz)
    stamps = {number: EPOCH_NS + round((number - frames[0]) * step_ns) for number in frames}
    if frames and stamps[frames[-1]] >= _LIMIT_S * NS_PER_S:
        raise DumpError(f"frame {frames[-1]}: at {rate_hz:g} Hz its stamp is after 2038; pass a higher --rate")
    return stamps


def stamps_of_names(frames: Sequence[int]) -> dict[int, int] | None:
    """Return the stamps in nanoseconds if all frame numbers are Unix time in one unit, from 2001 to 2038; else None."""
    found = {_unit_ns(number): number for number in reversed(frames)}
    if len(found) > 1:
        examples = " and ".join(str(number) for number in sorted(found.values()))
        raise DumpError(
            f"names of two kinds, such as {examples}: expected only frame numbers, or only times in one unit"
        )
    unit_ns = next(iter(found), None)
    return None if unit_ns is None else {number: number * unit_ns for number in frames}


def _unit_ns(number: int) -> int | None:
    """Return the unit in nanoseconds in which a number is Unix time from 2001 to 2038, or None."""
    units = (unit for unit in (1, 1000, 1_000_000) if _UNIX_TIME_FROM_S <= number * unit // NS_PER_S < _LIMIT_S)
    return next(units, None)


def stamps_of_file(path: Path, frames: Sequence[int]) -> dict[int, int]:
    """Return the stamp in nanoseconds of each frame from lines ``frame seconds``, or one value per line in frame order.

    Values are seconds (from ``EPOCH_NS``, or Unix time) or ISO dates with time, as in KITTI raw. If the first line
    names columns, ``_column_table`` reads the file.
    """
    texts = read_lines(path)
    lines = _column_table(path, texts) or _lines(path, texts)
    if any(number is not None for number, _, _ in lines):
        stamps = {number: (stamp, line) for number, stamp, line in lines if number is not None}
        if len(stamps) != len(lines):
            raise DumpError(f"{path}: two lines of one frame, or lines with and without a frame number")
    else:
        if len(lines) != len(frames):
            raise DumpError(f"{path}: {len(lines)} stamps for {len(frames)} frames; write 'frame seconds' on each line")
        stamps = {number: (stamp, line) for number, (_, stamp, line) in zip(frames, lines, strict=True)}
    return _increasing(path, frames, stamps)


def stamps_by_line(path: Path, frames: Sequence[int]) -> dict[int, int]:
    """Return the stamp in nanoseconds of each frame whose line is not empty; lines count from 0 as frames do.

    Lines are those of ``stamps_of_file``: seconds, or dates with time.
    """
    texts = read_lines(path)
    stamps = {n: (_line(path, texts[n], n + 1)[1], n + 1) for n in frames if n < len(texts) and texts[n].strip()}
    return _increasing(path, list(stamps), stamps)


def _lines(path: Path, texts: Sequence[str]) -> list[_Stamp]:
    """Return the stamps of lines."""
    numbered = [(text.strip(), line) for line, text in enumerate(texts, 1)]
    kept = [(text, line) for text, line in numbered if text and not text.startswith("#")]
    if kept and not any(character.isdigit() for character in kept[0][0]):
        kept = kept[1:]
    return [_line(path, text, line) for text, line in kept]


def _line(path: Path, text: str, line: int) -> _Stamp:
    date = _DATE.search(text)
    fields = [*text[: date.start()].split(), date.group()] if date else re.split(r"[,;\s]+", text)
    fields = [field.strip(",; ") for field in fields]
    stamp = _date_ns(date) if date else stamp_of_seconds(fields[-1])
    number = whole_number(fields[0]) if len(fields) == 2 else None
    if stamp is None or len(fields) not in (1, 2) or (len(fields) == 2 and number is None):
        raise DumpError(f"{path}: line {line}: expected 'seconds' or 'frame seconds', got {in_brief(text)}")
    return number, stamp, line


def stamp_of_seconds(text: str) -> int | None:
    """Return the stamp in nanoseconds of seconds as text, or None if it is not a time."""
    seconds = _decimal(text)
    if seconds is None or not 0 <= seconds < _LIMIT_S:
        return None
    stamp = round(seconds * NS_PER_S) + (0 if seconds >= _UNIX_TIME_FROM_S else EPOCH_NS)
    return stamp if stamp < _LIMIT_S * NS_PER_S else None


def _decimal(text: str) -> Decimal | None:
    """Return a finite number that is not immense, or None."""
    try:
        value = Decimal(text)
    except InvalidOperation:
        return None
    return value if value.is_finite() and abs(value.adjusted()) < _MOST_DIGITS else None


def _date_ns(date: re.Match[str]) -> int | None:
    day, time, fraction = date.groups()
    try:
        moment = datetime.fromisoformat(f"{day}T{time}").replace(tzinfo=UTC)
    except ValueError:
        return None
    return int(moment.timestamp()) * NS_PER_S + round(Decimal(f"0{fraction or ''}") * NS_PER_S)


def _increasing(path: Path, frames: Sequence[int], stamps: Mapping[int, tuple[int, int]]) -> dict[int, int]:
    missing = [number for number in frames if number not in stamps]
    if missing:
        raise DumpError(f"{path}: no stamp for frame {missing[0]} ({len(missing)} frames without)")
    for earlier, later in pairwise(frames):
        if stamps[later][0] <= stamps[earlier][0]:
            raise DumpError(f"{path}: line {stamps[later][1]}: frame {later} is not later than frame {earlier}")
    return {number: stamps[number][0] for number in frames}


def mean_rate(stamps_ns: Sequence[int]) -> str:
    """Return the mean rate of ascending stamps in words, or "" for fewer than two."""
    if len(stamps_ns) < 2:
        return ""
    return f", {(len(stamps_ns) - 1) * NS_PER_S / (stamps_ns[-1] - stamps_ns[0]):.4g} Hz in the mean"
