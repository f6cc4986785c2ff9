"""The results of a command: printed, and written as JSON, Markdown for merge requests, and JUnit XML for CI servers."""

import json
import math
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal
from urllib.parse import quote
from xml.etree import ElementTree

from rich.console import Console

from roadperc_stream.errors import TargetError
from roadperc_stream.output.terminal import print_lines, print_table
from roadperc_stream.output.text_table import Table, markdown_text
from roadperc_stream.system.files import completing, real_path, write_whole
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


@dataclass(frozen=True)
class Results:
    """What a command found.

    ``head`` and ``tail`` are lines above and below the ``tables``; a text among the tables is a line that wraps.
    ``values`` are the same figures for JSON, and ``cases`` are those of the JUnit file. ``pictures`` are captions and
    files, which the Markdown refers to by their relative paths.
    """

    command: str
    title: str
    head: Sequence[str] = ()
    tables: Sequence[Table | str] = ()
    tail: Sequence[str] = ()
    values: Mapping[str, Any] = field(default_factory=dict)
    cases: Sequence[Case] = ()
    pictures: Sequence[tuple[str, Path]] = ()

    def print(self, console: Console) -> None:
        """Print the lines and the tables."""
        print_lines(console, *self.head, unbroken=True)
        for part in self.tables:
            if isinstance(part, str):
                print_lines(console, part)
            else:
                print_table(console, part)
        print_lines(console, *self.tail, unbroken=True)

    def write(self, files: ResultFiles) -> None:
        """Write the files for other programs.

        Raises:
            TargetError: a file cannot be written, has the suffix of an input, or is named twice.
        """
        for place, path in enumerate(files.paths):
            if path.suffix.lower() in _INPUTS:
                expected = "expected the name of a result, not of a log, a table or a criteria file"
                raise TargetError(f"{path}: {expected}")
            if real_path(path) in map(real_path, files.paths[:place]):
                raise TargetError(f"{path}: two options name it; give each result its own file")
        if files.json is not None:
            write_json(files.json, self.values)
        if files.markdown is not None:
            _append(files.markdown, self._markdown(files.markdown.parent))
        if files.junit is not None:
            write_whole(files.junit, _junit(f"roadperc-{self.command}", self.cases))

    def _markdown(self, folder: Path) -> str:
        """A heading, a list of the lines, the pictures with paths relative to a folder, and the tables."""
        texts = (part for part in self.tables if isinstance(part, str) and part)
        lines = "\n".join(f"- {markdown_text(line)}" for line in (*self.head, *texts, *self.tail))
        tables = (table.markdown() for table in self.tables if isinstance(table, Table))
        shown_here = (
            f"{markdown_text(caption)}\n\n![{markdown_text(caption)}]({quote(os.path.relpath(path, folder))})"
            for caption, path in self.pictures
        )
        parts = f"## {markdown_text(self.title)}", lines, *shown_here, *tables
        return "\n\n".join(filter(None, parts)) + "\n"


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a nested mapping as JSON; NaN and infinities become null.

    Characters of keys that MLflow refuses become ``_``; keys that are equal then get a number.

    Raises:
        TargetError: the file cannot be written.
    """
    write_whole(path, json.dumps(_plain(value), indent=2, allow_nan=False) + "\n")


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


def _append(path: Path, text: str) -> None:
    """Append a text to a file, which may have text of others."""
    with completing(path) as temporary:
        if is_begun := path.is_file() and path.stat().st_size > 0:
            shutil.copyfile(path, temporary)
        with temporary.open("a", encoding="utf-8") as stream:
            stream.write("\n" * is_begun + text)


def _junit(suite: str, cases: Sequence[Case]) -> str:
    """Cases as JUnit XML that GitLab, GitHub's actions and Jenkins read.

    The class name of a case is its log. The text is the body of its element, because GitLab ignores the attribute
    ``message``; other readers show only that, so it has the first line.
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
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
