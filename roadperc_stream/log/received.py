"""Makes every input a file that can be read as MCAP many times: pipes, and ROS bags of other formats, are stored."""

import os
import stat
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Final

from roadperc_stream.errors import LogError
from roadperc_stream.log.bags import BagFile, as_mcap, bag_files
from roadperc_stream.log.damage import require_magic, unopened
from roadperc_stream.log.layout import MAGIC
from roadperc_stream.log.stored import BLOCK_BYTES, Spool, StoredLog

STANDARD_INPUT: Final = Path("-")


def received(paths: Sequence[Path]) -> tuple[Path, ...]:
    """Return logs as MCAP files that can be read many times; the folder of a ROS 2 bag gives all its files.

    Pipes, and bags of other formats, are stored in temporary files. The path ``-`` is standard input.

    Raises:
        LogError: there is no path, a log is given twice, standard input is a terminal, the first bytes of a pipe are
            not MCAP, or a bag cannot be opened.
        TargetError: there is no space to store a log.
    """
    if not paths:
        raise LogError("no log is given; pass a log, or all files of one log")
    files = [file for path in paths for file in bag_files(path)]
    for number, file in enumerate(files):
        if any(_is_same(file.path, other.path) for other in files[:number]):
            raise LogError(f"{file.path}: is given twice")
    return tuple(_received(file) for file in files)


def received_file(path: Path) -> Path:
    """Return a log in one file, as ``received``.

    Raises:
        LogError: it is a bag of several files; else as ``received``.
    """
    files = received([path])
    if len(files) > 1:
        raise LogError(f"{path}: a bag of {len(files)} files, expected one; pass one of them, such as {files[0]}")
    return files[0]


def _is_same(one: Path, other: Path) -> bool:
    try:
        return one == other or (STANDARD_INPUT not in (one, other) and one.samefile(other))
    except OSError:  # one does not exist; reading it reports that
        return False


def _received(file: BagFile) -> Path:
    path = file.path
    if isinstance(path, StoredLog):
        return path
    try:
        if path != STANDARD_INPUT and not path.is_fifo():
            return as_mcap(file) if path.is_file() else path
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
    while block := stream.read(BLOCK_BYTES):
        spool.append(block)
    spool.finish()
    return spool
