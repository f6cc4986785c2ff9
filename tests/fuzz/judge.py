"""Checks that a command ended with a result or one clear line."""

import re
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz.choices import INJECTED

ROOT = Path(__file__).parents[2]
SOURCES = [ROOT / name for name in ("roadperc_stream", "tools", "eval")]
FUZZER = [ROOT / "tests"]
CODES = (0, 1, 2, 3)
LONGEST_LINE = 12_000
"""Characters; a name of 10,000 characters is printed in full."""
_ASIDE = re.compile(r"(note|warning): ")
_USAGE = re.compile(r"roadperc-[a-z]+: error: ")
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029]")
_REFUSED = re.compile(rb"Unable to allocate|Insufficient memory|[Cc]annot allocate memory|MemoryError|bad_alloc")
"""Messages of libraries that ran out of memory, reported as if the input were wrong."""
_CODE = re.compile(r'File "([^"]*)", line \d+, in (\w+)')


@dataclass(frozen=True)
class Ran:
    """The outcome of a command."""

    words: tuple[str, ...]
    code: int | None
    """None if an exception left the command."""
    out: bytes
    err: bytes
    crash: str = ""
    """The traceback."""
    appeared: tuple[str, ...] = ()
    """New files."""


def faults(ran: Ran) -> list[str]:
    """The rules that the command broke."""
    if ran.code is None:
        return [f"traceback: {crash_line(ran.crash)}"]
    found = [] if ran.code in CODES else [f"exit code {ran.code}"]
    refused = _REFUSED.search(ran.out + ran.err)
    found += [f"memory: {refused[0].decode()}"] if refused else []
    return [*found, *_errors(ran), *_printed("stdout", ran.out), *_printed("stderr", ran.err), *_left(ran)]


def _errors(ran: Ran) -> list[str]:
    """Besides notes and warnings: one line after a failure, none after success; wrong usage also prints the usage."""
    lines = [line for line in ran.err.decode("utf-8", "replace").split("\n") if line.strip()]
    said = [line for line in lines if not _ASIDE.match(line)]
    if ran.code == 2:
        said = said[-1:] if said and _USAGE.match(said[-1]) else said
    if any(line.startswith("Traceback") for line in lines):
        return ["stderr: a traceback: " + crash_line("\n".join(lines))]
    if len(said) != (ran.code != 0):
        return [f"stderr: {len(said)} lines with exit code {ran.code}: {_first(said)}"]
    if said and len(said[0]) > LONGEST_LINE:
        return [f"stderr: a line of {len(said[0])} characters: {_first(said)}"]
    return []


def _first(lines: list[str]) -> str:
    return repr(lines[0][:120]) if lines else "no line"


def _printed(stream: str, data: bytes) -> list[str]:
    try:
        text = data.decode()
    except UnicodeDecodeError:
        return [f"{stream}: no UTF-8"]
    found = _CONTROL.search(text)
    if found:
        return [f"{stream}: control character {found[0]!a}"]
    return [f"{stream}: a name begins a line of its own"] * any(line.startswith(INJECTED) for line in text.split("\n"))


def _left(ran: Ran) -> list[str]:
    partial = [name for name in ran.appeared if ".partial" in name]
    if partial:
        return [f"left behind: {_kind_of_file(partial[0])}"]
    if ran.code and ran.appeared and ran.words[0] != "batch":  # a failure is a row of runs.parquet
        return [f"exit code {ran.code}, but it wrote: {_kind_of_file(ran.appeared[0])}"]
    return []


def _kind_of_file(name: str) -> str:
    return "".join(Path(name).suffixes) or "a file without a suffix"


def crash_line(trace: str, sources: Sequence[Path] = SOURCES) -> str:
    """The exception, and the last function of the sources in its traceback."""
    lines = [line for line in trace.splitlines() if line.strip()]
    places = [
        (Path(file), name) for file, name in _CODE.findall(trace) if any(Path(file).is_relative_to(f) for f in sources)
    ]
    where = f"{places[-1][0].name}:{places[-1][1]}" if places else "?"
    return f"{lines[-1].strip()[:160] if lines else '?'} in {where}"


def crash_of(error: BaseException) -> str:
    """The traceback of an exception."""
    return "".join(traceback.format_exception(error))


_NUMBER = re.compile(r"0x[0-9a-f]+|-?\d[\d.e+-]*")
_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
_PATH = re.compile(r"\S*[/.](mcap|parquet|json|toml|png|txt|csv|ply|bin|npy|jpg)\b\S*|/\S+")


def kind_of_message(text: str) -> str:
    """A message without the names, numbers and quotes of its case, to count equal faults together."""
    return _NUMBER.sub("N", _QUOTED.sub("Q", _PATH.sub("P", text)))[:160]
