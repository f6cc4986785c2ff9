"""A table of texts, built once and rendered on a terminal or into a page."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

_ONE_VALUE: Final = ("",)


@dataclass(frozen=True)
class TextRow:
    """A row: its label, per subject the cells under the table's headers, and which way is better.

    A subject without values has no cells, and cells at the end may be left out. ``listed`` are the subjects that get a
    line each, in that order; None for all that have values.
    """

    label: str
    cells: tuple[tuple[str, ...], ...] = ((),)
    better: str = ""
    listed: tuple[int, ...] | None = None
    below: str = ""
    """On a terminal, a second line of the label."""


@dataclass(frozen=True)
class TextTable:
    """A title, which is the heading of the labels, headers of columns of numbers, rows, and notes on how to read them.

    ``subjects`` are the runs or configurations that a row has cells of; a table about one thing names none.
    ``last_is_text`` says that the last column holds words. Labels get ``label_columns`` characters where they fit.
    """

    title: str
    headers: tuple[str, ...]
    rows: tuple[TextRow, ...]
    notes: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()
    last_is_text: bool = False
    label_columns: int = 26

    def of_texts(self, text: Callable[[str], str]) -> "TextTable":
        """The table with every text put through a function."""
        rows = tuple(
            replace(
                item,
                label=text(item.label),
                cells=tuple(tuple(map(text, cells)) for cells in item.cells),
                below=text(item.below),
            )
            for item in self.rows
        )
        return replace(
            self,
            title=text(self.title),
            headers=tuple(map(text, self.headers)),
            rows=rows,
            notes=tuple(map(text, self.notes)),
            subjects=tuple(map(text, self.subjects)),
        )

    def flat(self) -> "TextTable":
        """The table with a single line of cells in every row.

        Of several subjects each is a column where a row has one value of each, and else a line below the row's label.
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
    """A row of a table about one thing."""
    return TextRow(label, (cells,))


def by_header(item: TextRow, headers: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
    """A row turned: of each header that any subject has a cell under, the cells of all subjects side by side."""
    padded = [cells + ("",) * (len(headers) - len(cells)) for cells in item.cells]
    lines = zip(headers, zip(*padded, strict=True), strict=True)
    return [(header, cells) for header, cells in lines if any(cells)]


def transposed(table: TextTable) -> TextTable:
    """A flat table with its rows as columns."""
    columns = zip(*(item.cells[0] for item in table.rows), strict=True)
    rows = tuple(row(header, *cells) for header, cells in zip(table.headers, columns, strict=True))
    return replace(table, headers=tuple(item.label for item in table.rows), rows=rows)
