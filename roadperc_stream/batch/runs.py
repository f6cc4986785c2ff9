"""The list of runs of a dataset, ``runs.parquet``, which a batch saves from time to time."""

import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final

import msgspec

from roadperc_stream.batch.location import Location
from roadperc_stream.batch.task import SCRATCH
from roadperc_stream.errors import TableError
from roadperc_stream.output.tables import TableWriter, rows_in
from roadperc_stream.schemas.columns.runs import RUN_TIME_COLUMNS, RunRow
from roadperc_stream.system.files import TABLE_SUFFIX, target_errors

ALL: Final = f"runs{TABLE_SUFFIX}"
_REMEDY: Final = "remove it to replay all logs again"


@dataclass(frozen=True)
class BatchRow:
    """A row, and the seconds of each stage by column."""

    row: RunRow
    stages_s: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str]:
        """The log and the configuration."""
        return self.row.log_id or self.row.path, self.row.config


Rows = dict[tuple[str, str], BatchRow]


def merged(runs: Iterable[BatchRow]) -> Rows:
    """The newest row of each log and configuration.

    A log without a digest is known by its path. A newer row with a digest under that path replaces it.
    """
    rows: Rows = {}
    for run in sorted(runs, key=lambda run: run.row.finished_ns):
        rows[run.key] = run
    known = {
        (name, run.row.config): run.row.finished_ns for run in rows.values() for name in run.row.names if run.row.log_id
    }
    return {
        key: run
        for key, run in rows.items()
        if run.row.log_id or known.get((run.row.path, run.row.config), -1) < run.row.finished_ns
    }


class KnownRuns:
    """The rows of one configuration, found by name and by size."""

    def __init__(self, runs: Iterable[BatchRow], config: str) -> None:
        self._config = config
        self._by_key: Rows = {}
        self._by_name: dict[str, set[tuple[str, str]]] = {}
        self._by_size: dict[int, set[tuple[str, str]]] = {}
        for run in runs:
            if run.row.config == config:
                self.add(run)

    def add(self, run: BatchRow) -> None:
        """Add a row, or replace the one of the same log."""
        self._by_key[run.key] = run
        self._by_size.setdefault(run.row.size_bytes, set()).add(run.key)
        for name in run.row.names:
            self._by_name.setdefault(name, set()).add(run.key)

    def get(self, log: str) -> BatchRow | None:
        """The row of a log by its digest, or by its path if it has no digest."""
        return self._by_key.get((log, self._config))

    def named(self, name: str) -> list[BatchRow]:
        """The rows of the logs with this name, the newest first."""
        runs = (self._by_key[key] for key in self._by_name.get(name, ()))
        return sorted((run for run in runs if name in run.row.names), key=lambda run: -run.row.finished_ns)

    def done_of_size(self, size_bytes: int) -> list[BatchRow]:
        """The rows of replayed logs of a size."""
        runs = (self._by_key[key] for key in sorted(self._by_size.get(size_bytes, ())))
        return [run for run in runs if run.row.size_bytes == size_bytes and run.row.status == "done"]


class RunsTable:
    """The rows of a dataset; only the batch with the dataset's lock writes them."""

    def __init__(self, folder: Location) -> None:
        self._file, self._scratch = folder.at(ALL), Path(folder.address, SCRATCH) if folder.is_local else None
        self._rows: Rows = {}
        self._is_saved = True

    def read(self) -> Iterable[BatchRow]:
        """All rows.

        Raises:
            StorageError: the dataset cannot be read.
            TableError: its table is not a list of runs.
        """
        data = self._file.read()
        self._rows = merged(_runs_in(data, self._file.address) if data is not None else ())
        return self._rows.values()

    def add(self, run: BatchRow) -> None:
        """Add a row, or replace the one of the same log and configuration."""
        self._rows[run.key] = run
        self._is_saved = False

    def save(self) -> None:
        """Write all rows if one was added.

        Raises:
            StorageError: the store cannot be written.
            TargetError: the local dataset cannot be written.
        """
        if self._is_saved:
            return
        if self._scratch is not None:  # the system's folder may be full
            with target_errors(self._scratch):
                self._scratch.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="runs-", dir=self._scratch) as folder:
            path = Path(folder) / ALL
            with TableWriter(path, RunRow, {}, RUN_TIME_COLUMNS) as table:
                rows = merged(self._rows.values()).values()
                for run in sorted(rows, key=lambda run: (run.row.path, run.row.config)):
                    table.append(run.row, **run.stages_s)
            self._file.put(path)
        self._is_saved = True


def _runs_in(data: bytes, address: str) -> list[BatchRow]:
    try:
        rows = rows_in(data, address)
    except TableError as error:
        raise TableError(f"{address}: not a readable list of runs; {_REMEDY}") from error
    return [_run_of(row, address) for row in rows]


def _run_of(row: Mapping[str, Any], address: str) -> BatchRow:
    missing = [column.name for column in fields(RunRow) if column.name not in row]
    if missing:
        raise TableError(f"{address}: has no column {missing[0]}; another version of this program wrote it")
    stages_s = {name: row[name] for name in RUN_TIME_COLUMNS if row.get(name) is not None}
    try:
        values = msgspec.convert(row, RunRow)
    except msgspec.ValidationError as error:
        raise TableError(f"{address}: not a list of runs of this program: {error}; {_REMEDY}") from error
    if len(values.names) != len(values.fingerprints):
        raise TableError(f"{address}: not a list of runs of this program: names without fingerprints; {_REMEDY}")
    return BatchRow(values, stages_s)
