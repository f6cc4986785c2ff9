"""Documents of a dump: read and checked, every fault a DumpError that names file and key."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, FiniteFloat, TypeAdapter, ValidationError

from roadperc_stream.config.settings import in_brief
from roadperc_stream.errors import DumpError
from roadperc_stream.system.time import NS_PER_S

T = TypeVar("T")
Numbers3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Numbers4 = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
_SHOWN_CHARACTERS = 80
_UNIX_SECONDS = re.compile(r"(?<![0-9.])([12][0-9]{9})\.([0-9]{1,9})(?![0-9])")


class Document(BaseModel):
    """A JSON object of a dump: keys it does not know are notes, NaN and infinity are faults."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


def read_json(path: Path) -> Any:
    """Content of a JSON file.

    Raises:
        DumpError: the file cannot be read or is no JSON.
    """
    try:
        return json.loads(path.read_bytes())
    except OSError as error:
        raise DumpError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise DumpError(f"{path}: not JSON: {error}") from error


def read_lines(path: Path) -> list[str]:
    """The lines of a text file.

    Raises:
        DumpError: it cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DumpError(f"{path}: {error}") from error


def checked(path: Path, expected: TypeAdapter[T], data: Any) -> T:
    """Data as the type expected.

    Raises:
        DumpError: names file, key, fault and value.
    """
    try:
        return expected.validate_python(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "the document"
        raise DumpError(f"{path}: {key}: {first['msg']}, got {in_brief(first['input'], _SHOWN_CHARACTERS)}") from error


def frame_number(name: str) -> int | None:
    """Frame number in a name: its last group of digits (``frame_00001`` is 1); None without digits.

    Unix time with a fraction (``1305031102.933``, as TUM names its images) is one number, in nanoseconds.
    """
    if stamp := _UNIX_SECONDS.search(name):
        return int(stamp[1]) * NS_PER_S + int(stamp[2].ljust(9, "0"))
    groups = re.findall(r"[0-9]+", name)
    return int(groups[-1]) if groups else None


def by_frame(path: Path, entries: Mapping[str, T]) -> dict[int, T]:
    """Entries of a document keyed by frame name, keyed by number instead.

    Raises:
        DumpError: a key without a number, or two keys of one number.
    """
    numbered: dict[int, T] = {}
    names: dict[int, str] = {}
    for name, entry in entries.items():
        number = frame_number(name)
        if number is None:
            raise DumpError(f"{path}: {name!r}: expected a frame number as key")
        if number in names:
            raise DumpError(f"{path}: {names[number]!r} and {name!r} are both frame {number}")
        numbered[number], names[number] = entry, name
    return numbered
