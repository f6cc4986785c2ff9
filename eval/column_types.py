"""Whether a table's columns hold what columns of their names hold: kinds of values, numbers one can compute with."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import polars as pl
import pyarrow as pa
import pyarrow.types as kinds

from roadperc_stream.errors import TableError
from roadperc_stream.output.tables import arrow_schema
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics

from .collecting import collect

_COMPLETE: Final = ("log_id", "stamp_ns", "total_ms")
"""Columns with a value in every row."""
_WHOLE: Final = ("frame", "stamp_ns")
"""Columns that rows are found by."""
_LARGEST: Final[Mapping[str, float]] = {"int64": 2.0**63 - 1024, "double": 1e100}
"""By the type a column has; squares of the largest number, and sums of these, are numbers still."""


def require_columns_as_written(path: Path, found: pa.Schema) -> None:
    """Check the columns that a replay writes: their types, their largest numbers, and that rows have their values.

    The numbers are those of the rows. The footer has the least and the largest too, but of a damaged footer pyarrow
    cannot always give them: parquet's own exception then ends the process.

    Raises:
        TableError: a column is of another type, lacks values, or holds a number that nobody can compute with; or the
            data cannot be read.
    """
    present = [expected for expected in arrow_schema(FrameMetrics, TIME_COLUMNS) if expected.name in found.names]
    for expected in present:
        if found.names.count(expected.name) > 1:
            raise TableError(f"{path}: several columns are called {expected.name}")
        kind = found.field(expected.name).type
        if not _fits(expected, kind):
            raise TableError(f"{path}: column {expected.name} is of type {kind}, expected {expected.type}")
    largest = {field.name: _LARGEST[str(field.type)] for field in present if str(field.type) in _LARGEST}
    numbers = {name: limit for name, limit in largest.items() if not kinds.is_null(found.field(name).type)}
    _require_values(path, numbers)


def _require_values(path: Path, largest: Mapping[str, float]) -> None:
    """Check that no row lacks what each has, and that the finite numbers of columns are within their limits."""
    finite = {name: pl.col(name).filter(pl.col(name).is_finite()) for name in largest}
    values = collect(
        pl.scan_parquet(path, glob=False).select(
            *(pl.col(name).null_count().alias(f"{name} without") for name in _COMPLETE),
            *(column.min().alias(f"{name} least") for name, column in finite.items()),
            *(column.max().alias(f"{name} most") for name, column in finite.items()),
        ),
        str(path),
    ).row(0, named=True)
    for name in _COMPLETE:
        if values[f"{name} without"]:
            raise TableError(f"{path}: is not a metrics table: its column {name} has rows without a value")
    for name, limit in largest.items():
        for value in (values[f"{name} least"], values[f"{name} most"]):
            if value is not None and abs(value) > limit:
                raise TableError(f"{path}: column {name} holds {value:g}, expected {limit:g} at most")


def _fits(expected: pa.Field, kind: pa.DataType) -> bool:
    """Whether values of a kind can stand for those expected; a column without values may have none."""
    if kinds.is_null(kind):
        return bool(expected.nullable)
    if kinds.is_list(expected.type):
        listed = kinds.is_list(kind) or kinds.is_large_list(kind)
        return listed and (kinds.is_null(kind.value_type) or _is_text(kind.value_type))
    number: Callable[[Any], bool] = kinds.is_integer if expected.name in _WHOLE else _is_number
    checks: dict[str, Callable[[Any], bool]] = {"string": _is_text, "bool": kinds.is_boolean}
    return checks.get(str(expected.type), number)(kind)


def _is_text(kind: pa.DataType) -> bool:
    plain = kind.value_type if kinds.is_dictionary(kind) else kind
    return any(check(plain) for check in (kinds.is_string, kinds.is_large_string, kinds.is_string_view))


def _is_number(kind: pa.DataType) -> bool:
    return bool(kinds.is_integer(kind) or kinds.is_floating(kind))
