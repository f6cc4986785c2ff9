"""Opens a batch's dataset in a folder or at an address: its tables as lazy frames, and its list of runs."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import polars as pl

from roadperc_stream.batch.addresses import is_address, local_path
from roadperc_stream.errors import TableError
from roadperc_stream.output.tables import arrow_schema
from roadperc_stream.schemas.columns.runs import RUN_TIME_COLUMNS, RunRow
from roadperc_stream.system.files import METRICS_SUFFIX, TABLE_SUFFIX

from ..runs import first_line, reading

RUNS: Final = f"runs{TABLE_SUFFIX}"
FILE: Final = "table file"
"""Column with the file of a row."""
DATE: Final = "date"
_PARTITION: Final = f"{DATE}="
_HIDDEN: Final = "."
DONE: Final = "done"
NO_TABLES: Final = "no tables in metrics/date=.../; pass the OUT_DIR of roadperc-batch"
RUN_COLUMNS: Final = pl.DataFrame(arrow_schema(RunRow, RUN_TIME_COLUMNS).empty_table()).schema
"""Columns of the list, and polars' type of each."""


@dataclass(frozen=True)
class Dataset:
    """The dataset of a batch; ``address`` is a local path or an object store's address, such as ``s3://bucket/a``.

    ``copy_of`` is the address of the dataset of which it is a temporary copy.
    """

    address: str
    copy_of: str = ""

    @property
    def name(self) -> str:
        """The address that the user named."""
        return self.copy_of or self.address

    @property
    def folder(self) -> Path | None:
        """The local folder; None at an address."""
        return None if is_address(self.address) else Path(self.address)

    def tables(self, *below: str) -> list[str]:
        """The Parquet files that match a path below the dataset; for an address only the pattern."""
        folder = self.folder
        if folder is None:
            return ["/".join((self.address, *below))]
        found = sorted(folder.glob("/".join(below)))
        return [str(path) for path in found if not path.name.startswith(_HIDDEN)]


def dataset_at(argument: str) -> Dataset | None:
    """The dataset that an argument names; None for folders and files of replays.

    Raises:
        StorageError: the argument is the URL of a file on another machine.
    """
    if is_address(argument):
        return Dataset(argument.rstrip("/"))
    path = local_path(argument)
    folder = Path(path)
    if not folder.is_dir() or any(folder.glob(f"*{METRICS_SUFFIX}")):
        return None
    partitioned = any(folder.glob(f"metrics/{_PARTITION}*"))
    return Dataset(path) if partitioned or (folder / RUNS).is_file() else None


def metrics_files(dataset: Dataset) -> list[str]:
    """The files of the metrics tables, or a pattern if the dataset is at an address."""
    return dataset.tables("metrics", f"{_PARTITION}*", f"*{TABLE_SUFFIX}")


def object_files(dataset: Dataset) -> list[str]:
    """The files of the tables of objects."""
    return dataset.tables("objects", f"{_PARTITION}*", f"*{TABLE_SUFFIX}")


def scan_tables(files: Sequence[str], columns: Collection[str] | None = None) -> pl.LazyFrame:
    """All rows of metrics tables with their ``FILE``; columns that a table lacks are null in its rows.

    The columns are those of the first and the last file; they differ if the files come from different versions.
    ``files`` are at least one, for an address a pattern. ``columns`` limits the columns, without ``FILE``: the scan of
    many files is faster than with a later selection.

    Raises:
        TableError: a file cannot be read.
    """
    known: dict[str, pl.DataType] = {}
    for name in dict.fromkeys((files[0], files[-1])):
        with reading(name):
            schema = pl.scan_parquet(name, glob=is_address(name), hive_partitioning=False).collect_schema()
        for column, kind in schema.items():
            known[column] = kind if known.get(column, pl.Null()) == pl.Null() else known[column]
    known.pop(DATE, None)
    known = known if columns is None else {name: kind for name, kind in known.items() if name in columns}
    return pl.scan_parquet(
        list(files),
        glob=is_address(files[0]),
        schema=known,
        hive_partitioning=False,  # otherwise folders above the dataset become columns, too
        hidden_file_prefix=_HIDDEN if is_address(files[0]) else None,
        include_file_paths=FILE if columns is None else None,
        missing_columns="insert",
        extra_columns="ignore",
        use_statistics=columns is None,  # those of all columns cost more than reading a few columns
        cast_options=pl.ScanCastOptions(integer_cast="upcast", float_cast=["upcast", "downcast"]),
    )


def scan_objects(dataset: Dataset, runs: pl.DataFrame) -> pl.LazyFrame | None:
    """All rows of the dataset's tables of objects, None without tables; ``log`` is the name of the log's file.

    Raises:
        TableError: a table cannot be read.
    """
    files = object_files(dataset)
    if not files:
        return None
    known = runs.filter(pl.col("log_id").is_not_null()).unique("log_id", keep="last")
    stem = pl.col("path").str.extract(r"([^/]*?)(?:\.[^./]*)?$")
    return scan_tables(files).join(known.lazy().select("log_id", stem.alias("log")), on="log_id", how="left")


def date_of(file: pl.Expr) -> pl.Expr:
    """The date of a table, from the name of its folder."""
    return file.str.extract(rf"(?:^|[/\\]){_PARTITION}([^/\\]*)[/\\][^/\\]*$")


def read_runs(dataset: Dataset) -> pl.DataFrame:
    """The newest row of each log and configuration, in the order in which they were finished.

    A log that could not be read has a row without ``log_id``; a later row for its path replaces it. The result
    is empty if there is no list.

    Raises:
        TableError: the list cannot be read, or is not a list of runs.
    """
    rows = _run_rows(dataset)
    if rows is None:
        return pl.DataFrame(schema=RUN_COLUMNS)
    rows = rows.sort("finished_ns", maintain_order=True)
    newest = rows.unique([pl.coalesce("log_id", "path"), "config"], keep="last", maintain_order=True)
    return _without_superseded(newest)


def without_file(runs: pl.DataFrame) -> pl.DataFrame:
    """The rows of logs whose files have been replaced by other logs."""
    return runs.filter(pl.col("log_id").is_not_null(), pl.col("names").list.len() == 0)


def _run_rows(dataset: Dataset) -> pl.DataFrame | None:
    """The rows of the list of runs; None without a list."""
    file = f"{dataset.address}/{RUNS}"
    try:
        found = pl.read_parquet(file, hive_partitioning=False, glob=False)
    except FileNotFoundError:
        return None
    except (pl.exceptions.PolarsError, OSError) as error:
        raise TableError(f"{file}: cannot be read as a list of runs: {first_line(error)}") from error
    lacking = [column for column in RUN_COLUMNS if column not in found.columns]
    if lacking:
        raise TableError(f"{file}: is not a list of runs of this version: it has no column {lacking[0]}")
    return found.select(pl.col(column).cast(kind) for column, kind in RUN_COLUMNS.items())


def _without_superseded(rows: pl.DataFrame) -> pl.DataFrame:
    """The rows without those that lack ``log_id`` and whose path appears in a later row with ``log_id``."""
    known = rows.filter(pl.col("log_id").is_not_null()).explode("names")
    later = known.group_by(pl.col("names").alias("path"), "config").agg(pl.max("finished_ns").alias("known_ns"))
    joined = rows.join(later, on=["path", "config"], how="left", maintain_order="left")
    superseded = pl.col("log_id").is_null() & (pl.col("known_ns") > pl.col("finished_ns")).fill_null(value=False)
    return joined.filter(~superseded).drop("known_ns")
