"""Writes rows of dataclasses to Parquet files by row groups, and reads tables."""

import hashlib
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from roadperc_stream import __version__
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import TableError
from roadperc_stream.geometry import Float
from roadperc_stream.model.reason import Reason
from roadperc_stream.schemas.columns import cells
from roadperc_stream.schemas.columns.places import TrueObject, TrueObjectListColumns
from roadperc_stream.schemas.record import NETWORKS_COMMENT
from roadperc_stream.system.files import TABLE_SUFFIX, partial_of, remove_stale_partials, target_errors

ROW_GROUP_ROWS: Final = 5000
_OBJECT_ROWS: Final = 1000
"""Rows after which Python's objects become an Arrow table, which needs a tenth of their memory."""
FACT_PREFIX: Final = "roadperc."
"""Prefix of this project's keys in the footer of a table."""
_ARROW_TYPES: Final[Mapping[Any, pa.DataType]] = {
    str: pa.string(),
    float: pa.float64(),
    int: pa.int64(),
    bool: pa.bool_(),
    tuple[str, ...]: pa.list_(pa.string()),
    tuple[float, ...]: pa.list_(pa.float64()),
    tuple[Reason, ...]: pa.list_(
        pa.struct(
            [("source", pa.string()), ("code", pa.string()), ("values", pa.list_(pa.string())), ("cause", pa.string())]
        )
    ),
    tuple[TrueObject, ...]: pa.list_(
        pa.struct(
            [
                *((name, pa.string()) for name in ("id", "label")),
                *((name, pa.float64()) for name in ("x_m", "y_m", "closing_speed_mps", "time_to_impact_s")),
                *((name, pa.bool_()) for name in ("in_path", "detected")),
            ]
        )
    ),
}
_LISTED: Final = typing.get_type_hints(TrueObjectListColumns)
"""The types of the extra columns that are no floats."""
Scalar = bool | int | float | str


def sidecar_path(target: Path, table: str) -> Path:
    """The table beside a log, as out.metrics.parquet or out.objects.parquet beside out.mcap."""
    return target.with_name(f"{target.stem}.{table}{TABLE_SUFFIX}")


def table_facts(
    source: Path,
    target: Path,
    cfg: ReplayConfig,
    more: Mapping[str, str] | None = None,
    networks: str = "",
) -> dict[str, str]:
    """The origin of a table, for its footer.

    ``roadperc.log`` is the log beside it, ``roadperc.source`` the input, ``roadperc.config`` the configuration.

    Args:
        source: the input.
        target: the log beside the table.
        cfg: the configuration.
        more: other facts.
        networks: digest of the networks of the input.
    """
    facts = {
        "config": config_text(cfg, networks),
        "config_digest": config_digest(cfg, networks),
        "version": __version__,
        "log": str(target.absolute()),
        "source": str(source.absolute()),
        **(more or {}),
    }
    return {f"{FACT_PREFIX}{key}": value for key, value in facts.items()}


def config_digest(cfg: ReplayConfig, networks: str = "") -> str:
    """SHA-256 of the text of a configuration."""
    return hashlib.sha256(config_text(cfg, networks).encode()).hexdigest()


def config_text(cfg: ReplayConfig, networks: str) -> str:
    """A configuration with its defaults as TOML; a comment has the digest of the networks of the input, if any."""
    return cfg.to_toml() + (f"{NETWORKS_COMMENT}{networks}\n" if networks else "")


def facts_in(metadata: Mapping[bytes, bytes] | None) -> dict[str, str]:
    """The facts in a footer, by name without the prefix."""
    named = {key.decode(errors="replace"): value for key, value in (metadata or {}).items()}
    return {
        key.removeprefix(FACT_PREFIX): value.decode("utf-8", "surrogateescape")
        for key, value in named.items()
        if key.startswith(FACT_PREFIX)
    }


def arrow_schema(
    row_type: type,
    extra: tuple[str, ...] = (),
    metadata: Mapping[str, str] | None = None,
    constant: Mapping[str, Scalar] | None = None,
) -> pa.Schema:
    """Arrow schema of a dataclass, ``X | None`` nullable, then ``extra`` and constant columns."""
    hints = typing.get_type_hints(row_type)
    columns = [_field(f.name, hints[f.name]) for f in fields(row_type)]
    columns += [_field(name, _LISTED.get(name, float | None)) for name in extra]
    columns += [_field(name, type(value)) for name, value in (constant or {}).items()]
    return pa.schema(columns, metadata=_encoded(metadata or {}))


def _encoded(metadata: Mapping[str, str]) -> dict[bytes, bytes]:
    return {key.encode(): value.encode("utf-8", "surrogateescape") for key, value in metadata.items()}


