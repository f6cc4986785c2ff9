"""Unnamed temporary files, and logs that are read from them, such as piped and repaired ones.

The system removes them when the process ends, even if it is killed.
"""

import errno
import io
import os
import shutil
import sqlite3
import stat
import sys
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Final, Self

from roadperc_stream.errors import LogError, TargetError
from roadperc_stream.log.damage import require_magic, unopened
from roadperc_stream.log.layout import MAGIC

_LEFT_FREE: Final = 0.1
"""Share of the free space that stays free, even if a pipe never ends."""
STANDARD_INPUT: Final = Path("-")
_BLOCK_BYTES: Final = 1024 * 1024
_READ_BYTES: Final = io.DEFAULT_BUFFER_SIZE * 8


@contextmanager
def storing(what: str, done: str = "stored") -> Iterator[None]:
    """Turn errors of the folder for temporary files into one that names the folder.

    The error also names the stored log, ``what``, and the failed action, ``done``.

    Raises:
        TargetError: the disk is full or fails, or there is no such folder.
    """
    try:
        yield
    except (OSError, sqlite3.Error) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        place = f"cannot be {done} in {_folder()}"
        raise TargetError(f"{what}: {place}: {reason}; TMPDIR names a folder with more space") from error


def _folder() -> str:
    try:
        return tempfile.gettempdir()
    except OSError:
        return "the folder for temporary files"


class Spool:
    """A temporary file that is written once from start to end, and then read by any number of readers."""

    def __init__(self, what: str, stored: IO[bytes] | None = None) -> None:
        """Create an empty file, or use an existing one.

        Errors name its content, ``what``. ``stored`` is a seekable file; the spool owns it.

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
        """Append bytes and return their position.

        Raises:
            TargetError: the disk is full, or nearly full.
        """
        with storing(self._what):
            if self.size_bytes + len(data) > self._most_bytes:
                raise OSError(errno.ENOSPC, f"{1 - _LEFT_FREE:.0%} of the free space are used")
            self._file.write(data)
        start, self.size_bytes = self.size_bytes, self.size_bytes + len(data)
        return start

    def finish(self) -> None:
        """Write buffered bytes.

        Raises:
            TargetError: the disk is full.
        """
        with storing(self._what):
            self._file.flush()

    def read(self, start: int, length: int) -> bytes:
        """Return bytes, fewer at the end."""
        found = data = os.pread(self._file.fileno(), length, start)
        while data and len(found) < length:  # the system reads no more than 2 GiB at once
            data = os.pread(self._file.fileno(), length - len(found), start + len(found))
            found += data
        return found


class _Reader(io.RawIOBase):
    """A reader with an independent position."""

    def __init__(self, stored: Spool) -> None:
        super().__init__()
        self._stored, self._at = stored, 0

    def readable(self) -> bool:
        """Return true."""
        return True

    def seekable(self) -> bool:
        """Return true."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a byte."""
        origin = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._stored.size_bytes}[whence]
        if origin + offset < 0:
            raise OSError(f"no byte {origin + offset}")
        self._at = origin + offset
        return self._at

    def readinto(self, buffer: "memoryview") -> int:  # type: ignore[override]  # a buffer of any kind is a memoryview
        """Fill a buffer; return the number of bytes read."""
        data = self._stored.read(self._at, len(buffer))
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)


class StoredLog(type(Path())):  # type: ignore[misc]  # the class of paths of this system
    """The name of a log whose bytes are in a temporary file; paths derived from it are ordinary."""

    stored: Spool | None = None
    fault: str = ""
    """Why the bytes end too early, if they do and the cause is known."""

    @classmethod
    def of(cls, path: Path, stored: Spool, fault: str = "") -> Self:
        """Return a name with its bytes."""
        made = cls(path)
        made.stored, made.fault = stored, fault
        return made

    def open(self, *arguments: Any, **options: Any) -> IO[Any]:
        """Open a stream over the bytes."""
        return (
            io.BufferedReader(_Reader(self.stored), _READ_BYTES) if self.stored else super().open(*arguments, **options)
        )

    def is_dir(self, **_: Any) -> bool:
        """Return false for a stored log."""
        return False if self.stored else super().is_dir()


def received_files(paths: Sequence[Path]) -> tuple[Path, ...]:
    """Return logs as files that can be read many times: pipes are stored in temporary files.

    The path ``-`` is standard input.

    Raises:
        LogError: there is no path, a log is given twice, standard input is a terminal, or the first bytes of a pipe are
            not MCAP.
        TargetError: there is no space to store a pipe.
    """
    if not paths:
        raise LogError("no log is given; pass a log, or all files of one log")
    for number, path in enumerate(paths):
        if any(_is_same(path, other) for other in paths[:number]):
            raise LogError(f"{path}: is given twice")
    return tuple(_received(path) for path in paths)


def _is_same(one: Path, other: Path) -> bool:
    try:
        return one == other or (STANDARD_INPUT not in (one, other) and one.samefile(other))
    except OSError:  # one does not exist; reading it reports that
        return False


def _received(path: Path) -> Path:
    if isinstance(path, StoredLog) or not (path == STANDARD_INPUT or path.is_fifo()):
        return path
    try:
        with _standard_input() if path == STANDARD_INPUT else path.open("rb") as stream:
            return StoredLog.of(path, _stored(path, stream))
    except OSError as error:
        raise unopened(path, error) from error


def _standard_input() -> IO[bytes]:
    """Return a separate stream over standard input.

    Raises:
        LogError: it is closed, or a terminal.
    """
    if sys.stdin is None:
        raise LogError("-: standard input is closed, expected a log")
    if sys.stdin.isatty():
        raise LogError("-: standard input is a terminal, expected a log, such as from: cat in.mcap | ...")
    return os.fdopen(os.dup(sys.stdin.fileno()), "rb")


def _stored(path: Path, stream: IO[bytes]) -> Spool:
    """Store a stream; a redirected file, as in ``< in.mcap``, is used directly.

    Raises:
        LogError: its first bytes are not MCAP.
        TargetError: there is no space for it.
    """
    if stat.S_ISREG(os.fstat(stream.fileno()).st_mode) and stream.tell() == 0:
        return Spool(str(path), os.fdopen(os.dup(stream.fileno()), "rb"))
    magic = stream.read(len(MAGIC))
    require_magic(path, magic)
    spool = Spool(str(path))
    spool.append(magic)
    while block := stream.read(_BLOCK_BYTES):
        spool.append(block)
    spool.finish()
    return spool
