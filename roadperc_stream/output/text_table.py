"""A table of texts for the terminal and for HTML pages."""

from collections.abc import Iterable, Sequence
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

    def flat(self) -> "TextTable":
        """The table with one line of cells in every row.

        Several subjects become columns if each has one value per row, else lines below the label of the row.
        """
        if len(self.subjects) < 2:
            return self
        if self.headers == _ONE_VALUE:
            rows = [row(item.label, *(cells[0] if cells else "" for cells in item.cells)) for item in self.rows]
            return replace(self, headers=self.subjects, rows=tuple(rows), subjects=())
        return self.in_lines()

    def in_lines(self) -> "TextTable":
        """The table with a line for each subject below the label of the row."""
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
