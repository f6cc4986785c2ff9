"""What the bench prints: tables on a terminal, in a page of the docs, and all of it as JSON."""

import json
import os
import platform
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Any, Final

import cv2
import numpy as np

from roadperc_stream import __version__
from roadperc_stream.errors import TargetError
from roadperc_stream.output.terminal import console_for, print_table
from roadperc_stream.output.text_table import TextTable, row

from .figures import (
    ALL,
    BARE,
    COMPARED,
    CONTROL,
    HELP,
    LOGS,
    ONE,
    Series,
    SpeedFigure,
    course_name,
    floor_name,
    middle,
    noise,
    parts_of,
    replay_name,
)
from .inputs import WARM_UP

_MET: Final = {None: "", True: "met", False: "missed"}
_PLACE: Final = re.compile(r"(<!-- make bench writes here -->\n).*?(<!-- to here -->)", re.DOTALL)


def tables(series: Series, found: Sequence[SpeedFigure]) -> list[TextTable]:
    """Times of each run, of each part, and what is wanted, with the machine's noise."""
    return [
        _runs(series),
        _parts(series, "a replay with one thread", {name: replay_name(name, ONE) for name in LOGS}),
        _parts(series, "the course's method", {name: course_name(name) for name in COMPARED}),
        _parts(series, "the floor", {name: floor_name(name) for name in COMPARED}),
        figures_table(found, (_noise(series),)),
    ]


def print_tables(found: Sequence[TextTable]) -> None:
    """Print tables on stdout."""
    console = console_for(sys.stdout)
    for table in found:
        print_table(console, table)


def write_page(path: Path, found: Sequence[TextTable]) -> None:
    """Put the tables in their place in a page.

    Raises:
        TargetError: the page has no place for them.
    """
    text = path.read_text(encoding="utf-8")
    lines = "\n".join(line for table in found for line in (*_markdown(table), ""))
    page, places = _PLACE.subn(lambda place: f"{place[1]}\n{lines}\n{place[2]}", text)
    if not places:
        raise TargetError(f"{path}: expected a place for the tables, <!-- make bench writes here -->")
    path.write_text(page, encoding="utf-8")


def _markdown(table: TextTable) -> Iterator[str]:
    yield _line(table.title, *table.headers)
    yield _line("---", *("---:" for _ in table.headers))
    for item in table.rows:
        yield _line(item.label, *item.cells[0])
    for note in table.notes:
        yield from ("", note)


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def figures_table(found: Sequence[SpeedFigure], notes: tuple[str, ...] = ()) -> TextTable:
    """A row a figure."""
    rows = (row(item.name, f"{item.value:.2f}", _MET[item.met], item.wanted) for item in found)
    return TextTable("figure", ("measured", "", "wanted"), tuple(rows), notes, last_is_text=True, label_columns=48)


def _noise(series: Series) -> str:
    values = series[CONTROL]
    work = f"The same work between all runs took {median(values):.0f} ms of a processor"
    return f"{work}, {min(values):.0f} to {max(values):.0f}: noise of {noise(series):.0%}."


def _runs(series: Series) -> TextTable:
    names = (
        *(course_name(log) for log in COMPARED),
        *(f"{course_name(log)}, {ALL}" for log in COMPARED),
        *(replay_name(log, threads) for threads in (ONE, ALL) for log in LOGS),
        BARE,
        HELP,
    )
    quantities = (("cpu", "{:.1f}"), ("wall", "{:.1f}"), ("peak_mb", "{:.0f}"), ("first frame/wall", "{:.0f}"))
    rows = (
        row(name, *(_text(middle(series, f"{name}/{key}"), layout) for key, layout in quantities)) for name in names
    )
    measured = tuple(item for item in rows if item.cells[0][0])
    note = f"Medians of the rounds; of a log a frame, without the start: what its first {WARM_UP} frames alone take."
    return TextTable("run", ("cpu ms", "wall ms", "peak MB", "first frame ms"), measured, (note,), label_columns=30)


def _text(value: float | None, layout: str = "{:.1f}") -> str:
    return "" if value is None else layout.format(value)


def _parts(series: Series, title: str, jobs: dict[str, str]) -> TextTable:
    """A column a log, a row a part, the parts' sum last where nothing gives a total."""
    columns = {log: parts for log, job in jobs.items() if (parts := parts_of(series, job))}
    names = dict.fromkeys(name for parts in columns.values() for name in parts)
    if "total" not in names:
        columns = {log: {**parts, "total": sum(parts.values())} for log, parts in columns.items()}
    names = {**{name: None for name in names if name != "total"}, "total": None}
    rows = (row(name, *(_text(parts.get(name)) for parts in columns.values())) for name in names)
    return TextTable(f"{title}, ms a frame", tuple(columns), tuple(rows), label_columns=40)


def write_json(path: Path, series: Series, found: Sequence[SpeedFigure], about: dict[str, Any]) -> None:
    """All of it for programs: the figures, and the values of each quantity, one a round."""
    content = {
        "version": __version__,
        "machine": {
            "processors": os.cpu_count(),
            "python": platform.python_version(),
            "numpy": np.__version__,
            "opencv": cv2.__version__,
        },
        **about,
        "figures": [{"name": f.name, "value": f.value, "least": f.least, "most": f.most, "met": f.met} for f in found],
        "series": series,
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
