"""Logs whose bytes do not stand under their name, such as piped and repaired ones: read like files."""

import os
import stat
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, Final, Self

from roadperc_stream.errors import LogError
from roadperc_stream.log.integrity import MAGIC, require_magic, unopened
from roadperc_stream.log.spool import Spool, StoredBytes, stream_over

STANDARD_INPUT: Final = Path("-")
_BLOCK_BYTES: Final = 1024 * 1024


class StoredLog(type(Path())):  # type: ignore[misc]  # the class of paths of this system
    """The name a log came by, and its bytes, which do not stand there; a path derived from it is like any other."""

    stored: StoredBytes | None = None

    @classmethod
    def of(cls, path: Path, stored: StoredBytes) -> Self:
        """A name with its bytes."""
        made = cls(path)
        made.stored = stored
        return made

    def open(self, *arguments: Any, **options: Any) -> IO[Any]:
        """A stream over the bytes."""
        return stream_over(self.stored) if self.stored else super().open(*arguments, **options)

    def is_dir(self, **_: Any) -> bool:
        """It is none."""
        return False if self.stored else super().is_dir()


def received(paths: Sequence[Path]) -> tuple[Path, ...]:
    """Logs as files that can be read many times: what comes through a pipe is stored, all others stay what they are.

    Args:
        paths: of logs; ``-`` is standard input.

    Raises:
        LogError: there is none, one is given twice, standard input is a terminal, or what comes through a pipe does
            not start as a log: the rest of it is not waited for.
        TargetError: there is no space for what a pipe brings.
    """
    if not paths:
        raise LogError("no log is given, expected one or the parts of one")
    for number, path in enumerate(paths):
        if any(_is_same(path, other) for other in paths[:number]):
            raise LogError(f"{path}: is given twice")
    return tuple(_received(path) for path in paths)


def _is_same(one: Path, other: Path) -> bool:
    try:
        return one == other or (STANDARD_INPUT not in (one, other) and one.samefile(other))
    except OSError:  # one is not there, which reading it says
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
    """A stream of its own over standard input.

    Raises:
        LogError: it is closed, or somebody would have to type the log.
    """
    if sys.stdin is None:
        raise LogError("-: standard input is closed, expected a log")
    if sys.stdin.isatty():
        raise LogError("-: standard input is a terminal, expected a log, such as from: cat in.mcap | ...")
    return os.fdopen(os.dup(sys.stdin.fileno()), "rb")


def _stored(path: Path, stream: IO[bytes]) -> Spool:
    """All that comes; a file that stands in for a pipe, as with ``< in.mcap``, is there already.

    Raises:
        LogError: what comes first is no log's.
        TargetError: there is no space for all of it.
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
