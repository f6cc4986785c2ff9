"""Finds the logs of a command line and decides what a batch does with each, and why."""

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

from roadperc_stream import __version__
from roadperc_stream.batch.runs import BatchRow, KnownRuns
from roadperc_stream.batch.storage.addresses import is_address, natural
from roadperc_stream.batch.storage.location import Location, StoredFile, find_files
from roadperc_stream.batch.task import LOGS, METRICS, OBJECTS, BatchJob, DriveFiles, code_digest, name_in
from roadperc_stream.errors import StorageError
from roadperc_stream.schemas.columns.runs import OF_THE_MACHINE, STATUSES
from roadperc_stream.system.files import TABLE_SUFFIX


def find_drives_in(arguments: Sequence[str], out: Location, parts: re.Pattern[str] | None) -> list[DriveFiles]:
    """The logs that the arguments mean, each once, in their order.

    Args:
        arguments: files, folders, globs, addresses, and ``@list.txt`` with one of those in each line.
        out: the dataset, whose own result logs are not input.
        parts: what in a file's name tells the parts of one drive apart; None: every file is a log.

    Raises:
        StorageError: one names no log, or a list cannot be read.
    """
    found = {file.address: file for argument in _said(arguments) for file in find_files(argument)}
    files = [file for file in found.values() if not _is_in(file, out)]
    if not files:
        reason = "no log but those of the dataset itself" if found else "names no log"
        raise StorageError(f"{' '.join(arguments)}: {reason}")
    return [DriveFiles((file,)) for file in files] if parts is None else joined(files, parts)


def _is_in(file: StoredFile, out: Location) -> bool:
    """Whether it is a result log of the dataset, also through links."""
    if out.is_local and not is_address(file.address):
        place = Path(os.path.realpath(file.address))  # resolve() refuses a link to itself
        return place.is_relative_to(Path(out.address).resolve() / LOGS)
    return file.address.startswith(f"{out.address}/{LOGS}/")


def joined(files: Iterable[StoredFile], parts: re.Pattern[str]) -> list[DriveFiles]:
    """Files of one folder whose names are the same without what the pattern finds, as one log each."""
    drives: dict[str, list[StoredFile]] = {}
    for file in files:
        folder, _, name = file.address.rpartition("/")
        stem = PurePosixPath(name).stem
        drives.setdefault(f"{folder}/{parts.sub('', stem)}", []).append(file)
    return [DriveFiles(tuple(sorted(some, key=lambda file: natural(file.address)))) for some in drives.values()]


def _said(arguments: Iterable[str]) -> Iterator[str]:
    for argument in arguments:
        if argument.startswith("@"):
            yield from _lines(Path(argument[1:]))
        else:
            yield argument


def _lines(path: Path) -> list[str]:
    """What a list names; a name without a folder counts from where the command was started, as on the line itself."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "is no text in UTF-8"
        raise StorageError(f"{path}: cannot be read as a list of logs: {reason}") from error
    return [line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]


Action = Literal["replay", "check", "leave"]
"""Replay it; read it to see whether it is a log that was replayed already; leave it as it is."""


@dataclass(frozen=True)
class Step:
    """What is done with a log, and why; ``before`` is its row, None where it has none."""

    drive: DriveFiles
    action: Action
    why: str
    before: BatchRow | None = None
    same_ids: tuple[str, ...] = ()

    @property
    def is_failed(self) -> bool:
        """Whether the log is left although it could not be replayed."""
        return self.action == "leave" and self.before is not None and self.before.row.status != "done"


class Planner:
    """Decides for one log after the other, by what a dataset holds."""

    def __init__(self, known: KnownRuns, job: BatchJob) -> None:
        self._known, self._job = known, job
        self._there = _files_of(job.out, (METRICS, OBJECTS), TABLE_SUFFIX) | _files_of(job.out, (LOGS,), ".mcap")

    def step(self, drive: DriveFiles) -> Step:
        """What to do with a log."""
        run = next(iter(self._known.named(drive.name)), None)
        if run is None:
            return self._of_unknown(drive, "is new")
        row = run.row
        if row.status != "done":
            return self._of_failed(drive, run)
        if why := self._stale(run):
            return Step(drive, "replay", why, run)
        if row.fingerprints[row.names.index(drive.name)] != drive.fingerprint:
            return Step(drive, "check", "the file has changed", run, (row.log_id or "",))
        if self._job.verify:
            return Step(drive, "check", "--verify", run, (row.log_id or "",))
        return Step(drive, "leave", "is done", run)

    def _of_unknown(self, drive: DriveFiles, why: str, before: BatchRow | None = None) -> Step:
        """A step for a log that was never read; its content may be that of a file of the same size."""
        same = (run.row.log_id for run in self._known.done_of_size(drive.size_bytes) if not self._stale(run))
        return Step(drive, "replay", why, before, tuple(filter(None, same)))

    def _of_failed(self, drive: DriveFiles, run: BatchRow) -> Step:
        row = run.row
        if row.status in OF_THE_MACHINE or row.status not in STATUSES:
            return self._of_unknown(drive, f"failed before: {row.status}", run)
        if row.fingerprints[row.names.index(drive.name)] != drive.fingerprint:
            return self._of_unknown(drive, f"was {row.status}, and the file has changed", run)
        if self._job.retry_failed:
            return Step(drive, "replay", f"was {row.status}: --retry-failed", run)
        if self._job.recover and not row.recover and row.status == "damaged":
            return Step(drive, "replay", "was damaged: --recover", run)
        return Step(drive, "leave", f"is {row.status}", run)

    def _stale(self, run: BatchRow) -> str:
        """Why the dataset's results of a log must be replaced; empty if they are valid."""
        row = run.row
        if row.version != __version__:
            return f"version {row.version} did it, this is {__version__}"
        if row.code != code_digest():
            return "the chain's code has changed"
        place = row.date or "", row.log_id or "", row.config
        names = {folder: name_in(folder, *place) for folder in (METRICS, OBJECTS, LOGS)}
        if names[METRICS] not in self._there or names[OBJECTS] not in self._there:
            return "its tables are gone"
        if self._job.keep_logs != "no" and (row.logs != self._job.keep_logs or names[LOGS] not in self._there):
            return "has no such result log"
        return ""


def _files_of(out: Location, folders: Sequence[str], suffix: str) -> set[str]:
    """The names of files that are not empty; a power failure leaves empty ones."""
    return {
        f"{folder}/{name}"
        for folder in folders
        for name, file in out.at(folder).files(suffix).items()
        if file.size_bytes
    }
