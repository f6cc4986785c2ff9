"""A file of a store, or of this machine, to a file here: whole, or not at all."""

from functools import partial
from pathlib import Path
from typing import IO, Final
from uuid import uuid4

from roadperc_stream.core.files import completing
from roadperc_stream.errors import StorageError
from roadperc_stream.storage import disk
from roadperc_stream.storage.addresses import is_address, whole
from roadperc_stream.storage.stores import Store, store_errors, store_of, tried

_PIECE_BYTES: Final = 16 << 20
_SMALLEST_PIECE_BYTES: Final = 256 << 10
"""A connection that breaks often brings at least this much."""


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


def _download(store: Store, target: IO[bytes]) -> None:
    source = _Source(store)
    while target.tell() < source.size_bytes:
        target.write(tried(partial(source.piece, target.tell())))
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

    def piece(self, start: int) -> bytes:
        """Some bytes from ``start`` on.

        Raises:
            StorageError: they were not read, and the next try asks for fewer; or the file changed.
        """
        if self._is_in_doubt:
            self.check()
        self._is_in_doubt = True
        size = min(self._piece_bytes, self.size_bytes - start)
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
