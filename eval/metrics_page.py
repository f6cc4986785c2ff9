"""Writes the tables of columns into pages of docs/: ``make pages``."""

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from roadperc_stream.schemas.columns import FrameMetrics, ObjectMetrics, columns_of
from roadperc_stream.schemas.columns.column import Column
from roadperc_stream.schemas.columns.runs import RunRow

_BLOCK: Final = re.compile(r"(<!-- columns: (?P<groups>[\w ]+) -->\n).*?(<!-- end -->)", re.DOTALL)
"""A table in the page, below the names of the groups of columns it defines."""
_HEADER: Final = ("column", "meaning", "unit", "better", "null where")
_JUDGED: Final = ("relevant", "limit")
"""Headings that tables of errors have, too."""
_GROUPS: Final = {group.__name__: group for group in (*FrameMetrics.__bases__, ObjectMetrics, RunRow)}


def with_tables(page: str) -> str:
    """The page with its tables of columns regenerated.

    Raises:
        KeyError: the page names a group of columns that does not exist.
    """
    return _BLOCK.sub(lambda block: f"{block[1]}{table(block['groups'].split())}{block[3]}", page)


def table(groups: list[str]) -> str:
    """Markdown lines that define the columns of some groups."""
    columns = {name: column for group in groups for name, column in columns_of(_GROUPS[group]).items()}
    judged = any(column.limit is not None for column in columns.values())
    header = (*_HEADER, *(_JUDGED if judged else ()))
    rows: list[Sequence[str]] = [header]
    for name, column in columns.items():
        cells = [f"`{name}`", column.meaning, column.unit, column.better, column.null]
        rows.append(cells + (_judged(column) if judged else []))
    first, *lines = (f"| {' | '.join(row)} |\n" for row in rows)
    return f"{first}{'|---' * len(header)}|\n{''.join(lines)}"


def _judged(column: Column) -> list[str]:
    limit = "" if column.limit is None else f"{column.limit:g}"
    return [f"{column.relevant:g}" if column.label else "", limit]


def main() -> None:
    """Rewrite the pages that are named."""
    for path in map(Path, sys.argv[1:]):
        path.write_text(with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
