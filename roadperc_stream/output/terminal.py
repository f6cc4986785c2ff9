"""Tables, lines and progress on a terminal, or as plain text where they are piped: how all commands print."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Final, TextIO

from rich.box import Box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from roadperc_stream.output.text_table import TextRow, TextTable, transposed
from roadperc_stream.system.process import discard_output
from roadperc_stream.system.progress import no_progress
from roadperc_stream.system.text import shown

NARROWEST, WIDEST = 80, 120
"""Columns a text is laid out for; a narrower terminal wraps its lines rather than losing digits."""
_RULE_BELOW_HEADER: Final = Box("\n".join(["    ", "    ", " ── ", "    ", "    ", "    ", "    ", "    "]))
_GAP: Final = 2
"""Blanks between two columns."""
_LEAST_LABEL: Final = 15
"""Characters that labels keep, however many columns of numbers there are: rather these go on in a table below."""


class PipeConsole(Console):
    """A console whose reader may go: rich would end the command with exit code 1, here it goes on unread."""

    def on_broken_pipe(self) -> None:
        """Send buffered and later output to the null device."""
        discard_output(self.file)


def console_for(stream: TextIO) -> Console:
    """A console that keeps numbers whole, takes names as they are, and colours nothing where it is piped."""
    width = min(max(PipeConsole(file=stream).width, NARROWEST), WIDEST)
    return PipeConsole(file=stream, width=width, highlight=False, markup=False, emoji=False)


def print_table(console: Console, table: TextTable) -> None:
    """Print a table with a line of air before it and its notes below; without rows, its notes behind its title.

    Where it gets narrow, labels and text fold; numbers neither wrap nor shorten: columns that do not fit go below.
    """
    table = table.of_texts(shown)
    if table.rows:
        for part in _parts(table, console.width):
            print_lines(console, "", _rendered(part, console.width))
        print_lines(console, *table.notes)
    elif table.notes:
        print_lines(console, "", *(f"{table.title}: {note}" for note in table.notes))


def print_parts(console: Console, *parts: str | TextTable) -> None:
    """Print unbroken lines and tables in their order."""
    for part in parts:
        if isinstance(part, str):
            print_lines(console, part, unbroken=True)
        else:
            print_table(console, part)


def _parts(table: TextTable, width: int) -> Iterator[TextTable]:
    """The table as flat ones that are no wider than the console, each with some of its columns."""
    flat = table.flat()
    if flat.last_is_text:
        yield flat
        return
    if flat.headers == table.subjects and _needed(flat, range(len(flat.headers))) > width:
        flat = transposed(flat)
    columns: list[int] = []
    for column in range(len(flat.headers)):
        if columns and _needed(flat, [*columns, column]) > width:
            yield _of_columns(flat, columns)
            columns = []
        columns.append(column)
    yield _of_columns(flat, columns)


def _needed(table: TextTable, columns: range | list[int]) -> int:
    """Characters that some of the columns need beside the least of their labels."""
    return _least_label(table) + sum(_GAP + _column_width(table, column) for column in columns)


def _least_label(table: TextTable) -> int:
    longest = max(max(len(item.label), len(item.below)) for item in table.rows)
    return min(longest, _LEAST_LABEL)


def _column_width(table: TextTable, column: int) -> int:
    return max(len(table.headers[column]), *(len(_cell(item, column)) for item in table.rows))


def _cell(item: TextRow, column: int) -> str:
    return item.cells[0][column] if column < len(item.cells[0]) else ""


def _of_columns(table: TextTable, columns: list[int]) -> TextTable:
    rows = tuple(replace(item, cells=(tuple(_cell(item, column) for column in columns),)) for item in table.rows)
    return replace(table, headers=tuple(table.headers[column] for column in columns), rows=rows)


def _rendered(table: TextTable, width: int) -> Table:
    """A table without lines: labels on the left, columns of numbers, and maybe a column of text."""
    rendered = Table(box=_RULE_BELOW_HEADER, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0), header_style="bold")
    # One column at most may fold: of two, rich narrows both alike, below what the labels must have.
    words = table.last_is_text
    numbers = range(len(table.headers) - words)
    label_columns = max(width - sum(_GAP + _column_width(table, column) for column in numbers), _least_label(table))
    least = table.label_columns if words else min(table.label_columns, label_columns)
    rendered.add_column(table.title, min_width=least, no_wrap=words, overflow="fold", header_style="bold cyan")
    for column in numbers:
        header = table.headers[column]
        rendered.add_column(header, justify="right", no_wrap=True, min_width=_column_width(table, column))
    if words:
        rendered.add_column(table.headers[-1], overflow="fold")
    for item in table.rows:
        rendered.add_row(f"{item.label}\n{item.below}" if item.below else item.label, *item.cells[0])
    return rendered


def print_lines(console: Console, *lines: str | Table, unbroken: bool = False) -> None:
    """Print without the blanks that fill lines up to the right margin; what does not fit runs over, uncut.

    Text folds between its words, unless ``unbroken``: what somebody may search for stays on its line. What a terminal
    would take as a command is escaped in it; a ``Table`` comes with its texts escaped.
    """
    with console.capture() as capture:
        for line in lines:
            text = shown(line) if isinstance(line, str) else line
            console.print(text, crop=False, soft_wrap=unbroken and isinstance(line, str))
    for line in capture.get().splitlines():
        console.file.write(f"{line.rstrip()}\n")


@contextmanager
def frame_progress(what: str, enabled: bool) -> Iterator[Callable[[int, int], None]]:
    """A progress bar over frames on a terminal, nothing where the output is piped."""
    console = PipeConsole(stderr=True)
    if not (enabled and console.is_terminal):
        yield no_progress
        return
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TextColumn("frames"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        console.show_cursor(True)  # a program that ends at once does not give it back
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
