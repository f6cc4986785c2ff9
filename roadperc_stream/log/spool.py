"""Bytes on disk without a name: they are gone with the process, even with one that is killed."""

import errno
import io
import os
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Final, Protocol

from roadperc_stream.errors import TargetError

_LEFT_FREE: Final = 0.1
"""Part of the free space that stays free: a pipe without an end leaves others some."""


@contextmanager
def storing(what: str) -> Iterator[None]:
    """What the system refuses in writing to the folder of temporary files, as an error that names the folder.

    Args:
        what: is stored there, for the error.

    Raises:
        TargetError: the disk is full, or there is no such folder.
    """
    try:
        yield
    except OSError as error:
        raise TargetError(refusal(what, "stored", error.strerror or str(error))) from error


def refusal(what: str, done: str, reason: str) -> str:
    """That something cannot be done in the folder of temporary files, which is named.

    Args:
        what: is stored there.
        done: what cannot be done with it there.
        reason: why not.
    """
    return f"{what}: cannot be {done} in {_folder()}: {reason}; TMPDIR names a folder with more space"


def _folder() -> str:
    try:
        return tempfile.gettempdir()
    except OSError:
        return "the folder of temporary files"


class StoredBytes(Protocol):
    """Bytes that can be read from any place."""

    @property
    def size_bytes(self) -> int:
        """How many there are."""

    def read(self, start: int, length: int) -> bytes:
        """Some of the bytes, fewer at the end."""


class Spool:
    """A temporary file that is written once, from its start to its end, and then read by any number of readers."""

    def __init__(self, what: str, stored: IO[bytes] | None = None) -> None:
        """Begin an empty one, or read one that is there.

        Args:
            what: it holds, for errors.
            stored: a file that can be read from any place; the spool owns it.

        Raises:
            TargetError: there is no folder for temporary files.
        """
        self._what = what
        with storing(what):
            self._file = stored or tempfile.TemporaryFile()  # noqa: SIM115 - closed with this object
            self._most_bytes = (1 - _LEFT_FREE) * shutil.disk_usage(tempfile.gettempdir()).free
            self.size_bytes = self._file.seek(0, os.SEEK_END)
        weakref.finalize(self, self._file.close)

    def append(self, data: bytes) -> int:
        """Add bytes at the end.

        Returns:
            The byte they start at.

        Raises:
            TargetError: the disk is full, or nearly so.
        """
        with storing(self._what):
            if self.size_bytes + len(data) > self._most_bytes:
                raise OSError(errno.ENOSPC, f"{1 - _LEFT_FREE:.0%} of the free space are used")
            self._file.write(data)
        start, self.size_bytes = self.size_bytes, self.size_bytes + len(data)
        return start

    def finish(self) -> None:
        """Write what is still to be written.

        Raises:
            TargetError: the disk is full.
        """
        with storing(self._what):
            self._file.flush()

    def read(self, start: int, length: int) -> bytes:
        """Some of the bytes, fewer at the end."""
        found = data = os.pread(self._file.fileno(), length, start)
        while data and len(found) < length:  # the system reads no more than 2 GiB at once
            data = os.pread(self._file.fileno(), length - len(found), start + len(found))
            found += data
        return found


def stream_over(stored: StoredBytes) -> IO[bytes]:
    """A stream over all bytes, with a position of its own."""
    return io.BufferedReader(_Reader(stored), buffer_size=io.DEFAULT_BUFFER_SIZE * 8)


class _Reader(io.RawIOBase):
    """Reads bytes from a position of its own."""

    def __init__(self, stored: StoredBytes) -> None:
        super().__init__()
        self._stored, self._at = stored, 0

    def readable(self) -> bool:
        """It is."""
        return True

    def seekable(self) -> bool:
        """It is."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a byte."""
        origin = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._stored.size_bytes}[whence]
        if origin + offset < 0:
            raise OSError(f"no byte {origin + offset}")
        self._at = origin + offset
        return self._at

    def readinto(self, buffer: "memoryview") -> int:  # type: ignore[override]  # a buffer of any kind is a memoryview
        """Fill a buffer as far as there are bytes."""
        data = self._stored.read(self._at, len(buffer))
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)
