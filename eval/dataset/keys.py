"""What a report over a dataset is grouped by: columns of the tables, and of the list of runs."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import polars as pl

from roadperc_stream.errors import TableError

from ..names import listed
from .place import DATE
from .run_rows import RUN_COLUMNS

LOG: Final = ("log_id", "config")
"""What tells one run of a dataset from all others."""
_ALIASES: Final = {"log": "log_id"}
_OF_THE_FILE: Final = (*LOG, DATE)
UNKNOWN_GROUP: Final = "none"
Key = tuple[str | None, ...]
"""The values of a group's columns."""


@dataclass(frozen=True)
class Grouping:
    """The columns that rows are grouped by, and where they come from.

    ``of_runs`` are taken from the list of runs, ``of_rows`` may change from frame to frame; the others are a file's.
    """

    columns: tuple[str, ...]
    of_runs: tuple[str, ...]
    of_rows: tuple[str, ...]

    @property
    def asked(self) -> tuple[str, ...]:
        """The columns as ``--by`` calls them."""
        back = {column: name for name, column in _ALIASES.items()}
        return tuple(back.get(name, name) for name in self.columns)

    @property
    def of_whole_logs(self) -> bool:
        """Whether all frames of a log under a configuration are in one group."""
        return not self.of_rows


def grouping(by: Sequence[str], table_columns: Collection[str]) -> Grouping:
    """What ``--by`` asks for.

    Args:
        by: names of columns, ``log`` for that of the log's digest.
        table_columns: those of the metrics tables.

    Raises:
        TableError: there is no such column.
    """
    names = tuple(dict.fromkeys(_ALIASES.get(name, name) for name in by))
    of_rows = tuple(name for name in names if name not in _OF_THE_FILE and name in table_columns)
    of_runs = tuple(name for name in names if name not in (*_OF_THE_FILE, *of_rows) and name in RUN_COLUMNS)
    for name in names:
        if name not in (*_OF_THE_FILE, *of_rows, *of_runs):
            raise TableError(f"--by {name}: {_no_such(name, [*table_columns, *RUN_COLUMNS])}")
    return Grouping(names, of_runs, of_rows)


def default_columns(versions: Collection[str | None]) -> tuple[str, ...]:
    """What to group by where nobody says: what made the tables.

    Args:
        versions: of the program, as far as they are known.
    """
    return ("config", "version") if len(versions) > 1 else ("config",)


def as_key(name: str, kind: pl.DataType) -> pl.Expr:
    """A column as text that groups and their names are made of."""
    column = pl.col(name)
    text = column.cast(pl.List(pl.String)).list.join("; ") if isinstance(kind, pl.List) else column.cast(pl.String)
    return pl.when(text.str.len_bytes() > 0).then(text).alias(key_name(name))


def key_name(name: str) -> str:
    """What the column of a group's key is called: other than that of the table, which is a number maybe."""
    return f"by {name}"


def _no_such(name: str, known: Iterable[str]) -> str:
    near = sorted({other for other in known if name.split("_", maxsplit=1)[0] in other})
    hint = f"; there are {listed(near)}" if near else ""
    return f"no column of the metrics tables or of the list of runs{hint}"
