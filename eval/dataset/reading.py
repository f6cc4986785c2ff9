"""Reads all tables of a dataset once, in batches of rows, and collects totals of each log.

Polars' streaming engine reads only the columns in use. A batch is the largest object in memory.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

import polars as pl

from roadperc_stream.errors import TableError

from ..expressions import as_key, key_name
from ..report_columns import COVERED, RANKED
from ..runs import first_line, reading, written_columns
from ..scan import NUMBER_COLUMNS, SEGMENT, derived_columns, difference, finite, stored_columns
from .keys import LOG, Grouping
from .place import DATE, FILE, date_of, scan_tables

FRAMES, SPAN_NS, SEGMENTS, GAP_NS, FILES = "frames", "span ns", "segments", "gap ns", "files"
_ROWS: Final = 131_072
"""Rows of a batch: 130 MB."""
_NAMED: Final = (*LOG, "frame", "stamp_ns")
_SECOND: Final = 2
"""Rows of the previous batch for the second differences of the first rows."""
_OWN_SEGMENT: Final = "segment of the log"
_STRETCH: Final = "stretch"


def valued(column: str) -> str:
    """The column of ``logs_of`` that counts the frames with a value."""
    return f"valued {column}"


def summed(column: str) -> str:
    """The column of ``logs_of`` with the sum of absolute values, or of the values if high is better."""
    return f"summed {column}"


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


def rows_of_tables(files: Sequence[str], by: Grouping) -> pl.LazyFrame:
    """The columns of metrics tables that a report needs, with ``FILE`` and the keys that come from the tables.

    ``files`` are at least one, for an address a pattern.

    Raises:
        TableError: a table cannot be read, or lacks columns.
    """
    tables, schema = metrics_tables(files)
    keys = [
        date_of(pl.col(FILE)).alias(key_name(name)) if name == DATE else as_key(name, schema)
        for name in by.columns
        if name not in by.of_runs
    ]
    return tables.select(pl.col("config").cast(pl.String), pl.col(FILE), *keys, *stored_columns())


@contextmanager
def reading_files(files: Sequence[str]) -> Iterator[None]:
    """Turn polars' errors while it reads tables into a ``TableError`` that names the file."""
    try:
        yield
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError) as error:
        for file in files:
            with reading(file):
                pl.read_parquet(file, columns=["stamp_ns", "total_ms"], glob=False, hive_partitioning=False)
        raise TableError(f"{files[0]} and others: their data cannot be read: {first_line(error)}") from error


def batches(rows: pl.LazyFrame, files: Sequence[str]) -> Iterator[pl.DataFrame]:
    """Batches of rows with derived columns, in order.

    Raises:
        TableError: a table cannot be read, or is not a metrics table of a batch.
    """
    before: pl.DataFrame | None = None
    with reading_files(files):
        for found in rows.collect_batches(chunk_size=_ROWS, maintain_order=True, engine="streaming"):
            if not found.height:
                continue
            require_named(found)
            whole = found.rechunk() if before is None else pl.concat([before, found], rechunk=True)
            # Sums cost a tenth of replacing infinite values in all columns.
            sums = whole.select(pl.sum(*NUMBER_COLUMNS)).row(0, named=True)
            whole = whole.with_columns(finite(name for name, total in sums.items() if not math.isfinite(total)))
            before = whole.tail(_SECOND)
            yield _derived(whole).slice(whole.height - found.height)


def require_named(rows: pl.DataFrame) -> None:
    """Check that all rows have a log, a configuration, a frame number and a stamp.

    Raises:
        TableError: a value is missing, as in tables of other programs.
    """
    named = [name for name in _NAMED if name in rows.columns]
    if any(rows.select(pl.col(named).null_count()).row(0)):
        file = rows.filter(pl.any_horizontal(pl.col(named).is_null()))[FILE][0]
        raise TableError(f"{file}: is not a metrics table of a batch: it has rows without {', '.join(named)}")


def _derived(rows: pl.DataFrame) -> pl.DataFrame:
    """Rows with columns derived from neighbouring rows of the same log and segment; ``SEGMENT`` separates these."""
    marked = rows.with_columns(
        pl.col(SEGMENT).alias(_OWN_SEGMENT),
        _stretches(*LOG, SEGMENT).alias(SEGMENT),
        _stretches(*LOG, SEGMENT, FILE).alias(_STRETCH),
    )
    return marked.with_columns(*derived_columns(), difference(pl.col("stamp_ns")).alias(GAP_NS))


def _stretches(*columns: str) -> pl.Expr:
    """A number for each stretch of rows with equal values."""
    changed = pl.any_horizontal(pl.col(name).ne_missing(pl.col(name).shift()) for name in columns)
    return changed.cum_sum().cast(pl.Int64)


def ledger(batch: pl.DataFrame) -> pl.DataFrame:
    """Counts and sums of each segment of each log in a batch: a row for each stretch of rows of one file."""
    counted = dict.fromkeys([*(quantity.column for quantity in RANKED), *COVERED.values()])
    return batch.group_by(_STRETCH, maintain_order=True).agg(  # five times as fast as grouping by five texts
        pl.first(*LOG, FILE, _OWN_SEGMENT),
        pl.len().cast(pl.Int64).alias(FRAMES),
        pl.min("frame").alias("first"),
        pl.max("frame").alias("last"),
        pl.min("stamp_ns").alias("first ns"),
        pl.max("stamp_ns").alias("last ns"),
        pl.max(GAP_NS),
        *(pl.col(name).count().cast(pl.Int64).alias(valued(name)) for name in counted),
        *(quantity.judged.sum().alias(summed(quantity.column)) for quantity in RANKED),
    )


def logs_of(ledgers: Sequence[pl.DataFrame]) -> pl.DataFrame:
    """A row for each log and configuration, from the ledgers of all batches.

    The columns are ``LOG``, ``DATE``, the ``FILES`` with its rows, its ``FRAMES``, ``SEGMENTS`` and ``SPAN_NS``, and
    the longest ``GAP_NS``. Ranked columns also have the number of frames with a value (``valued``) and the sum of
    the values (``summed``).

    Raises:
        TableError: a frame appears twice, as in a file and in a compacted copy of it.
    """
    rows = pl.concat(ledgers)
    totals = [name for name in rows.columns if name.startswith(("valued ", "summed "))]
    segments = rows.group_by(*LOG, _OWN_SEGMENT, maintain_order=True).agg(
        pl.col(FILE).unique(maintain_order=True).alias(FILES),
        pl.min("first", "first ns"),
        pl.max("last", "last ns", GAP_NS),
        pl.sum(FRAMES, *totals),
    )
    logs = segments.group_by(LOG, maintain_order=True).agg(
        date_of(pl.first(FILES).list.first()).alias(DATE),
        pl.col(FILES).explode().unique(maintain_order=True),
        pl.sum(FRAMES),
        (pl.max("last") - pl.min("first") + 1).alias("numbers"),
        pl.len().cast(pl.Int64).alias(SEGMENTS),
        (pl.col("last ns") - pl.col("first ns")).sum().alias(SPAN_NS),
        pl.max(GAP_NS),
        pl.sum(*totals),
    )
    twice = logs.filter(pl.col(FRAMES) > pl.col("numbers"))
    if twice.height:
        log_id, config, files = twice.select(*LOG, FILES).row(0)
        where = " and ".join(files[:2])
        raise TableError(f"log {log_id}, configuration {config}: has the same frames twice, in {where}; remove one")
    return logs
