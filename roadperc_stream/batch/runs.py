"""The list of all that a dataset's batches have done: ``runs.parquet``, and a part of it for each batch at work.

A batch writes only its own part, again and again, and at its end all that is known to ``runs.parquet``: two at once
do not undo each other, and what one was killed at is not lost. The newest row of a log and configuration counts.
"""

import os
import shutil
import socket
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final

import msgspec

from roadperc_stream.batch.task import SCRATCH
from roadperc_stream.core.files import TABLE_SUFFIX, target_errors
from roadperc_stream.core.time import NS_PER_S
from roadperc_stream.errors import TableError
from roadperc_stream.output.tables import TableWriter, rows_in
from roadperc_stream.schemas.columns.runs import RUN_TIME_COLUMNS, RunRow
from roadperc_stream.state.lock import FolderLock
from roadperc_stream.storage.addresses import joined
from roadperc_stream.storage.folder import Folder
from roadperc_stream.storage.stored import StoredFile

ALL: Final = f"runs{TABLE_SUFFIX}"
PARTS: Final = "runs"
_NAMES: Final = tuple(item.name for item in fields(RunRow))
_REMEDY: Final = "remove it and all is done anew"
_LOCK_WITHIN_S: Final = 10.0
_TRIES: Final = 3
_UNFINISHED: Final = "runs-"
_LEFT_OVER_NS: Final = 24 * 3600 * NS_PER_S


@dataclass(frozen=True)
class BatchRow:
    """A row, and its seconds of each stage by column."""

    row: RunRow
    stages_s: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str]:
        """Two rows with the same one are of the same log and configuration."""
        return self.row.log_id or self.row.path, self.row.config


Rows = dict[tuple[str, str], BatchRow]


def merged(*some: Iterable[BatchRow]) -> Rows:
    """The newest row of each log and configuration.

    A log without a digest is known by its path: once it has one under that path, the row without has no more to say.
    """
    rows: Rows = {}
    for run in sorted((run for runs in some for run in runs), key=lambda run: run.row.finished_ns):
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

    def get(self, log: str, config: str) -> BatchRow | None:
        """The row of a log by its digest, or by its path where it has none."""
        return self._by_key.get((log, config))

    def named(self, name: str) -> list[BatchRow]:
        """The rows of the logs that were last seen under a name, the newest first."""
        runs = (self._by_key[key] for key in self._by_name.get(name, ()))
        return sorted((run for run in runs if name in run.row.names), key=lambda run: -run.row.finished_ns)

    def done_of_size(self, size_bytes: int) -> list[BatchRow]:
        """The rows of logs of a size that were replayed."""
        runs = (self._by_key[key] for key in sorted(self._by_size.get(size_bytes, ())))
        return [run for run in runs if run.row.size_bytes == size_bytes and run.row.status == "done"]


