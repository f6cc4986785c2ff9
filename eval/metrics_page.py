"""Writes the tables of columns into pages of docs/: ``make pages``."""

import re
import sys
from pathlib import Path
from typing import Final

from roadperc_stream.schemas.columns import FrameMetrics, ObjectMetrics, columns_of
from roadperc_stream.schemas.columns.column import Column
from roadperc_stream.schemas.columns.hindsight import FrameHindsight, TrackHindsightColumns
from roadperc_stream.schemas.columns.places import ObjectPlaceColumns, TrueObjectListColumns
from roadperc_stream.schemas.columns.runs import RunRow

_BLOCK: Final = re.compile(r"(<!-- columns: (?P<groups>[\w ]+) -->\n).*?(<!-- end -->)", re.DOTALL)
"""A table in the page, below the names of the groups of columns it defines."""
_HEADER: Final = ("column", "meaning", "unit, better", "null where", "relevant", "limit")
"""Only tables of errors have the last two."""
_ROWS: Final = (
    *(*FrameMetrics.__bases__, *FrameHindsight.__bases__, TrueObjectListColumns),
    *(ObjectMetrics, TrackHindsightColumns, ObjectPlaceColumns, RunRow),
)
_GROUPS: Final = {group.__name__: group for group in _ROWS}


def with_tables(page: str) -> str:
    """The page with its tables of columns regenerated.

    Raises:
        KeyError: the page names a group of columns that does not exist.
    """
    return _BLOCK.sub(lambda block: f"{block[1]}{table(block['groups'].split())}{block[3]}", page)


def table(groups: list[str]) -> str:
    """Markdown lines that define the columns of some groups: a line for columns with the same definition."""
    names_of: dict[tuple[str, ...], list[str]] = {}
    for group in groups:
        for name, column in columns_of(_GROUPS[group]).items():
            names_of.setdefault(_cells(column), []).append(f"`{name}`")
    rows = [(", ".join(names), *cells) for cells, names in names_of.items()]
    judged = any(row[-1] for row in rows)
    filled = [i for i, name in enumerate(_HEADER) if any(row[i] for row in rows) and (judged or name != "relevant")]
    first, *lines = (f"| {' | '.join(row[i] for i in filled)} |\n" for row in (_HEADER, *rows))
    return f"{first}{'|---' * len(filled)}|\n{''.join(lines)}"


def _cells(column: Column) -> tuple[str, ...]:
    limit = "" if column.limit is None else f"{column.limit:g}"
    relevant = f"{column.relevant:g}" if column.label else ""
    return column.meaning, ", ".join(filter(None, (column.unit, column.better))), column.null, relevant, limit


def main() -> None:
    """Rewrite the pages that are named."""
    for path in map(Path, sys.argv[1:]):
        path.write_text(with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
