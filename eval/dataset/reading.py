"""Reads the metrics tables of a dataset, and checks their columns."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

import polars as pl

from roadperc_stream.errors import TableError

from ..runs import first_line, reading, written_columns
from .keys import LOG
from .place import FILE, scan_tables

_NAMED: Final = (*LOG, "frame", "stamp_ns")


def metrics_tables(files: Sequence[str]) -> tuple[pl.LazyFrame, pl.Schema]:
    """All rows of a dataset's metrics tables from ``scan_tables``, and their columns.

    Raises:
        TableError: a table cannot be read, or lacks columns.
    """
    tables = scan_tables(files)
    schema = tables.collect_schema()
    lacking = [name for name in (*LOG, *written_columns()) if name not in schema]
    if lacking:
        raise TableError(f"{files[0]}: is not a metrics table of a batch: it has no column {lacking[0]}")
    return tables, schema


@contextmanager
def reading_files(files: Sequence[str]) -> Iterator[None]:
    """Turn polars' errors while it reads tables into a ``TableError`` that names the file."""
    try:
        yield
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        for file in files:
            with reading(file):
                pl.read_parquet(file, glob=False, hive_partitioning=False)
        raise TableError(f"{files[0]} and others: their data cannot be read: {first_line(error)}") from error


def require_named(rows: pl.DataFrame) -> None:
    """Check that all rows have a log, a configuration, a frame number and a stamp.

    Raises:
        TableError: a value is missing, as in tables of other programs.
    """
    named = [name for name in _NAMED if name in rows.columns]
    if any(rows.select(pl.col(named).null_count()).row(0)):
        file = rows.filter(pl.any_horizontal(pl.col(named).is_null()))[FILE][0]
        raise TableError(f"{file}: is not a metrics table of a batch: it has rows without {', '.join(named)}")
