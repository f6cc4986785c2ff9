"""The files of a log on the machine that replays it."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from roadperc_stream.batch.splitting import SplitPart
from roadperc_stream.batch.task import Task
from roadperc_stream.errors import StorageError
from roadperc_stream.log.stored import StoredLog
from roadperc_stream.storage import disk
from roadperc_stream.storage.addresses import is_address
from roadperc_stream.storage.fetching import PartialCopy, fetch, partial_copy
from roadperc_stream.storage.stored import StoredFile
from roadperc_stream.storage.stores import store_of


@dataclass(frozen=True)
class FetchedFiles:
    """The files, by ``paths`` that a replay takes; while it goes over them again and again they must not change."""

    paths: tuple[Path, ...]
    _partial: tuple[PartialCopy, ...]
    _identities: dict[str, tuple[int, ...]]
    """Of those that stand on this machine by themselves."""

    def require_unchanged(self) -> None:
        """Check that all files are what they were when they were fetched.

        Raises:
            StorageError: one is not, or cannot be looked at.
        """
        for copy in self._partial:
            copy.require_unchanged()
        for name, identity in self._identities.items():
            if _identity(name) != identity:
                raise StorageError(f"{name}: changed while it was replayed")


@contextmanager
def fetched(task: Task, folder: Path) -> Iterator[FetchedFiles]:
    """The log's files here; those of a store whole, or as far as they are read where nobody reads all.

    Raises:
        StorageError: one is not to be had, or is not the one whose parts others replay.
    """
    with ExitStack() as opened:
        paths, partial, identities = list[Path](), list[PartialCopy](), dict[str, tuple[int, ...]]()
        for file, copy in zip(task.drive.files, copies_in(task, folder), strict=True):
            if isinstance(task.piece, SplitPart):
                _require_as_listed(file)
            if not is_address(file.address):
                identities[file.address] = _identity(file.address)
            elif task.is_audited:
                partial.append(opened.enter_context(partial_copy(file.address, folder)))
                paths.append(StoredLog.of(copy, partial[-1]))
                continue
            elif not copy.exists():
                fetch(file.address, copy)
            paths.append(copy)
        yield FetchedFiles(tuple(paths), tuple(partial), identities)


def copies_in(task: Task, folder: Path) -> Iterator[Path]:
    """The path of each file on this machine: its own, or that of a copy in the folder."""
    for number, file in enumerate(task.drive.files):
        yield folder / f"{number}.mcap" if is_address(file.address) else Path(file.address)


def with_addresses(text: str, task: Task, folder: Path) -> str:
    """What was said of copies, said of what they are copies of."""
    for file, copy in zip(task.drive.files, copies_in(task, folder), strict=True):
        text = text.replace(str(copy), file.address)
    return text


def _require_as_listed(file: StoredFile) -> None:
    found = store_of(file.address).file() if is_address(file.address) else disk.stored_file(file.address)
    if found is None or found.fingerprint != file.fingerprint:
        raise StorageError(f"{file.address}: changed while its parts were replayed")


def _identity(name: str) -> tuple[int, ...]:
    try:
        facts = Path(name).stat()
    except OSError as error:
        words = f"no such file on {socket.gethostname()}; machines without a disk in common need addresses"
        raise StorageError(f"{name}: {words}") from error
    return facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns
