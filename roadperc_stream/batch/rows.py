"""The row that says what came of a log, and under which names it has been seen."""

import time
from collections.abc import Mapping
from dataclasses import asdict, fields, replace

from roadperc_stream import __version__
from roadperc_stream.batch.runs import BatchRow
from roadperc_stream.batch.task import BatchJob, DriveFiles, Outcome, code_digest, libraries
from roadperc_stream.log import DIGEST_ALGORITHM
from roadperc_stream.output.tables import config_digest
from roadperc_stream.schemas.columns.runs import RunRow

_COLUMNS = frozenset(item.name for item in fields(RunRow))


def row_of(job: BatchJob, drive: DriveFiles, outcome: Outcome, before: BatchRow | None, attempts: int) -> RunRow:
    """What came of a log; most columns are those of the outcome.

    Args:
        job: what the batch does.
        drive: the log.
        outcome: of its last attempt.
        before: its row so far.
        attempts: how often it was begun.
    """
    how = job.how
    row = RunRow(
        **{name: value for name, value in asdict(outcome).items() if name in _COLUMNS},
        config=how.name,
        path=drive.name,
        names=before.row.names if before else (),
        fingerprints=before.row.fingerprints if before else (),
        size_bytes=drive.size_bytes,
        version=__version__,
        code=code_digest(),
        libraries=libraries(),
        config_digest=config_digest(how.cfg),
        settings=how.settings,
        options=how.options,
        recover=job.recover,
        logs=job.keep_logs,
        digest_algorithm=DIGEST_ALGORITHM,
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
