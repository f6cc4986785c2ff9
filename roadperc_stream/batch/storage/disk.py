"""Files of this machine, with the methods that ``stores.Store`` has for those of a store."""

import errno
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final
from uuid import uuid4

from roadperc_stream.batch.storage.addresses import Parts, leads_on
from roadperc_stream.errors import StorageError
from roadperc_stream.system.files import completing, require_plain, system_errors, target_errors

PIECE_BYTES: Final = 16 << 20
"""Files are copied and sent in pieces of this size."""


@dataclass(frozen=True)
class StoredFile:
    """A file that was found.

    Attributes:
        address: its absolute path, or its address with a scheme.
        size_bytes: its length.
        fingerprint: differs from an earlier one whenever the content may; equal where nobody wrote the file.
    """

    address: str
    size_bytes: int
    fingerprint: str


def fingerprint(size_bytes: int, modified: object) -> str:
    """Size and time of change; where a store tells no time, a text that is never seen again."""
    return f"{size_bytes}:{uuid4().hex if modified is None else modified}"


def disk_errors(path: str) -> AbstractContextManager[None]:
    """What the system refuses in reading, as a StorageError that names the file or the folder."""
    return system_errors(path, StorageError)


@dataclass(frozen=True)
class Disk:
    """A file or a folder of this machine, by its absolute path.

    All methods but ``write``, ``put`` and ``remove`` raise a StorageError where the disk refuses to be read, and those
    a TargetError where it refuses to be written.
    """

    address: str

    @property
    def path(self) -> Path:
        """As the system wants it."""
        return Path(self.address)

    def file(self) -> StoredFile | None:
        """The file under this path; None for a folder, and where there is nothing.

        Raises:
            StorageError: it cannot be reached, or is a device or a pipe.
        """
        with disk_errors(self.address), suppress(FileNotFoundError, NotADirectoryError):
            facts = self.path.stat()
            if stat.S_ISREG(facts.st_mode):
                return _stored(self.address, facts)
            if not stat.S_ISDIR(facts.st_mode):
                raise StorageError(f"{self.address}: is a device or a pipe, expected a file or a folder")
        return None

    def is_folder(self) -> bool:
        """Whether there is a folder under this path."""
        return self.path.is_dir()

    def files_below(self, pattern: Parts) -> Iterator[tuple[Parts, StoredFile]]:
        """The files below this folder, in no order, with their names from there on; none without the folder.

        Folders behind links are entered, but none within itself. A link that leads nowhere is listed, as a file that
        cannot be read: what it stood for is missed.

        Args:
            pattern: folders that it does not lead to are left out.

        Raises:
            StorageError: a folder cannot be read.
        """
        return _walked(self.address, (), pattern, frozenset()) if self.is_folder() else iter(())

    def read(self) -> bytes | None:
        """All of the file, None where there is none."""
        with disk_errors(self.address), suppress(FileNotFoundError, NotADirectoryError):
            return self.path.read_bytes()
        return None

    def write(self, data: bytes) -> None:
        """Write the file, which appears, or replaces another one, whole or not at all."""
        with completing(self.path, mark=uuid4().hex) as hidden:
            hidden.write_bytes(data)

    def put(self, source: Path) -> None:
        """Rename another file to this one, or where that is on another disk, copy it to a hidden name first."""
        require_plain(self.path)
        with target_errors(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                source.replace(self.path)
            except OSError as error:
                if error.errno != errno.EXDEV:
                    raise
                with completing(self.path, mark=uuid4().hex) as hidden:
                    shutil.copyfile(source, hidden)
                source.unlink(missing_ok=True)

    def remove(self) -> None:
        """Remove the file; it need not exist."""
        with target_errors(self.path):
            self.path.unlink(missing_ok=True)

    def copy_to(self, target: IO[bytes]) -> None:
        """Write all of the file to a stream.

        Raises:
            StorageError: it cannot be read, or changed meanwhile.
        """
        before = self.file()
        if before is None:
            raise StorageError(f"{self.address}: no such file")
        for piece in pieces_of(self.address):
            target.write(piece)
        if self.file() != before:
            raise changed(self.address)


def pieces_of(path: str) -> Iterator[bytes]:
    """What is in a file, in pieces.

    Raises:
        StorageError: it cannot be read.
    """
    with disk_errors(path), Path(path).open("rb") as stream:
        while piece := stream.read(PIECE_BYTES):
            yield piece


def changed(address: str) -> StorageError:
    """The error of a file that is not the one that was opened."""
    return StorageError(f"{address}: changed while it was read")


def _walked(
    folder: str, names: Parts, pattern: Parts, within: frozenset[tuple[int, int]]
) -> Iterator[tuple[Parts, StoredFile]]:
    with disk_errors(folder):
        here = Path(folder).stat()
        entries = list(os.scandir(folder))
    number = (here.st_dev, here.st_ino)
    for entry in entries if number not in within else ():
        below = (*names, entry.name)
        try:
            facts = entry.stat()
        except OSError:
            if entry.is_symlink():  # to what is not there, cannot be reached, or is itself
                yield below, StoredFile(entry.path, 0, fingerprint(0, 0))
            continue
        if stat.S_ISREG(facts.st_mode):
            yield below, _stored(entry.path, facts)
        elif stat.S_ISDIR(facts.st_mode) and leads_on(pattern, below):
            yield from _walked(entry.path, below, pattern, within | {number})


def _stored(path: str, facts: os.stat_result) -> StoredFile:
    return StoredFile(path, facts.st_size, fingerprint(facts.st_size, facts.st_mtime_ns))
