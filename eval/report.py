"""What came out of one replay or many, on the terminal and as a page."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from roadperc_stream.errors import TableError
from roadperc_stream.terminal import console_for, print_lines

from .runs import Run, find_runs
from .summary import summarise_all, summarise_run
from .terminal import print_empty, print_one, print_several

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
    runs = find_runs(arguments)
    filled = [item for item in runs if item.frames]
    if not filled:
        raise TableError(f"{runs[0].path}: no frames in this table, so there is nothing to report")
    if html is not None and write_page is not None:
        write_page(html, filled)  # before anything is printed: whoever reads the text may close the pipe early
    console = console_for(sys.stdout)
    print_empty(console, [item for item in runs if not item.frames])
    if len(filled) == 1:
        print_one(console, summarise_run(filled[0], worst))
    else:
        print_several(console, *summarise_all(filled, worst))
    if html is not None:
        print_lines(console, "", f"page   {html}", unbroken=True)
