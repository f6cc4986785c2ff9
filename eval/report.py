"""What came out of one replay or many, on the terminal and as a page."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from roadperc_stream.errors import TableError
from roadperc_stream.output.terminal import console_for, print_lines

from .configurations import grouped, settings_table
from .drives import find_drives
from .names import name_columns, short_names
from .runs import Run
from .summary import summarise_group, summarise_run
from .terminal import print_one, print_several

WritePage = Callable[[Path, list[Run]], None]


def print_report(arguments: Sequence[str], worst: int, html: Path | None, write_page: WritePage | None) -> None:
    """Print tables over finished runs.

    Args:
        arguments: tables, logs, folders or globs.
        worst: how many frames are listed for each error.
        html: a page to write as well.
        write_page: what writes it; None where there is none, for it imports much.

    Raises:
        TableError: no such run, or none has a frame.
    """
    found = find_drives(arguments)
    filled = [item for item in found.runs if item.frames]
    if not filled:
        raise TableError(f"{found.runs[0].why_empty}, so there is nothing to report")
    if html is not None and write_page is not None:
        write_page(html, filled)  # before anything is printed: whoever reads the text may close the pipe early
    console = console_for(sys.stdout)
    print_lines(console, *found.notes, *(item.why_empty for item in found.runs if not item.frames), unbroken=True)
    if len(filled) == 1:
        print_one(console, summarise_run(filled[0], worst))
    else:
        _print_several(console, filled, worst)
    if html is not None:
        print_lines(console, "", f"page   {html}", unbroken=True)


def _print_several(console: Console, runs: Sequence[Run], worst: int) -> None:
    names = short_names([run.name for run in runs], name_columns(console))
    groups = grouped([replace(run, name=names[run.name]) for run in runs])
    settings = settings_table({group.name: group.example for group in groups})
    print_several(console, [summarise_group(group, worst) for group in groups], settings, names)
