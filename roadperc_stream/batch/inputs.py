"""Which logs a command line means: files, folders, globs, lists of them, here or at addresses."""

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath

from roadperc_stream.batch.publishing import LOGS
from roadperc_stream.batch.task import DriveFiles
from roadperc_stream.errors import StorageError
from roadperc_stream.storage.addresses import is_address
from roadperc_stream.storage.finding import find_files
from roadperc_stream.storage.folder import Folder
from roadperc_stream.storage.patterns import natural
from roadperc_stream.storage.stored import StoredFile


def find_drives_in(arguments: Sequence[str], out: Folder, parts: re.Pattern[str] | None) -> list[DriveFiles]:
    """The logs that the arguments mean, each once, in their order.

    Args:
        arguments: files, folders, globs, addresses, and ``@list.txt`` with one of those in each line.
        out: the dataset, whose own logs are none of the input.
        parts: what in a file's name tells the parts of one drive apart; None: every file is a log.

    Raises:
        StorageError: one names no log, or a list cannot be read.
    """
    found = {file.address: file for argument in _said(arguments) for file in find_files(argument)}
    files = [file for file in found.values() if not _is_in(file, out)]
    if not files:
        reason = "no log but those of the dataset itself" if found else "names no log"
        raise StorageError(f"{' '.join(arguments)}: {reason}")
    return [DriveFiles((file,)) for file in files] if parts is None else joined(files, parts)


def _is_in(file: StoredFile, out: Folder) -> bool:
    """Whether it is a result log of the dataset, whatever links lead there."""
    if out.is_local and not is_address(file.address):
        place = Path(os.path.realpath(file.address))  # resolve() refuses a link to itself
        return place.is_relative_to(Path(out.address).resolve() / LOGS)
    return file.address.startswith(f"{out.address}/{LOGS}/")


def joined(files: Iterable[StoredFile], parts: re.Pattern[str]) -> list[DriveFiles]:
    """Files of one folder whose names are the same without what the pattern finds, as one log each."""
    drives: dict[str, list[StoredFile]] = {}
    for file in files:
        folder, _, name = file.address.rpartition("/")
        stem = PurePosixPath(name).stem
        drives.setdefault(f"{folder}/{parts.sub('', stem)}", []).append(file)
    return [DriveFiles(tuple(sorted(some, key=lambda file: natural(file.address)))) for some in drives.values()]


def _said(arguments: Iterable[str]) -> Iterator[str]:
    for argument in arguments:
        if argument.startswith("@"):
            yield from _lines(Path(argument[1:]))
        else:
            yield argument


def _lines(path: Path) -> list[str]:
    """What a list names; a name without a folder counts from where the command was started, as on the line itself."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "is no text in UTF-8"
        raise StorageError(f"{path}: cannot be read as a list of logs: {reason}") from error
    return [line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]
