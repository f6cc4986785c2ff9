"""Read and check text, JSON, YAML and tables of dumps and datasets.

Raises everywhere:
    DumpError: the file cannot be read, or its content is wrong; the message names file, place and error.
"""

import csv
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, FailFast, Field, TypeAdapter, ValidationError

from roadperc_stream.config.calibration import LARGEST
from roadperc_stream.config.complaints import complaint, key_of
from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, is_rotation, rigid
from roadperc_stream.system.files import is_inside, read_file
from roadperc_stream.system.text import in_brief, whole_number
from roadperc_stream.system.time import NS_PER_S

T = TypeVar("T")
Id = Annotated[int, Field(ge=-(2**63), lt=2**63)] | str
Listed = Annotated[list[T], FailFast()]
"""A list whose check ends at the first wrong item."""
_MOST_BYTES: Final = 2_000_000_000
"""Largest document; the largest tables of nuScenes have 1.3 GB."""
_MOST_YAML_BYTES: Final = 1_000_000
"""Largest YAML; the usual ones have 1 kB, and PyYAML takes seconds for a megabyte."""
_SHOWN_CHARACTERS: Final = 80
EPOCH_NS: Final = 1_577_836_800 * NS_PER_S
"""2020-01-01T00:00:00Z: time 0 of every dump, so that a conversion is reproducible."""
_SECONDS: Final = re.compile(r"(?<![0-9A-Za-z.])[0-9]{1,7}\.[0-9]{1,20}(?=[^0-9.]*$)")
"""The last number of a name, as a simulation writes its time; longer numbers are dates and Unix time."""
_UNIX_SECONDS: Final = re.compile(r"(?<![0-9.])([12][0-9]{9})\.([0-9]{1,9})(?![0-9])")


class Document(BaseModel):
    """A JSON object of a dump: unknown keys are notes, NaN and infinity are errors."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


def read_text(path: Path, most_bytes: int = _MOST_BYTES) -> str:
    """Return the content of a text file in UTF-8."""
    try:
        return read_file(path, most_bytes).decode("utf-8-sig")
    except OSError as error:
        raise DumpError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise DumpError(f"{path}: not a text file in UTF-8: {error.reason} at byte {error.start}") from error


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file."""
    return read_text(path).splitlines()


def read_json(path: Path) -> Any:
    """Return the content of a JSON file."""
    return parsed_json(path, read_text(path))


def parsed_json(where: Path | str, text: str) -> Any:
    """Return the content of a JSON text; an error begins with ``where``."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DumpError(f"{where}: not JSON: {error}") from error


def read_yaml(path: Path) -> Any:
    """Return the content of a YAML file."""
    try:
        return yaml.safe_load(read_text(path, _MOST_YAML_BYTES))
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise DumpError(f"{path}: not YAML: {' '.join(str(error).split())}") from error


def read_rows(path: Path, lines: Iterable[str], separator: str = ",") -> Iterator[list[str]]:
    """Yield the fields of each line of a CSV table."""
    try:
        yield from csv.reader(lines, delimiter=separator)
    except csv.Error as error:
        raise DumpError(f"{path}: not a table: {error}") from error


def checked(path: Path | str, expected: TypeAdapter[T], data: Any, *place: str, hint: str = "") -> T:
    """Return data as the expected type.

    ``place`` are the keys of the data in the file. The message of an error ends with ``hint``.
    """
    try:
        return expected.validate_python(data)
    except ValidationError as error:
        first = error.errors()[0]
        said = complaint(first, _SHOWN_CHARACTERS)
        said += f" in {in_brief(first['input'], _SHOWN_CHARACTERS)}" * (said == "missing")
        raise DumpError(f"{path}: {key_of((*place, *first['loc'])) or 'the document'}: {said}{hint}") from error


def numbers(where: str, words: Sequence[str]) -> Float:
    """Return (N,) finite numbers of up to ``LARGEST`` from words; an error begins with ``where``."""
    found = list(map(_number, words))
    wrong = next((word for word, value in zip(words, found, strict=True) if not abs(value) <= LARGEST), None)
    if wrong is not None:
        shown = in_brief(wrong, _SHOWN_CHARACTERS)
        raise DumpError(f"{where}: expected finite numbers up to {LARGEST:g}, found {shown}")
    return np.array(found, np.float64)


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return float("nan")


def pose(where: str, matrix: Float) -> Float:
    """Return the (4, 4) pose of a (4, 4), (3, 4) or (3, 3) matrix, a rotation and a translation."""
    result = np.eye(4)
    result[: matrix.shape[0], : matrix.shape[1]] = matrix
    if not is_rotation(result[:3, :3]) or result[3].tolist() != [0, 0, 0, 1]:
        raise DumpError(f"{where}: expected a rotation without mirror and scale, found {result.tolist()}")
    return rigid(result[:3, :3], result[:3, 3])


def named_file(where: str, folder: Path, name: str) -> Path | None:
    """Return the path of a file in a folder, as another file names it; None if there is no such file.

    It is an error if the path, or a link on it, leads out of the folder.
    """
    if not is_inside(folder / name, folder):
        found = in_brief(name, _SHOWN_CHARACTERS)
        raise DumpError(f"{where}: {found} leads out of {folder}; copy the files into this folder")
    return folder / name if os.path.isfile(folder / name) else None  # noqa: PTH113 - false for a name too long


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
    return whole_number(groups[-1]) if groups else None


def is_seconds(name: str) -> bool:
    """Return True if the number in a name is the time of a simulation in seconds with a fraction."""
    return _SECONDS.search(name.removesuffix("_leftImg8bit")) is not None


def by_frame(path: Path, entries: Mapping[str, T]) -> dict[int, T]:
    """Return the entries of a document by frame number instead of frame name."""
    names: dict[int, str] = {}
    for name in entries:
        number = frame_number(name)
        if number is None:
            raise DumpError(f"{path}: {name!r}: expected a frame number as key")
        if number in names:
            raise DumpError(f"{path}: {names[number]!r} and {name!r} are both frame {number}; remove one of them")
        names[number] = name
    return {number: entries[name] for number, name in names.items()}
