"""Whether a table's columns hold what columns of their names hold: kinds of values, numbers one can compute with."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq
import pyarrow.types as kinds

from roadperc_stream.errors import TableError
from roadperc_stream.output.tables import arrow_schema
from roadperc_stream.schemas.columns import TIME_COLUMNS, FrameMetrics

_WHOLE: Final = ("frame", "stamp_ns")
"""Columns that rows are found by."""
_LARGEST: Final[Mapping[str, float]] = {"int64": 2.0**63 - 1024, "double": 1e100}
"""By the type a column has; squares of the largest number, and sums of these, are numbers still."""


def require_columns_as_written(path: Path, footer: pq.FileMetaData) -> None:
    """Check the columns that a replay writes, by their types and by the least and the largest value in the footer.

    Raises:
        TableError: a column is of another type, or holds a number that nobody can compute with.
    """
    found = footer.schema.to_arrow_schema()
    for expected in arrow_schema(FrameMetrics, TIME_COLUMNS):
        if found.names.count(expected.name) > 1:
            raise TableError(f"{path}: several columns are called {expected.name}")
        if expected.name in found.names:
            kind = found.field(expected.name).type
            if not _fits(expected, kind):
                raise TableError(f"{path}: column {expected.name} is of type {kind}, expected {expected.type}")
            if str(expected.type) in _LARGEST:
                _require_numbers(path, footer, expected.name, _LARGEST[str(expected.type)])


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


def _require_numbers(path: Path, footer: pq.FileMetaData, name: str, largest: float) -> None:
    places = {footer.schema.column(k).path: k for k in range(footer.num_columns)}
    for k in range(footer.num_row_groups):
        part = footer.row_group(k).column(places[name]).statistics if name in places else None
        if part is None or not part.has_min_max:
            continue
        for value in (part.min, part.max):
            if isinstance(value, int | float) and largest < abs(value) < float("inf"):
                raise TableError(f"{path}: column {name} holds {value:g}, expected {largest:g} at most")
