"""Logs as files that open many times: pipes are copied to unnamed temporary files, which end with the process."""

import errno
import os
import shutil
import sqlite3
import stat
import sys
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final, Self

from roadperc_stream.errors import LogError, TargetError
from roadperc_stream.log.damage import require_magic, unopened
from roadperc_stream.log.layout import MAGIC

_LEFT_FREE: Final = 0.1
"""Share of the free space that stays free, even if a pipe never ends."""
STANDARD_INPUT: Final = Path("-")
_BLOCK_BYTES: Final = 1024 * 1024


@dataclass(frozen=True)
class LogFile:
    """A log, and where its bytes are."""

    name: Path
    """For people: the path of the log, ``-`` for standard input."""
    path: Path
    """Opens the bytes: the log itself, or an unnamed temporary file."""
    fault: str = ""
    """Why the bytes end too early, if they do and the cause is known."""

    @classmethod
    def of(cls, source: "AnyLog") -> "LogFile":
        """Return a path as a log."""
        return source if isinstance(source, LogFile) else cls(source, source)

    @classmethod
    def temporary(cls, name: Path, file: IO[bytes], path: Path | None = None, fault: str = "") -> Self:
        """Return a log in an open temporary file, which it owns; ``path`` is its place, if it has a name."""
        found = cls(name, path or Path(f"/proc/self/fd/{file.fileno()}"), fault)
        weakref.finalize(found, file.close)
        return found

    def __str__(self) -> str:
        """Return the name."""
        return str(self.name)


AnyLog = Path | LogFile
"""A log by its path, or one whose bytes are elsewhere."""


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


def received_files(paths: Sequence[Path]) -> tuple[LogFile, ...]:
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


def _received(path: Path) -> LogFile:
    if not (path == STANDARD_INPUT or path.is_fifo()):
        return LogFile.of(path)
    try:
        with _standard_input() if path == STANDARD_INPUT else path.open("rb") as stream:
            return LogFile.temporary(path, _stored(path, stream))
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


def _stored(path: Path, stream: IO[bytes]) -> IO[bytes]:
    """Store a stream; a redirected file, as in ``< in.mcap``, is used directly.

    Raises:
        LogError: its first bytes are not MCAP.
        TargetError: there is no space for it.
    """
    if stat.S_ISREG(os.fstat(stream.fileno()).st_mode) and stream.tell() == 0:
        return os.fdopen(os.dup(stream.fileno()), "rb")
    magic = stream.read(len(MAGIC))
    require_magic(path, magic)
    with storing(str(path)):
        file = tempfile.TemporaryFile()  # noqa: SIM115 - the log owns it
    fill(file, path, stream, magic)
    return file


def fill(file: IO[bytes], name: Path, stream: IO[bytes], start: bytes = b"") -> None:
    """Write ``start`` and the bytes of a stream to a temporary file, and close it after an error, which names the log.

    Raises:
        TargetError: the disk is full, or nearly full.
    """
    with ExitStack() as failing:
        failing.callback(file.close)
        with storing(str(name)):
            most_bytes = (1 - _LEFT_FREE) * shutil.disk_usage(tempfile.gettempdir()).free
        while block := start or stream.read(_BLOCK_BYTES):
            start = b""
            with storing(str(name)):
                if file.tell() + len(block) > most_bytes:
                    raise OSError(errno.ENOSPC, f"{1 - _LEFT_FREE:.0%} of the free space are used")
                file.write(block)
        with storing(str(name)):
            file.flush()
        failing.pop_all()
