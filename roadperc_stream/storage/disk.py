"""Files of this machine, as ``stores`` has those of a store."""

import os
import stat
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from roadperc_stream.core.files import system_errors
from roadperc_stream.errors import StorageError
from roadperc_stream.storage.patterns import Parts, leads_on
from roadperc_stream.storage.stored import StoredFile, fingerprint


def disk_errors(path: str) -> AbstractContextManager[None]:
    """What the system refuses in reading, as a StorageError that names the file or the folder."""
    return system_errors(path, StorageError)


def stored_file(path: str) -> StoredFile | None:
    """The file under a path; None for a folder, and where there is nothing.

    Raises:
        StorageError: it cannot be reached, or is a device or a pipe.
    """
    try:
        with disk_errors(path):
            facts = Path(path).stat()
    except StorageError as error:
        if isinstance(error.__cause__, FileNotFoundError | NotADirectoryError):
            return None
        raise
    if not stat.S_ISREG(facts.st_mode) and not stat.S_ISDIR(facts.st_mode):
        raise StorageError(f"{path}: is a device or a pipe, expected a file or a folder")
    return _stored(path, facts) if stat.S_ISREG(facts.st_mode) else None


def files_below(folder: str, pattern: Parts) -> Iterator[tuple[Parts, StoredFile]]:
    """The files below a folder, in no order, with their names from there on.

    Folders behind links are entered, but none within itself. A link that leads nowhere is listed, as a file that
    cannot be read: what it stood for is missed.

    Args:
        folder: an absolute path; where there is no such folder, there are no files.
        pattern: folders that it does not lead to are left out.

    Raises:
        StorageError: a folder cannot be read.
    """
    if Path(folder).is_dir():
        yield from _walked(folder, (), pattern, frozenset())


def _walked(
    folder: str, names: Parts, pattern: Parts, within: frozenset[tuple[int, int]]
) -> Iterator[tuple[Parts, StoredFile]]:
    with disk_errors(folder):
        facts = Path(folder).stat()
        entries = list(os.scandir(folder))
    number = (facts.st_dev, facts.st_ino)
    for entry in entries if number not in within else ():
        below = (*names, entry.name)
        if _is(entry.is_file):
            yield below, _stored(entry.path, entry.stat())
        elif _leads_nowhere(entry):
            yield below, StoredFile(entry.path, 0, fingerprint(0, 0))
        elif _is(entry.is_dir) and leads_on(pattern, below):
            yield from _walked(entry.path, below, pattern, within | {number})


def _is(kind: Callable[[], bool]) -> bool:
    """What an entry says of itself; a link to itself is nothing."""
    try:
        return kind()
    except OSError:
        return False


def _leads_nowhere(entry: os.DirEntry[str]) -> bool:
    """Whether it is a link to what is not there, or cannot be reached."""
    try:
        entry.stat()
    except OSError:
        return entry.is_symlink()
    return False


def _stored(path: str, facts: os.stat_result) -> StoredFile:
    return StoredFile(path, facts.st_size, fingerprint(facts.st_size, facts.st_mtime_ns))


def is_folder(path: str) -> bool:
    """Whether there is a folder under a path."""
    return Path(path).is_dir()


def pieces_of(path: str, size_bytes: int) -> Iterator[bytes]:
    """What is in a file, in pieces of a size.

    Raises:
        StorageError: it cannot be read.
    """
    with disk_errors(path), Path(path).open("rb") as stream:
        while piece := stream.read(size_bytes):
            yield piece
