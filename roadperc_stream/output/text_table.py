"""The table of all commands: rows of texts, which print to a terminal, in Markdown and on a page."""

import html
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Final

from roadperc_stream.system.text import shown

Row = tuple[str, ...]
"""A label, then a cell for each header; the last cells may be left out."""
GAP: Final = 2
"""Spaces between two columns."""
_COLUMNS: Final = 80
"""Width of a table with a column for each subject; wider ones have a line for each."""


@dataclass(frozen=True)
class Table:
    """A title, which is the heading of the labels, headers of the other columns, rows, and notes below.

    ``about`` explains labels on a page. ``last_is_text`` says that the last column contains text, which wraps. Labels
    get ``label_columns`` characters if they fit.
    """

    title: str
    headers: Sequence[str]
    rows: Sequence[Row]
    notes: Sequence[str] = ()
    about: Mapping[str, str] = field(default_factory=dict)
    last_is_text: bool = False
    label_columns: int = 26

    @property
    def widths(self) -> list[int]:
        """The characters of the widest text of each column after the labels."""
        columns = ((header, *self._column(k)) for k, header in enumerate(self.headers, 1))
        return [max(len(shown(text)) for text in texts) for texts in columns]

    def _column(self, place: int) -> list[str]:
        return [row[place] for row in self.rows if place < len(row)]

    def markdown(self) -> str:
        """The table and its notes in Markdown."""
        header = [self.title, *self.headers]
        rows = [[*row, *[""] * (len(header) - len(row))] for row in self.rows]
        lines = [header, ["---", *["---:"] * len(self.headers)], *rows]
        text = "\n".join(f"| {' | '.join(map(markdown_text, cells))} |" for cells in lines)
        return "\n\n".join([text, *map(markdown_text, self.notes)])


def markdown_text(text: str) -> str:
    """A text in one line of Markdown without HTML, links and control characters."""
    return re.sub(r"([\\`*_|\[\]])", r"\\\1", html.escape(shown(" ".join(text.split())), quote=False))


def rows_of_subjects(cells: Mapping[str, Mapping[str, Sequence[str]]], several: bool) -> list[Row]:
    """A row for each label with the cells of its subject; of several a line for each subject below the label.

    ``cells`` has the cells by label and subject; a subject without cells gets no line.
    """
    if not several:
        return [(label, *chain.from_iterable(found.values())) for label, found in cells.items()]
    lines = ([(label,), *((f"  {name}", *texts) for name, texts in found.items())] for label, found in cells.items())
    return list(chain.from_iterable(lines))


def values_of_subjects(
    title: str, values: Mapping[str, Mapping[str, str]], subjects: Sequence[str], notes: Sequence[str] = ()
) -> Table:
    """A table with a value for each label and subject: the subjects are columns if they fit, else lines."""
    rows = [(label, *(found.get(name, "") for name in subjects)) for label, found in values.items()]
    table = Table(title, subjects, rows, notes)
    if table.label_columns + sum(GAP + width for width in table.widths) <= _COLUMNS:
        return table
    cells = {label: {name: (text,) for name, text in found.items()} for label, found in values.items()}
    return Table(title, ("",), rows_of_subjects(cells, several=True), notes)
