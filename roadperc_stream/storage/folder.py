"""A folder of results, on this machine or in a store."""

import errno
import shutil
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final
from uuid import uuid4

from roadperc_stream.core.files import completing, require_plain, target_errors
from roadperc_stream.errors import StorageError
from roadperc_stream.storage.addresses import is_address, joined, whole
from roadperc_stream.storage.disk import disk_errors, pieces_of, stored_file
from roadperc_stream.storage.finding import files_below
from roadperc_stream.storage.stored import StoredFile
from roadperc_stream.storage.stores import Store, store_errors, store_of, tried

_PIECE_BYTES: Final = 16 << 20


@dataclass(frozen=True)
class Folder:
    """A folder that need not exist; it can be handed to other processes and machines.

    Names of files are relative to it, with slashes.

    Attributes:
        address: the absolute path or the address; a relative path is taken from the current folder.
    """

    address: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "address", whole(self.address))

    @property
    def is_local(self) -> bool:
        """Whether it is on this machine, or mounted here."""
        return not is_address(self.address)

    def path(self, name: str) -> Path:
        """The path of a file; for a folder on this machine only.

        Raises:
            StorageError: it is in a store, or the name leads out of the folder.
        """
        if not self.is_local:
            raise StorageError(f"{self.address}: expected a folder on this machine")
        return Path(joined(self.address, name))

    def read(self, name: str) -> bytes | None:
        """All of a file, None where there is none.

        Raises:
            StorageError: it cannot be read.
        """
        return _read_local(self.path(name)) if self.is_local else _read_stored(self._stored(name))

    def write(self, name: str, data: bytes) -> None:
        """Write a file, which appears, or replaces another one, whole or not at all.

        Raises:
            StorageError: the store does not take it.
            TargetError: it cannot be written on this machine.
        """
        if self.is_local:
            with completing(self.path(name), mark=uuid4().hex) as hidden:
                hidden.write_bytes(data)
        else:
            tried(partial(_upload, self._stored(name), lambda: [data], len(data)))

    def put(self, source: Path, name: str) -> None:
        """Move a file of this machine into the folder, where it appears whole or not at all.

        Raises:
            StorageError: the store does not take it.
            TargetError: it cannot be written on this machine.
        """
        if self.is_local:
            _move(source, self.path(name))
        else:
            _put(source, self._stored(name))

    def files(self, below: str = "", suffix: str = "") -> list[StoredFile]:
        """Its files, in natural order, hidden ones and hidden folders left out; none where there is no folder.

        Args:
            below: only those of this folder within it.
            suffix: how their names end.

        Raises:
            StorageError: it cannot be listed.
        """
        return files_below(joined(self.address, below) if below else self.address, suffix)

    def file(self, name: str) -> StoredFile | None:
        """A file as it is now; None where there is none.

        Raises:
            StorageError: it cannot be looked at.
        """
        return stored_file(str(self.path(name))) if self.is_local else self._stored(name).file()

    def name_of(self, stored: StoredFile) -> str:
        """The name, relative to the folder, of a file that ``files`` found.

        Raises:
            StorageError: it is not below the folder.
        """
        name = stored.address.removeprefix(f"{self.address.rstrip('/')}/")
        if name == stored.address:
            raise StorageError(f"{stored.address}: is not below {self.address}")
        return name

    def remove(self, name: str) -> None:
        """Remove a file; it need not exist.

        Raises:
            StorageError: the store does not remove it.
            TargetError: it cannot be removed on this machine.
        """
        if self.is_local:
            with target_errors(self.path(name)):
                self.path(name).unlink(missing_ok=True)
        else:
            _remove(self._stored(name))

    def _stored(self, name: str) -> Store:
        return store_of(joined(self.address, name))


def _read_local(path: Path) -> bytes | None:
    with disk_errors(str(path)):
        try:
            return path.read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None


def _read_stored(store: Store) -> bytes | None:
    with store_errors(store.address):
        try:
            with store.system.open_input_file(store.path) as stream:
                data: bytes = stream.read()
        except FileNotFoundError:
            return None
    return data


def _move(source: Path, target: Path) -> None:
    """Rename a file, or where it is on another disk, copy it to one of a hidden name first."""
    require_plain(target)
    with target_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            source.replace(target)
        except OSError as error:
            if error.errno != errno.EXDEV:
                raise
            with completing(target, mark=uuid4().hex) as hidden:
                shutil.copyfile(source, hidden)
            source.unlink(missing_ok=True)


def _put(source: Path, store: Store) -> None:
    with disk_errors(str(source)):
        size_bytes = source.stat().st_size
    tried(partial(_upload, store, partial(pieces_of, str(source), _PIECE_BYTES), size_bytes))
    with target_errors(source):
        source.unlink(missing_ok=True)


def _remove(store: Store) -> None:
    with store_errors(store.address), suppress(FileNotFoundError):
        store.system.delete_file(store.path)


def _upload(store: Store, pieces: Callable[[], Iterable[bytes]], size_bytes: int) -> None:
    """Write a file in pieces.

    A stream that is closed makes a file of what it was given, even where an error closes it: then what is not whole
    goes. Where it is the store that failed, closing fails too, and what was there before stays: S3's client remembers a
    failure as long as it writes in the background. It is waited for after each piece, or all of a file that is faster
    read than sent would be in memory.
    """
    with store_errors(store.address):
        stream = store.system.open_output_stream(store.path)
    try:
        for piece in pieces():
            with store_errors(store.address):
                stream.write(piece)
                stream.flush()
        with store_errors(store.address):
            stream.close()
    except BaseException:
        with suppress(Exception):
            is_whole = stream.closed or stream.tell() == size_bytes
            stream.close()
            if not is_whole:
                store.system.delete_file(store.path)
        raise
