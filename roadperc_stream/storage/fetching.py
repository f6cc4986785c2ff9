"""A file of a store, or of this machine, to a file here: whole or not at all, or as far as it is read."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO, Final
from uuid import uuid4

from roadperc_stream.core.files import completing, target_errors
from roadperc_stream.errors import StorageError
from roadperc_stream.storage import disk
from roadperc_stream.storage.addresses import is_address, whole
from roadperc_stream.storage.stores import Store, store_errors, store_of, tried

_PIECE_BYTES: Final = 16 << 20
_SMALLEST_PIECE_BYTES: Final = 256 << 10
"""A connection that breaks often brings at least this much."""
_BLOCK_BYTES: Final = 8 << 20
"""What is fetched at once of a file that is not fetched whole: a second of a drive with several cameras, or a few."""


def fetch(address: str, target: Path) -> None:
    """Copy a file here, in pieces; a connection that breaks is taken up where it was.

    Args:
        address: of the file.
        target: is replaced where it exists.

    Raises:
        StorageError: the file cannot be read, or changed while it was.
        TargetError: the target cannot be written.
    """
    source = whole(address)
    with completing(target, mark=uuid4().hex) as hidden, hidden.open("wb") as stream:
        if is_address(source):
            _download(store_of(source), stream)
        else:
            _copy(source, stream)


def _copy(source: str, target: IO[bytes]) -> None:
    before = disk.stored_file(source)
    if before is None:
        raise StorageError(f"{source}: no such file")
    for piece in disk.pieces_of(source, _PIECE_BYTES):
        target.write(piece)
    if disk.stored_file(source) != before:
        raise _changed(source)


@contextmanager
def partial_copy(address: str, folder: Path) -> Iterator["PartialCopy"]:
    """A file of a store, of which only what is read is fetched.

    Args:
        address: of the file.
        folder: in which the copy is, without a name: it is gone with the process, even with one that is killed.

    Raises:
        StorageError: the file cannot be read.
    """
    source = _Source(store_of(address))
    with tempfile.TemporaryFile(dir=folder) as kept:
        yield PartialCopy(source, kept, folder)


class PartialCopy:
    """A file of a store as far as it has been read; ``log.spool.StoredBytes``."""

    def __init__(self, source: "_Source", kept: IO[bytes], folder: Path) -> None:
        self._source, self._kept, self._folder = source, kept, folder
        self._fetched = set[int]()
        """Numbers of blocks."""

    @property
    def size_bytes(self) -> int:
        """Of the whole file."""
        return self._source.size_bytes

    def read(self, start: int, length: int) -> bytes:
        """Some of the bytes, fewer at the end.

        Raises:
            StorageError: they cannot be fetched.
            TargetError: there is no space for them.
        """
        end = min(start + length, self.size_bytes)
        if start >= end:
            return b""
        for number in range(start // _BLOCK_BYTES, (end - 1) // _BLOCK_BYTES + 1):
            if number not in self._fetched:
                self._fetch(number)
        with target_errors(self._folder):
            self._kept.seek(start)
            return self._kept.read(end - start)

    def require_unchanged(self) -> None:
        """Check that the file is what it was at first.

        Raises:
            StorageError: it is not, or cannot be reached.
        """
        tried(self._source.check)

    def _fetch(self, number: int) -> None:
        at = number * _BLOCK_BYTES
        end = min(at + _BLOCK_BYTES, self.size_bytes)
        while at < end:
            piece = tried(partial(self._source.piece, at, end))
            with target_errors(self._folder):
                self._kept.seek(at)
                self._kept.write(piece)
                self._kept.flush()
            at += len(piece)
        self._fetched.add(number)


def _download(store: Store, target: IO[bytes]) -> None:
    source = _Source(store)
    while target.tell() < source.size_bytes:
        target.write(tried(partial(source.piece, target.tell(), source.size_bytes)))
    tried(source.check)


class _Source:
    """A file of a store that is being read, in pieces that become smaller when the connection breaks.

    Attributes:
        size_bytes: its length.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._piece_bytes = _PIECE_BYTES
        self._is_in_doubt = False
        with store_errors(store.address):
            self._file = store.system.open_input_file(store.path)
            self.size_bytes: int = self._file.size()
            self._identity = self._file.metadata() or store.file()

    def check(self) -> None:
        """Compare the file with what it was when it was opened.

        Raises:
            StorageError: it changed, or cannot be reached.
        """
        if _Source(self._store)._identity != self._identity:
            raise _changed(self._store.address)

    def piece(self, start: int, end: int) -> bytes:
        """Some bytes from ``start`` on, none of them from ``end`` on.

        Raises:
            StorageError: they were not read, and the next try asks for fewer; or the file changed.
        """
        if self._is_in_doubt:
            self.check()
        self._is_in_doubt = True
        size = min(self._piece_bytes, end - start)
        self._piece_bytes = max(self._piece_bytes // 4, _SMALLEST_PIECE_BYTES)
        with store_errors(self._store.address):
            data: bytes = self._file.read_at(size, start)
            if not data:
                raise OSError(f"ends at byte {start}, expected {self.size_bytes}")
        self._piece_bytes = min(4 * self._piece_bytes, _PIECE_BYTES)
        self._is_in_doubt = False
        return data


def _changed(address: str) -> StorageError:
    return StorageError(f"{address}: changed while it was read")
