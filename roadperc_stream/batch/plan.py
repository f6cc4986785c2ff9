"""Finds the logs of a command line, and chooses the batch's action for each log, with the reason."""

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final, Literal

from roadperc_stream import __version__
from roadperc_stream.batch.addresses import is_address, natural
from roadperc_stream.batch.location import Location, StoredFile, find_files
from roadperc_stream.batch.runs import BatchRow, KnownRuns
from roadperc_stream.batch.task import LOGS, METRICS, OBJECTS, RESULTS_VERSION, BatchJob, LogFiles, name_in
from roadperc_stream.errors import StorageError
from roadperc_stream.schemas.columns.runs import OF_THE_MACHINE, STATUSES
from roadperc_stream.system.files import TABLE_SUFFIX, read_file

_MOST_LIST_BYTES: Final = 100_000_000
"""Largest list of logs."""


def find_logs(arguments: Sequence[str], out: Location, join: re.Pattern[str] | None) -> list[LogFiles]:
    """The logs that the arguments name, each once, in their order.

    Args:
        arguments: files, folders, globs, addresses, and ``@list.txt`` with one of those in each line.
        out: the dataset; its own result logs are not inputs.
        join: the part of a file's name in which files of one log differ; None if every file is a log.

    Raises:
        StorageError: an argument names no log, or a list cannot be read.
    """
    found = {file.address: file for argument in _listed(arguments) for file in find_files(argument)}
    files = [file for file in found.values() if not _is_in(file, out)]
    if not files:
        reason = "only result logs of this dataset; name the input logs" if found else "names no log"
        raise StorageError(f"{' '.join(arguments)}: {reason}")
    return [LogFiles((file,)) for file in files] if join is None else _joined(files, join)


def _is_in(file: StoredFile, out: Location) -> bool:
    """Whether a file is a result log of the dataset, also through links."""
    if out.is_local and not is_address(file.address):
        place = Path(os.path.realpath(file.address))  # resolve() raises an error for a link to itself
        return place.is_relative_to(Path(out.address).resolve() / LOGS)
    return file.address.startswith(f"{out.address}/{LOGS}/")


def _joined(files: Iterable[StoredFile], join: re.Pattern[str]) -> list[LogFiles]:
    """Logs of the files in one folder whose names are equal without the matches of the pattern."""
    logs: dict[str, list[StoredFile]] = {}
    for file in files:
        folder, _, name = file.address.rpartition("/")
        stem = PurePosixPath(name).stem
        logs.setdefault(f"{folder}/{join.sub('', stem)}", []).append(file)
    return [LogFiles(tuple(sorted(some, key=lambda file: natural(file.address)))) for some in logs.values()]


def _listed(arguments: Iterable[str]) -> Iterator[str]:
    """The arguments, and the lines of the lists; relative names start at the current folder."""
    for argument in arguments:
        if not argument.startswith("@"):
            yield argument
            continue
        try:
            lines = read_file(Path(argument[1:]), _MOST_LIST_BYTES).decode("utf-8-sig").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "expected text in UTF-8"
            raise StorageError(f"{argument[1:]}: cannot read the list of logs: {reason}") from error
        yield from (line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#"))


Action = Literal["replay", "check", "skip"]
"""Replay the log; read it, and replay it if its content is new; skip it."""


@dataclass(frozen=True)
class Step:
    """The action for a log, and the reason; ``previous`` is its row in the dataset, if any."""

    log: LogFiles
    action: Action
    why: str
    previous: BatchRow | None = None
    known_ids: tuple[str, ...] = ()

    @property
    def is_failed(self) -> bool:
        """Whether the log is skipped because it failed before."""
        return self.action == "skip" and self.previous is not None and self.previous.row.status != "done"


class Planner:
    """Chooses the action for each log from the content of the dataset."""

    def __init__(self, known: KnownRuns, job: BatchJob) -> None:
        self._known, self._job = known, job
        self._stored = _files_of(job.out, (METRICS, OBJECTS), TABLE_SUFFIX) | _files_of(job.out, (LOGS,), ".mcap")

    def step(self, log: LogFiles) -> Step:
        """The action for a log."""
        run = next(iter(self._known.named(log.name)), None)
        if run is None:
            return self._of_unknown(log, "is new")
        row = run.row
        if row.status != "done":
            return self._of_failed(log, run)
        if why := self._stale(run):
            return Step(log, "replay", why, run)
        if row.fingerprints[row.names.index(log.name)] != log.fingerprint:
            return Step(log, "check", "the file has changed", run, (row.log_id or "",))
        is_judged = self._job.contract is None or row.contract == self._job.contract.name
        if self._job.verify or not is_judged:
            why = "--verify" if self._job.verify else "was not judged by this contract"
            return Step(log, "check", why, run, (row.log_id or "",))
        return Step(log, "skip", "is done", run)

    def _of_unknown(self, log: LogFiles, why: str, previous: BatchRow | None = None) -> Step:
        """The step for a log that was never read; it may be a copy of a log of the same size."""
        same = (run.row.log_id for run in self._known.done_of_size(log.size_bytes) if not self._stale(run))
        return Step(log, "replay", why, previous, tuple(filter(None, same)))

    def _of_failed(self, log: LogFiles, run: BatchRow) -> Step:
        row = run.row
        if row.status in OF_THE_MACHINE or row.status not in STATUSES:
            return self._of_unknown(log, f"failed before: {row.status}", run)
        if row.fingerprints[row.names.index(log.name)] != log.fingerprint:
            return self._of_unknown(log, f"was {row.status}, and the file has changed", run)
        if self._job.retry_failed:
            return Step(log, "replay", f"was {row.status}: --retry-failed", run)
        if self._job.recover and not row.recover and row.status == "damaged":
            return Step(log, "replay", "was damaged: --recover", run)
        return Step(log, "skip", f"is {row.status}", run)

    def _stale(self, run: BatchRow) -> str:
        """The reason why the dataset's results of a log are invalid; empty if they are valid."""
        row = run.row
        if row.version != __version__:
            return f"was replayed by version {row.version}, this is {__version__}"
        if row.code != RESULTS_VERSION:
            return "the results have another version"
        place = row.date or "", row.log_id or "", row.config
        names = {folder: name_in(folder, *place) for folder in (METRICS, OBJECTS, LOGS)}
        if names[METRICS] not in self._stored or names[OBJECTS] not in self._stored:
            return "its tables are missing"
        if self._job.keep_logs != "no" and (row.logs != self._job.keep_logs or names[LOGS] not in self._stored):
            return "its result log is missing"
        return ""


def _files_of(out: Location, folders: Sequence[str], suffix: str) -> set[str]:
    """The names of all files with content; a power failure may leave empty files."""
    files = {f"{folder}/{name}": file for folder in folders for name, file in out.at(folder).files(suffix).items()}
    return {name for name, file in files.items() if file.size_bytes}
