"""Tables and lines on a terminal, or as plain text where they are piped: how all commands print."""

from typing import Final, TextIO

from rich.box import Box
from rich.console import Console
from rich.table import Table

NARROWEST, WIDEST = 80, 120
"""Columns a text is laid out for; a narrower terminal wraps its lines rather than losing digits."""
_RULE_BELOW_HEADER: Final = Box("\n".join(["    ", "    ", " ── ", "    ", "    ", "    ", "    ", "    "]))


def console_for(stream: TextIO) -> Console:
    """A console that keeps numbers whole, takes names as they are, and colours nothing where it is piped."""
    width = min(max(Console(file=stream).width, NARROWEST), WIDEST)
    return Console(file=stream, width=width, highlight=False, markup=False, emoji=False)


def grid(title: str, *headers: str, text: str = "", label_columns: int = 26) -> Table:
    """A table without lines: labels on the left, columns of numbers, and maybe a column of text.

    Where it gets narrow, labels and text fold; numbers neither wrap nor shorten.
    """
    table = Table(box=_RULE_BELOW_HEADER, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0), header_style="bold")
    # One column at most may fold: of two, rich narrows both alike, below what the labels must have.
    table.add_column(title, min_width=label_columns, no_wrap=bool(text), overflow="fold", header_style="bold cyan")
    for header in headers:
        table.add_column(header, justify="right", no_wrap=True, min_width=len(header))
    if text:
        table.add_column(text, overflow="fold")
    return table


def print_table(console: Console, table: Table, *notes: str) -> None:
    """Print a table that has rows, with a line of air before it and notes below."""
    if table.row_count:
        print_lines(console, "", table, *(note for note in notes if note))


def print_lines(console: Console, *lines: str | Table, unbroken: bool = False) -> None:
    """Print without the blanks that fill lines up to the right margin; what does not fit runs over, uncut.

    Text folds between its words, unless ``unbroken``: what somebody may search for stays on its line.
    """
    with console.capture() as capture:
        for line in lines:
            console.print(line, crop=False, soft_wrap=unbroken and isinstance(line, str))
    for line in capture.get().splitlines():
        console.file.write(f"{line.rstrip()}\n")
