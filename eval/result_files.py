"""Results for other programs: JSON, Markdown for merge requests, and JUnit XML for CI servers."""

import html
import json
import math
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal
from xml.etree import ElementTree

from roadperc_stream.errors import TargetError
from roadperc_stream.output.text_table import TextTable
from roadperc_stream.system.files import completing, real_path, require_plain
from roadperc_stream.system.text import shown

Outcome = Literal["passed", "failed", "skipped", "error"]
_ELEMENTS: Final[Mapping[Outcome, str]] = {"failed": "failure", "skipped": "skipped", "error": "error"}
_INPUTS: Final = {".mcap", ".parquet", ".toml"}
"""Suffixes of files that a result does not replace."""
_NOT_IN_NAMES: Final = re.compile(r"[^/\w.\- ]", re.ASCII)


@dataclass(frozen=True)
class Case:
    """A judged item of a JUnit file: its log, its name, which is unique within the log, and the text of its result."""

    log: str
    name: str
    outcome: Outcome
    text: str = ""


@dataclass(frozen=True)
class ResultFiles:
    """Files for other programs; None for those that are not written."""

    json: Path | None = None
    markdown: Path | None = None
    junit: Path | None = None

    @property
    def paths(self) -> list[Path]:
        """Those that are written."""
        return [path for path in (self.json, self.markdown, self.junit) if path is not None]


def write_files(
    files: ResultFiles,
    values: Mapping[str, Any],
    markdown: tuple[str, Sequence[str], Sequence[TextTable]],
    suite: str,
    cases: Sequence[Case],
) -> None:
    """Write the files for other programs; ``markdown`` is title, lines and tables.

    Raises:
        TargetError: a file cannot be written, has the suffix of an input, or is named twice.
    """
    for place, path in enumerate(files.paths):
        require_result(path)
        if real_path(path) in map(real_path, files.paths[:place]):
            raise TargetError(f"{path}: two options name it; give each result its own file")
    if files.json is not None:
        write_json(files.json, values)
    if files.markdown is not None:
        write_markdown(files.markdown, *markdown)
    if files.junit is not None:
        write_junit(files.junit, f"roadperc-{suite}", cases)


def require_result(path: Path) -> Path:
    """The path of a result.

    Raises:
        TargetError: it has the suffix of an input.
    """
    if path.suffix.lower() in _INPUTS:
        raise TargetError(f"{path}: expected the name of a result, not of a log, a table or a criteria file")
    return path


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a nested mapping as JSON; NaN and infinities become null.

    Characters of keys that MLflow refuses become ``_``; keys that are equal then get a number.

    Raises:
        TargetError: the file cannot be written.
    """
    _write(path, json.dumps(_plain(value), indent=2, allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        plain: dict[str, Any] = {}
        for key, item in value.items():
            name = _NOT_IN_NAMES.sub("_", str(key))
            plain[name if name not in plain else f"{name} {len(plain)}"] = _plain(item)
        return plain
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_markdown(path: Path, title: str, lines: Sequence[str], tables: Sequence[TextTable] = ()) -> None:
    """Append a heading, a list of lines, and tables as Markdown; the file may have text of others.

    Raises:
        TargetError: the file cannot be written.
    """
    parts = [f"## {_escaped(title)}", "\n".join(f"- {_escaped(line)}" for line in lines), *map(_markdown, tables)]
    text = "\n\n".join(part for part in parts if part) + "\n"
    with completing(path) as temporary:
        if is_begun := path.is_file() and path.stat().st_size > 0:
            shutil.copyfile(path, temporary)
        with temporary.open("a", encoding="utf-8") as stream:
            stream.write("\n" * is_begun + text)


def _markdown(table: TextTable) -> str:
    flat = table.flat()
    header = [flat.title, *flat.headers]
    rows = [[item.label, *item.cells[0], *[""] * (len(flat.headers) - len(item.cells[0]))] for item in flat.rows]
    lines = [header, ["---", *["---:"] * len(flat.headers)], *rows]
    text = "\n".join(f"| {' | '.join(map(_escaped, cells))} |" for cells in lines)
    return "\n\n".join([text, *map(_escaped, flat.notes)])


def _escaped(text: str) -> str:
    """A text in one line without HTML, links and control characters."""
    return re.sub(r"([\\`*_|\[\]])", r"\\\1", html.escape(shown(" ".join(text.split())), quote=False))


def write_junit(path: Path, suite: str, cases: Sequence[Case]) -> None:
    """Write cases as JUnit XML that GitLab, GitHub's actions and Jenkins read.

    The class name of a case is its log. The text is the body of its element, because GitLab ignores the attribute
    ``message``; other readers show only that, so it has the first line.

    Raises:
        TargetError: the file cannot be written.
    """
    counts = {
        f"{element}s" if element != "skipped" else element: str(sum(case.outcome == outcome for case in cases))
        for outcome, element in _ELEMENTS.items()
    }
    root = ElementTree.Element("testsuites")
    group = ElementTree.SubElement(root, "testsuite", {"name": suite, "tests": str(len(cases)), **counts})
    for case in cases:
        item = ElementTree.SubElement(group, "testcase", {"classname": shown(case.log), "name": shown(case.name)})
        if case.text or case.outcome in _ELEMENTS:
            element = ElementTree.SubElement(item, _ELEMENTS.get(case.outcome, "system-out"))
            element.text = "\n".join(map(shown, case.text.splitlines()))
            if case.text and case.outcome in _ELEMENTS:
                element.set("message", element.text.partition("\n")[0])
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode", xml_declaration=True)
    _write(path, text + "\n")


def _write(path: Path, text: str) -> None:
    require_plain(path)
    with completing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