class RunsTable:
    """The rows of a dataset, as one batch reads and writes them."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder
        started = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        self._part = f"{PARTS}/{started}-{socket.gethostname()}-{os.getpid()}{TABLE_SUFFIX}"
        self._own: Rows = {}
        self._seen: tuple[set[StoredFile], StoredFile | None] = (set(), None)

    def read(self) -> Rows:
        """All rows, those of other batches at work included.

        Raises:
            StorageError: the dataset cannot be read.
            TableError: a table in it is not a list of runs.
        """
        self._seen = self._of_others()
        return merged(*self._in_all(self._parts()), self._own.values())

    def _of_others(self) -> tuple[set[StoredFile], StoredFile | None]:
        """The parts of other batches at work, and the one list, to which those that end write."""
        return {file for file in self._parts() if self._folder.name_of(file) != self._part}, self._folder.file(ALL)

    def _parts(self) -> list[StoredFile]:
        return self._folder.files(PARTS, TABLE_SUFFIX)

    def _in_all(self, parts: Iterable[StoredFile]) -> list[list[BatchRow]]:
        """The rows of some parts, and of the one list behind them: of a part that goes meanwhile it has the rows."""
        return list(self._tables([*(self._folder.name_of(file) for file in parts), ALL]))

    def _tables(self, names: Iterable[str]) -> Iterator[list[BatchRow]]:
        for name in names:
            data = self._folder.read(name)
            if data is not None:
                yield _runs_in(data, joined(self._folder.address, name))

    def news(self) -> Rows:
        """The rows of other batches, where any has written since this was last asked; else none.

        Raises:
            StorageError: the dataset cannot be read.
            TableError: a table in it is not a list of runs.
        """
        before, self._seen = self._seen, self._of_others()
        return {} if self._seen == before else merged(*self._in_all(self._seen[0]))

    def add(self, run: BatchRow) -> None:
        """Add a row, or replace the one of the same log and configuration."""
        self._own[run.key] = run

    def save(self) -> None:
        """Write the rows that were added to this batch's part.

        Raises:
            StorageError: the dataset cannot be written.
            TargetError: it is on this machine, and cannot be written.
        """
        if self._own:
            self._write(self._own.values(), self._part)

    def fold(self) -> None:
        """Write all that is known to the one list, and remove the parts that are in it.

        On a disk nobody else does so meanwhile. A store has no locks: what another one wrote at the same moment is
        looked for afterwards.

        Raises:
            StorageError: the dataset cannot be written.
            TargetError: it is on this machine, and cannot be written.
        """
        with self._locked():
            for _ in range(_TRIES):
                parts = self._parts()
                rows = merged(*self._in_all(parts), self._own.values())
                if not rows:
                    return
                self._write(rows.values(), ALL)
                if _has_all(merged(*self._tables([ALL])), rows):
                    break
            for file in parts:
                if self._folder.name_of(file) == self._part or _is_left_over(file):
                    self._folder.remove(self._folder.name_of(file))
            self._remove_unfinished()

    def _remove_unfinished(self) -> None:
        """Remove what batches that were killed had begun to write."""
        if self._folder.is_local:
            for folder in self._folder.path(SCRATCH).glob(f"{_UNFINISHED}*"):
                with suppress(OSError):
                    if time.time_ns() - folder.stat().st_mtime_ns > _LEFT_OVER_NS:
                        shutil.rmtree(folder)

    def fold_left_over(self) -> None:
        """Write all that is known to the one list, where a batch that was killed has left its part.

        Raises:
            StorageError: the dataset cannot be written.
            TargetError: it is on this machine, and cannot be written.
        """
        if self._parts():
            self.fold()

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Hold the list, where it is on a disk: the system takes it from a process that ends, however that ends."""
        if not self._folder.is_local:
            yield
            return
        lock = FolderLock(Path(self._folder.address))
        until = time.monotonic() + _LOCK_WITHIN_S
        while not lock.take() and time.monotonic() < until:
            time.sleep(0.05)
        try:
            yield
        finally:
            lock.release()

    def _write(self, runs: Iterable[BatchRow], name: str) -> None:
        scratch = self._folder.path(SCRATCH) if self._folder.is_local else None  # the system's may be full
        if scratch is not None:
            with target_errors(scratch):
                scratch.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=_UNFINISHED, dir=scratch) as folder:
            path = Path(folder) / "runs.parquet"
            with TableWriter(path, RunRow, {}, RUN_TIME_COLUMNS) as table:
                for run in sorted(runs, key=lambda run: (run.row.path, run.row.config)):
                    table.append(run.row, **run.stages_s)
            self._folder.put(path, name)


def _has_all(written: Rows, rows: Rows) -> bool:
    """Whether a list has rows, or newer ones of the same logs."""
    return all(key in written and written[key].row.finished_ns >= run.row.finished_ns for key, run in rows.items())


def _is_left_over(part: StoredFile) -> bool:
    """Whether no batch can still be writing a part: one at work writes what it has done within seconds."""
    modified_ns = part.fingerprint.rpartition(":")[2]
    return modified_ns.isdecimal() and time.time_ns() - int(modified_ns) > _LEFT_OVER_NS


def _runs_in(data: bytes, address: str) -> list[BatchRow]:
    try:
        rows = rows_in(data, address)
    except TableError as error:
        raise TableError(f"{address}: is not a list of runs that can be read; {_REMEDY}") from error
    return [_run_of(row, address) for row in rows]


def _run_of(row: Mapping[str, Any], address: str) -> BatchRow:
    missing = [name for name in _NAMES if name not in row]
    if missing:
        raise TableError(f"{address}: has no column {missing[0]}; another version of this program wrote it")
    stages_s = {name: row[name] for name in RUN_TIME_COLUMNS if row.get(name) is not None}
    try:
        values = msgspec.convert({name: row[name] for name in _NAMES}, RunRow)
    except msgspec.ValidationError as error:
        raise TableError(f"{address}: is not a list of runs of this program: {error}; {_REMEDY}") from error
    if len(values.names) != len(values.fingerprints):
        raise TableError(f"{address}: is not a list of runs of this program: names without fingerprints; {_REMEDY}")
    return BatchRow(values, stages_s)