def _field(name: str, hint: Any) -> pa.Field:
    options = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    (kind,) = (option for option in options if option is not types.NoneType)
    return pa.field(name, _ARROW_TYPES[kind], nullable=types.NoneType in options)


@dataclass(frozen=True)
class TableFooter:
    """The facts of a table that need no reading of its rows."""

    rows: int
    facts: Mapping[str, str]


def read_footer(path: Path) -> TableFooter:
    """Read the footer of a table.

    Raises:
        TableError: the file is unreadable or not Parquet.
    """
    with _opened(path) as table:
        return TableFooter(table.metadata.num_rows, facts_in(table.metadata.metadata))


def read_rows_around(path: Path, frame: int, columns: Iterable[str]) -> list[dict[str, Any]]:
    """Read columns of the one row group that contains a frame.

    Returns:
        The rows; empty if no group contains the frame.

    Raises:
        TableError: the file cannot be read, is not Parquet, or lacks a column.
    """
    wanted = ["frame", *columns]
    with _opened(path) as table:
        for column in wanted:
            if column not in table.schema_arrow.names:
                raise TableError(f"{path}: no column {column}")
        frames = table.schema_arrow.names.index("frame")
        spans = [table.metadata.row_group(i).column(frames).statistics for i in range(table.num_row_groups)]
        group = next((i for i, span in enumerate(spans) if span and span.min <= frame <= span.max), None)
        return [] if group is None else table.read_row_group(group, wanted).to_pylist()


@dataclass(frozen=True)
class TableTotals:
    """Number of rows of a table, sums of its columns without nulls, and the sum of its segments' time spans."""

    rows: int
    sums: Mapping[str, float]
    span_ns: int


def totals(path: Path, columns: Iterable[str]) -> TableTotals:
    """Compute the totals of a table of frames.

    Raises:
        TableError: the file cannot be read, is not Parquet, or lacks a column.
    """
    import pyarrow.compute as pc  # its import takes 40 ms

    with _opened(path) as table:
        rows = table.read(["segment", "stamp_ns", *columns])
        segments = rows.group_by("segment").aggregate([("stamp_ns", "min"), ("stamp_ns", "max")])
        spans_ns = pc.subtract(segments["stamp_ns_max"], segments["stamp_ns_min"])
        sums = {name: pc.sum(rows[name]).as_py() for name in columns}
    known = {name: total for name, total in sums.items() if total is not None}
    return TableTotals(len(rows), known, pc.sum(spans_ns).as_py() or 0)


def copy_table(source: Path, target: Path, facts: Mapping[str, str], constant: Mapping[str, Scalar]) -> None:
    """Copy a table with its row groups, added constant columns and replaced facts.

    Raises:
        TableError: the table cannot be read.
        TargetError: the copy cannot be written.
    """
    with _opened(source) as table:
        old = table.schema_arrow
        known = facts_in(table.metadata.metadata) | dict(facts)
        more = _encoded({f"{FACT_PREFIX}{key}": value for key, value in known.items()})
        columns = [*old, *(_field(name, type(value)) for name, value in constant.items())]
        schema = pa.schema(columns, (old.metadata or {}) | more)
        with target_errors(target), parquet_writer(target, schema) as copy:
            for group in range(table.num_row_groups):
                rows = table.read_row_group(group)
                columns = [pa.repeat(pa.scalar(value), len(rows)) for value in constant.values()]
                copy.write_table(pa.Table.from_arrays([*rows.columns, *columns], schema=schema))


def rows_in(data: bytes, address: str) -> list[dict[str, Any]]:
    """The rows of a table that was downloaded from an address.

    Raises:
        TableError: the bytes are not Parquet.
    """
    with _opened(address, pa.BufferReader(data)) as table:
        # An Arrow thread that releases Python's bytes while the interpreter ends aborts the process.
        rows: list[dict[str, Any]] = table.read(use_threads=False).to_pylist()
    return rows


@contextmanager
def _opened(path: Path | str, data: pa.BufferReader | None = None) -> Iterator[pq.ParquetFile]:
    """Open a table; its bytes are ``data`` if given, else those of the file."""
    try:
        with pq.ParquetFile(path if data is None else data) as table:
            yield table
    except OSError as error:
        raise TableError(f"{path}: {error.strerror or error}") from error
    except (pa.ArrowException, KeyError) as error:
        raise TableError(f"{path}: not a table of a replay, or truncated") from error


def _numpy(column: pa.ChunkedArray) -> NDArray[Any]:
    if column.type == pa.string():  # Arrow's fill_null would need its compute module, which takes 40 ms
        return np.array([text or "" for text in column.to_pylist()], str)
    values: NDArray[Any] = column.to_numpy()
    return values


