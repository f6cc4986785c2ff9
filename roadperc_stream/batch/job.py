"""What a batch does with each of its logs, and the row that says what came of one."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from roadperc_stream import __version__
from roadperc_stream.batch.runs import BatchRow
from roadperc_stream.batch.storage.place import Place
from roadperc_stream.batch.task import (
    NO_TIMEOUT,
    BatchConfiguration,
    DriveFiles,
    KeepLogs,
    Outcome,
    Task,
    TaskLimits,
    code_digest,
    libraries,
)
from roadperc_stream.log import DIGEST_ALGORITHM
from roadperc_stream.output.tables import config_digest
from roadperc_stream.schemas.columns.runs import RunRow


@dataclass(frozen=True)
class BatchJob:
    """What a batch does with each of its logs.

    Args:
        how: the configuration.
        out: the dataset.
        keep_logs: the result log to keep.
        recover: replay what can be read of damaged logs.
        limits: of each attempt.
        retries: how often a log is tried again whose worker died.
        fail_fast: stop at the first log that fails.
        scratch: folder for temporary files on the workers' machines; None: within the dataset, or the system's.
    """

    how: BatchConfiguration
    out: Place
    keep_logs: KeepLogs = "no"
    recover: bool = False
    limits: TaskLimits = NO_TIMEOUT
    retries: int = 2
    fail_fast: bool = False
    scratch: Path | None = None

    def task(self, drive: DriveFiles, same_ids: tuple[str, ...] = ()) -> Task:
        """The task of a whole log."""
        return Task(
            drive, self.how, self.out, self.keep_logs, self.recover, self.limits, same_ids, code_digest(), self.scratch
        )

    def row(self, drive: DriveFiles, outcome: Outcome, before: BatchRow | None, attempts: int) -> RunRow:
        """What came of a log.

        Args:
            drive: the log.
            outcome: of its last attempt.
            before: its row so far.
            attempts: how often it was begun.
        """
        how = self.how
        row = RunRow(
            log_id=outcome.log_id,
            config=how.name,
            status=outcome.status,
            error=outcome.error,
            path=drive.name,
            names=before.row.names if before else (),
            fingerprints=before.row.fingerprints if before else (),
            date=outcome.date,
            duration_s=outcome.duration_s,
            size_bytes=drive.size_bytes,
            frames=outcome.frames,
            dropped=outcome.dropped,
            unreadable=outcome.unreadable,
            warnings=outcome.warnings,
            seconds=outcome.seconds,
            peak_memory_mb=outcome.peak_memory_mb,
            version=__version__,
            code=code_digest(),
            libraries=libraries(),
            config_digest=config_digest(how.cfg),
            settings=how.settings,
            options=how.options,
            recover=self.recover,
            logs=self.keep_logs,
            digest_algorithm=DIGEST_ALGORITHM,
            worker=outcome.worker,
            attempts=attempts,
            finished_ns=before.row.finished_ns if before else 0,
        )
        return also_named(row, drive)


def also_named(row: RunRow, drive: DriveFiles) -> RunRow:
    """The row of a log that has been seen under this name."""
    seen = dict(zip(row.names, row.fingerprints, strict=True)) | {drive.name: drive.fingerprint}
    return _with_names(row, seen)


def not_named(row: RunRow, name: str) -> RunRow:
    """The row of a log that is under this name no more."""
    seen = {n: print_ for n, print_ in zip(row.names, row.fingerprints, strict=True) if n != name}
    return _with_names(row, seen)


def _with_names(row: RunRow, seen: Mapping[str, str]) -> RunRow:
    """The row with the fingerprints of a log's files by their names, newer than it was; its path is one of those."""
    path = row.path if row.path in seen or not seen else next(iter(seen))
    finished_ns = max(time.time_ns(), row.finished_ns + 1)
    return replace(row, path=path, names=tuple(seen), fingerprints=tuple(seen.values()), finished_ns=finished_ns)
