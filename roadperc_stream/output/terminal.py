"""Prints tables, lines and progress of all commands, on a terminal or as plain text into a pipe."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Final, TextIO

from rich.box import Box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table as RichTable
from rich.text import Text

from roadperc_stream.output.text_table import GAP, Table
from roadperc_stream.system.process import discard_output
from roadperc_stream.system.progress import no_progress
from roadperc_stream.system.text import shown

NARROWEST, WIDEST = 80, 120
"""Limits of the layout width in characters; a narrower terminal wraps lines and loses no digits."""
_RULE_BELOW_HEADER: Final = Box("\n".join(["    ", "    ", " ── ", "    ", "    ", "    ", "    ", "    "]))
_LEAST_LABEL: Final = 15
"""Width of labels in a table whose numbers leave no space for wider ones."""
_VERDICT: Final = r"^(?:check: )?(?:(?P<red>worse|failed|error)|(?P<green>better|passed))(?=$|[:, ])"
"""A verdict at the beginning of a line or a cell; the names of the groups are its colours."""


class PipeConsole(Console):
    """A console that continues after its reader closes the pipe; rich would exit with code 1."""

    def on_broken_pipe(self) -> None:
        """Send buffered and later output to the null device."""
        discard_output(self.file)


def console_for(stream: TextIO) -> Console:
    """A console that never splits numbers, interprets no markup in names, and has no colours in a pipe."""
    width = min(max(PipeConsole(file=stream).width, NARROWEST), WIDEST)
    return PipeConsole(file=stream, width=width, highlight=False, markup=False, emoji=False)


def print_table(console: Console, table: Table) -> None:
    """Print a table after an empty line, with its notes below; without rows, print its title and notes.

    Labels and text wrap. Numbers never do: a table whose numbers do not fit is wider than the console.
    """
    if table.rows:
        print_lines(console, "", _rendered(table, console.width), *table.notes)
    elif table.notes:
        print_lines(console, "", *(f"{table.title}: {note}" for note in table.notes))


def _rendered(table: Table, width: int) -> RichTable:
    """A table without borders: labels on the left, columns of numbers, optionally a last column of text."""
    rendered = RichTable(
        box=_RULE_BELOW_HEADER, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0), header_style="bold"
    )
    # Only one column may fold: rich shrinks two columns equally, which makes labels too narrow.
    words = table.last_is_text
    numbers = [GAP + columns for columns in table.widths[: len(table.headers) - words]]
    labels = max(width - sum(numbers), min(max(len(shown(row[0])) for row in table.rows), _LEAST_LABEL))
    least = table.label_columns if words else min(table.label_columns, labels)
    rendered.add_column(shown(table.title), min_width=least, no_wrap=words, overflow="fold", header_style="bold cyan")
    for header in table.headers[: len(numbers)]:
        rendered.add_column(shown(header), justify="right", no_wrap=True)
    if words:
        rendered.add_column(shown(table.headers[-1]), overflow="fold")
    elif least + sum(numbers) > width:
        rendered.width = least + sum(numbers)
    for label, *cells in table.rows:
        rendered.add_row(shown(label), *(_coloured(shown(cell)) for cell in cells))
    return rendered


def _coloured(text: str) -> Text:
    """A text with the colour of the verdict that it begins with; a pipe and ``NO_COLOR`` get none."""
    coloured = Text(text)
    coloured.highlight_regex(_VERDICT)
    return coloured


def print_lines(console: Console, *lines: str | RichTable, unbroken: bool = False) -> None:
    """Print lines without trailing spaces; long lines are not cut.

    Text wraps between words, unless ``unbroken``, which keeps searchable text on its line. Control characters are
    escaped; those of a ``RichTable`` must be escaped already.
    """
    with console.capture() as capture:
        for line in lines:
            text = _coloured(shown(line)) if isinstance(line, str) else line
            console.print(text, crop=False, soft_wrap=unbroken and isinstance(line, str))
    for line in capture.get().splitlines():
        console.file.write(f"{line.rstrip()}\n")


@contextmanager
def frame_progress(activity: str, enabled: bool) -> Iterator[Callable[[int, int], None]]:
    """A progress bar over frames on a terminal; nothing in a pipe."""
    if not enabled:
        yield no_progress
        return
    with job_progress() as show:
        yield partial(show, activity)


@contextmanager
def job_progress() -> Iterator[Callable[[str, int, int], None]]:
    """As ``frame_progress``, for a job whose activity changes: the callback takes it with the frames."""
    console = PipeConsole(stderr=True)
    if not console.is_terminal:
        yield lambda _activity, _done, _total: None
        return
    text = TextColumn("{task.description}", markup=False)
    columns = (text, BarColumn(), MofNCompleteColumn(), TextColumn("frames"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        console.show_cursor(True)  # a program that a signal kills does not restore a hidden cursor
        task = bar.add_task("", total=None)
        yield lambda activity, done, total: bar.update(task, description=activity, completed=done, total=total)