def parquet_writer(path: Path, schema: pa.Schema) -> pq.ParquetWriter:
    """A writer of a table. Floats are mostly distinct; a dictionary of them would take space and time."""
    others = [field.name for field in schema if not pa.types.is_floating(field.type)]
    return pq.ParquetWriter(path, schema, compression="zstd", use_dictionary=others)


class TableWriter:
    """Writes rows to a Parquet file, which gets its name only when complete. Use it as a context manager.

    ``extra`` are names of columns that each row brings, ``constant`` columns with one value in all rows.
    """

    def __init__(
        self,
        path: Path,
        row_type: type,
        facts: Mapping[str, str],
        extra: tuple[str, ...] = (),
        constant: Mapping[str, Scalar] | None = None,
    ) -> None:
        self._path = path
        self._temporary, self._before = partial_of(path), partial_of(path, ".rows")
        self._constant = dict(constant or {})
        self._schema = arrow_schema(row_type, extra, facts, self._constant)
        self._rows: list[dict[str, Any]] = []
        self._tables: list[pa.Table] = []

    def __enter__(self) -> Self:
        with target_errors(self._path):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            remove_stale_partials(self._path)
            self._writer = parquet_writer(self._temporary, self._schema)
        return self

    def append(self, row: Any, **extra: Any) -> None:
        """Add a row: a dataclass, and values of the extra columns.

        Raises:
            TargetError: the row cannot be written, as on a full disk.
        """
        self._rows.append(cells(row) | extra | self._constant)
        if len(self._rows) >= _OBJECT_ROWS:
            self._flush(ROW_GROUP_ROWS)

    def _flush(self, least: int = 1) -> None:
        """Convert the rows to a table; write all tables if they have at least so many rows."""
        self._tables.append(pa.Table.from_pylist(self._rows, schema=self._schema))
        self._rows.clear()
        rows = pa.concat_tables(self._tables)
        if len(rows) >= least:
            with target_errors(self._path):
                self._writer.write_table(rows)
            self._tables.clear()

    def add_facts(self, facts: Mapping[str, str]) -> None:
        """Add entries to the footer, known only after the last row."""
        self._writer.add_key_value_metadata(_encoded({f"{FACT_PREFIX}{key}": value for key, value in facts.items()}))

    def columns(self, names: list[str], earlier: Iterable[Any] = ()) -> dict[str, NDArray[Any]]:
        """Columns of all rows, after those of ``earlier`` rows of the same type; only ``fill`` may follow.

        Unknown numbers are NaN, unknown texts empty.

        Raises:
            TargetError: the file cannot be written.
        """
        self._flush()
        with target_errors(self._path):
            self._writer.close()
            with pq.ParquetFile(self._temporary) as written:  # read_table would import more of Arrow
                groups = [written.read_row_group(k, names, use_threads=False) for k in range(written.num_row_groups)]
        schema = pa.schema([self._schema.field(name) for name in names])
        before = pa.Table.from_pylist([{name: cells(row)[name] for name in names} for row in earlier], schema)
        joined = pa.concat_tables([before, *(group.select(names) for group in groups)])
        return {name: _numpy(joined[name]) for name in names}

    def fill(self, columns: Mapping[str, Float]) -> None:
        """Give float columns their values, known only after the last row: (N,), NaN becomes null.

        Raises:
            TargetError: the file cannot be written.
        """
        begin = 0
        with target_errors(self._path), pq.ParquetFile(self._temporary.replace(self._before)) as table:
            self._writer = parquet_writer(self._temporary, self._schema)
            for number in range(table.num_row_groups):
                group = table.read_row_group(number, use_threads=False)
                for name, values in columns.items():
                    part = pa.array(values[begin : begin + len(group)], from_pandas=True)
                    group = group.set_column(group.schema.get_field_index(name), self._schema.field(name), part)
                self._writer.write_table(group)
                begin += len(group)
            self._before.unlink()

    def complete(self) -> None:
        """Write the remaining rows and the footer; only the rename is left.

        Raises:
            TargetError: the file cannot be written.
        """
        self._flush()
        with target_errors(self._path):
            self._writer.close()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.complete()
                with target_errors(self._path):
                    self._temporary.replace(self._path)
        finally:
            with suppress(OSError):  # closing writes the footer, and a full disk fails again
                self._writer.close()
            self.discard()

    def discard(self) -> None:
        """Remove the partial file; errors are ignored, since an unwritable folder has no partial file."""
        with suppress(OSError):
            self._temporary.unlink(missing_ok=True)
            self._before.unlink(missing_ok=True)
