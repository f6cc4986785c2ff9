"""A table of texts for the terminal and for HTML pages."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

_ONE_VALUE: Final = ("",)


@dataclass(frozen=True)
class TextRow:
    """A row: a label, the cells of each subject, and an explanation of the label, shown on a page only.

    A subject without values has no cells; the last cells may be left out. ``listed`` are the subjects that get a line,
    in order; None for all subjects with values.
    """

    label: str
    cells: tuple[tuple[str, ...], ...] = ((),)
    about: str = ""
    listed: tuple[int, ...] | None = None
    below: str = ""
    """A second line of the label, on a terminal only."""

    def of_texts(self, text: Callable[[str], str]) -> "TextRow":
        """The row with a function applied to every text."""
        cells = tuple(tuple(map(text, cells)) for cells in self.cells)
        return replace(self, label=text(self.label), cells=cells, below=text(self.below))


@dataclass(frozen=True)
class TextTable:
    """A title, which is the heading of the labels, headers of the columns, rows, and explanatory notes.

    ``subjects`` are the runs or configurations that the rows compare; empty for a single one. ``last_is_text`` says
    that the last column contains text. Labels get ``label_columns`` characters if they fit.
    """

    title: str
    headers: tuple[str, ...]
    rows: tuple[TextRow, ...]
    notes: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()
    last_is_text: bool = False
    label_columns: int = 26

    def of_texts(self, text: Callable[[str], str]) -> "TextTable":
        """The table with a function applied to every text."""
        headers, subjects = tuple(map(text, self.headers)), tuple(map(text, self.subjects))
        rows, notes = tuple(item.of_texts(text) for item in self.rows), tuple(map(text, self.notes))
        return replace(self, title=text(self.title), headers=headers, rows=rows, notes=notes, subjects=subjects)

    def flat(self) -> "TextTable":
        """The table with one line of cells in every row.

        Several subjects become columns if each has one value per row, else lines below the label of the row.
        """
        if len(self.subjects) < 2:
            return self
        if self.headers == _ONE_VALUE:
            rows = [row(item.label, *(cells[0] if cells else "" for cells in item.cells)) for item in self.rows]
            return replace(self, headers=self.subjects, rows=tuple(rows), subjects=())
        return replace(self, rows=tuple(line for item in self.rows for line in self._lines(item)), subjects=())

    def _lines(self, item: TextRow) -> Iterable[TextRow]:
        having = [place for place, cells in enumerate(item.cells) if cells]
        listed = having if item.listed is None else item.listed
        return (row(item.label), *(row(f"  {self.subjects[place]}", *item.cells[place]) for place in listed))


def row(label: str, *cells: str) -> TextRow:
    """A row of a table with a single subject."""
    return TextRow(label, (cells,))


def by_header(item: TextRow, headers: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
    """The cells of all subjects by header, without headers that have no cells."""
    padded = [cells + ("",) * (len(headers) - len(cells)) for cells in item.cells]
    lines = zip(headers, zip(*padded, strict=True), strict=True)
    return [(header, cells) for header, cells in lines if any(cells)]


def transposed(table: TextTable) -> TextTable:
    """A flat table with rows and columns exchanged."""
    columns = zip(*(item.cells[0] for item in table.rows), strict=True)
    rows = tuple(row(header, *cells) for header, cells in zip(table.headers, columns, strict=True))
    return replace(table, headers=tuple(item.label for item in table.rows), rows=rows)
