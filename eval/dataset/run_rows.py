"""The list of a batch's runs: a row for each log and configuration, from ``runs.parquet`` and those that go on."""

from typing import Final

import polars as pl

from roadperc_stream.errors import TableError
from roadperc_stream.output.tables import arrow_schema
from roadperc_stream.schemas.columns.runs import RUN_TIME_COLUMNS, RunRow

from .place import RUNS, Dataset, first_line, is_address

DONE: Final = "done"
RUN_COLUMNS: Final = pl.DataFrame(arrow_schema(RunRow, RUN_TIME_COLUMNS).empty_table()).schema
"""Columns of the list, and polars' type of each."""


def read_runs(dataset: Dataset) -> pl.DataFrame:
    """The rows, the newest of each log and configuration, in the order in which they were finished.

    A log that could not be read at first has a row without ``log_id``: this one goes where a later row names its path.
    Columns that the files lack are null. Empty where there is no list yet.

    Raises:
        TableError: a list cannot be read, or is none.
    """
    parts = [part for name in (RUNS, "runs/*.parquet") if (part := _rows(dataset, name)) is not None]
    if not parts:
        return pl.DataFrame(schema=RUN_COLUMNS)
    rows = pl.concat(parts).sort("finished_ns", maintain_order=True)
    newest = rows.unique([pl.coalesce("log_id", "path"), "config"], keep="last", maintain_order=True)
    return _without_superseded(newest)


def without_file(runs: pl.DataFrame) -> pl.DataFrame:
    """The rows of logs that no file holds any more: another log is under their names since."""
    return runs.filter(pl.col("log_id").is_not_null(), pl.col("names").list.len() == 0)


def _rows(dataset: Dataset, name: str) -> pl.DataFrame | None:
    """The rows of a list, or of all that match; None where there is none."""
    files = dataset.tables(name)
    try:
        found = [_typed(file) for file in files]
    except FileNotFoundError:
        return None
    except (pl.exceptions.PolarsError, OSError) as error:
        if is_address(dataset.address) and "*" in name:  # a pattern that matches nothing is an error of some stores
            return None
        where = f"{dataset.address}/{name}"
        raise TableError(f"{where}: is not a list of runs that can be read: {first_line(error)}") from error
    return pl.concat(found) if found else None


def _typed(file: str) -> pl.DataFrame:
    found = pl.read_parquet(file, hive_partitioning=False, glob=is_address(file))
    lacking = [column for column in ("path", "config", "status", "finished_ns") if column not in found.columns]
    if lacking:
        raise TableError(f"{file}: is not a list of runs: it has no column {', '.join(lacking)}")
    return found.select(
        pl.col(column).cast(kind) if column in found.columns else pl.lit(None, kind).alias(column)
        for column, kind in RUN_COLUMNS.items()
    )


def _without_superseded(rows: pl.DataFrame) -> pl.DataFrame:
    """The rows but those without ``log_id`` whose path a row with one names that was finished later."""
    known = rows.filter(pl.col("log_id").is_not_null()).explode("names")
    later = known.group_by(pl.col("names").alias("path"), "config").agg(pl.max("finished_ns").alias("known_ns"))
    joined = rows.join(later, on=["path", "config"], how="left", maintain_order="left")
    superseded = pl.col("log_id").is_null() & (pl.col("known_ns") > pl.col("finished_ns")).fill_null(value=False)
    return joined.filter(~superseded).drop("known_ns")
