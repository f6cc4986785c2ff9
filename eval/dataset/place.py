"""Where a batch's dataset is, and its tables as lazy frames of polars; an address is read as a folder is."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import polars as pl

from roadperc_stream.core.files import METRICS_SUFFIX, TABLE_SUFFIX
from roadperc_stream.errors import TableError

RUNS: Final = f"runs{TABLE_SUFFIX}"
FILE: Final = "table file"
"""Column of the file that a row stands in."""
DATE: Final = "date"
_PARTITION: Final = f"{DATE}="
_HIDDEN: Final = "."


@dataclass(frozen=True)
class Dataset:
    """The folder of a batch, ``address``: a local path, or what an object store calls it, such as ``s3://bucket/a``."""

    address: str

    @property
    def folder(self) -> Path | None:
        """The local folder; None at an address."""
        return None if is_address(self.address) else Path(self.address)

    def tables(self, *below: str) -> list[str]:
        """The Parquet files whose path below the dataset matches: files, or a pattern where the place is an address."""
        folder = self.folder
        if folder is None:
            return ["/".join((self.address, *below))]
        found = sorted(folder.glob("/".join(below)))
        return [str(path) for path in found if not path.name.startswith(_HIDDEN)]


def is_address(argument: str) -> bool:
    """Whether an argument is an address rather than a path."""
    return "://" in argument


def dataset_at(argument: str) -> Dataset | None:
    """The dataset that an argument names; None for folders and files of replays."""
    if is_address(argument):
        return Dataset(argument.rstrip("/"))
    folder = Path(argument)
    if not folder.is_dir() or any(folder.glob(f"*{METRICS_SUFFIX}")):
        return None
    partitioned = any(folder.glob(f"metrics/{_PARTITION}*"))
    return Dataset(argument) if partitioned or (folder / RUNS).is_file() else None


def metrics_files(dataset: Dataset) -> list[str]:
    """The files of the metrics tables, a pattern where the place is an address; none where there are none."""
    return dataset.tables("metrics", f"{_PARTITION}*", f"*{TABLE_SUFFIX}")


def scan_tables(files: Sequence[str]) -> pl.LazyFrame:
    """All rows of metrics tables with their ``FILE``; columns that a table lacks are null in its rows.

    The columns are those of all versions that are among the files' first and last, which differ where versions do.

    Args:
        files: one at least; at an address a pattern.

    Raises:
        TableError: a file cannot be read.
    """
    known: dict[str, pl.DataType] = {}
    for name in dict.fromkeys((files[0], files[-1])):
        for column, kind in _schema(name).items():
            known[column] = kind if known.get(column, pl.Null()) == pl.Null() else known[column]
    known.pop(DATE, None)
    return pl.scan_parquet(
        list(files),
        glob=is_address(files[0]),
        schema=known,
        hive_partitioning=False,  # it would take every folder above as a column, too
        hidden_file_prefix=_HIDDEN if is_address(files[0]) else None,
        include_file_paths=FILE,
        missing_columns="insert",
        extra_columns="ignore",
        cast_options=pl.ScanCastOptions(integer_cast="upcast", float_cast=["upcast", "downcast"]),
    )


def date_of(file: pl.Expr) -> pl.Expr:
    """The date of a table, which its folder names."""
    return file.str.extract(rf"(?:^|[/\\]){_PARTITION}([^/\\]*)[/\\][^/\\]*$")


def _schema(name: str) -> pl.Schema:
    try:
        lazy = pl.scan_parquet(name, glob=is_address(name), hive_partitioning=False)
        return lazy.collect_schema()
    except (pl.exceptions.PolarsError, OSError) as error:
        raise TableError(f"{name}: is not a table that can be read: {first_line(error)}") from error


def first_line(error: BaseException) -> str:
    """What an error of a library says, without its particulars."""
    if "expanded paths were empty" in str(error):
        return "no file has such a name"
    return (str(error).splitlines() or [type(error).__name__])[0].rstrip(". ")
