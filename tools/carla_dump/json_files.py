"""Read and check the documents of a dump; each error is a DumpError with file and key."""

import json
import re
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any, Final, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, FiniteFloat, TypeAdapter, ValidationError

from roadperc_stream.config.complaints import complaint, key_of
from roadperc_stream.errors import DumpError
from roadperc_stream.system.text import in_brief
from roadperc_stream.system.time import NS_PER_S

T = TypeVar("T")
Numbers3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Numbers4 = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
_SHOWN_CHARACTERS = 80
EPOCH_NS: Final = 1_577_836_800 * NS_PER_S
"""2020-01-01T00:00:00Z: time 0 of every dump, so that a conversion is reproducible."""
_SECONDS = re.compile(r"(?<![0-9A-Za-z.])[0-9]{1,7}\.[0-9]{1,20}(?=[^0-9.]*$)")
"""The last number of a name, as a simulation writes its time; longer numbers are dates and Unix time."""
_UNIX_SECONDS = re.compile(r"(?<![0-9.])([12][0-9]{9})\.([0-9]{1,9})(?![0-9])")


class Document(BaseModel):
    """A JSON object of a dump: unknown keys are notes, NaN and infinity are errors."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


def read_json(path: Path) -> Any:
    """Return the content of a JSON file.

    Raises:
        DumpError: the file cannot be read, or is not JSON.
    """
    try:
        return json.loads(path.read_bytes())
    except OSError as error:
        raise DumpError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise DumpError(f"{path}: not JSON: {error}") from error


def read_yaml(path: Path) -> Any:
    """Return the content of a YAML file.

    Raises:
        DumpError: the file cannot be read, or is not YAML.
    """
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DumpError(f"{path}: {error.strerror or error}") from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise DumpError(f"{path}: not YAML: {' '.join(str(error).split())}") from error


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file.

    Raises:
        DumpError: the file cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise DumpError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise DumpError(f"{path}: not a text file in UTF-8: {error.reason} at byte {error.start}") from error


def checked(path: Path | str, expected: TypeAdapter[T], data: Any, hint: str = "") -> T:
    """Return data as the expected type.

    Raises:
        DumpError: the data has another type; the message names file, key, error and value, and ends with ``hint``.
    """
    try:
        return expected.validate_python(data)
    except ValidationError as error:
        first = error.errors()[0]
        said = complaint(first, _SHOWN_CHARACTERS)
        said += f" in {in_brief(first['input'], _SHOWN_CHARACTERS)}" * (said == "missing")
        raise DumpError(f"{path}: {key_of(first['loc']) or 'the document'}: {said}{hint}") from error


def frame_number(name: str) -> int | None:
    """Return the frame number in a name, its last group of digits (``frame_00001`` is 1), or None.

    Seconds with a fraction are one number, in nanoseconds: Unix time (``1305031102.933``, as in TUM's image names), and
    time of a simulation (``12.80``), which is counted from ``EPOCH_NS``. The 8 in Cityscapes' ``leftImg8bit`` is no
    frame number.
    """
    if stamp := _UNIX_SECONDS.search(name):
        return int(stamp[1]) * NS_PER_S + int(stamp[2].ljust(9, "0"))
    name = name.removesuffix("_leftImg8bit")
    if seconds := _SECONDS.search(name):
        return EPOCH_NS + round(Decimal(seconds[0]) * NS_PER_S)
    groups = re.findall(r"[0-9]+", name)
    return int(groups[-1]) if groups else None


def is_seconds(name: str) -> bool:
    """Return True if the number in a name is the time of a simulation in seconds with a fraction."""
    return _SECONDS.search(name.removesuffix("_leftImg8bit")) is not None


def by_frame(path: Path, entries: Mapping[str, T]) -> dict[int, T]:
    """Return the entries of a document by frame number instead of frame name.

    Raises:
        DumpError: a key has no number, or two keys have the same number.
    """
    numbered: dict[int, T] = {}
    names: dict[int, str] = {}
    for name, entry in entries.items():
        number = frame_number(name)
        if number is None:
            raise DumpError(f"{path}: {name!r}: expected a frame number as key")
        if number in names:
            raise DumpError(f"{path}: {names[number]!r} and {name!r} are both frame {number}; remove one of them")
        numbered[number], names[number] = entry, name
    return numbered
