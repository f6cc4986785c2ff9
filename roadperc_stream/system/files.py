"""Files that commands write: none is replaced unasked, and each appears under its name only when complete."""

import os
import re
import shlex
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Final, Protocol

from roadperc_stream.errors import TargetError

TABLE_SUFFIX: Final = ".parquet"
METRICS_SUFFIX: Final = ".metrics.parquet"
OBJECTS_SUFFIX: Final = ".objects.parquet"


def require_free(target: Path, *, force: bool, suffix: str, source: Path | None = None) -> None:
    """Check that a file may be written.

    Args:
        target: the file.
        force: an existing file may be replaced.
        suffix: how its name must end.
        source: what the file is made from, which it must not replace.

    Raises:
        TargetError: it may not.
    """
    require_plain(target)
    require_suffix(target, suffix)
    if source is not None and target.exists() and source.exists() and target.samefile(source):
        raise TargetError(f"{target}: is the input; name another output")
    if target.exists() and not force:
        raise TargetError(f"{target}: exists; pass --force (force=True) to overwrite it")


def require_plain(target: Path) -> None:
    """Check that a name is, or can become, that of a file: links and devices would be replaced, not written to.

    Raises:
        TargetError: it is anything else, or no text, which not every library takes for a name.
    """
    if os.fsencode(target).decode("utf-8", "replace") != str(target):
        raise TargetError(f"{str(target)!a}: expected a name in UTF-8")
    if target.is_symlink():
        raise TargetError(f"{target}: is a link; name the file that it is to stand for")
    if target.is_dir():
        raise TargetError(f"{target}: is a folder, expected the name of a file")
    if target.exists() and not target.is_file():
        raise TargetError(f"{target}: is a device or a pipe, expected the name of a file")


def require_suffix(target: Path, *suffixes: str) -> None:
    """Check that a file's name says what will be in it: a file of another kind might be a log or a table.

    Raises:
        TargetError: it ends in none of ``suffixes``.
    """
    if target.suffix.lower() not in suffixes:
        raise TargetError(f"{target}: expected a name that ends in {' or '.join(suffixes)}")


def make_private(folder: Path) -> None:
    """Make a folder that only this user can enter, or check that it is one; links are not followed.

    Raises:
        TargetError: it cannot be made, or others made it or can enter it: what is in it may be theirs.
    """
    with target_errors(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        facts = folder.lstat()
    fault, mode = "", stat.S_IMODE(facts.st_mode)
    if not stat.S_ISDIR(facts.st_mode):
        fault = "is a link or a file"
    elif facts.st_uid != os.geteuid():
        fault = f"belongs to user {facts.st_uid}"
    elif mode & 0o077:
        fault = f"has mode {mode:o}"
    if fault:
        expected = "expected a folder of this user with mode 700"
        raise TargetError(f"{folder}: {fault}, {expected}; remove it, or name another folder with --scratch")


def not_a_log(folder: Path) -> str:
    """Words for a folder that is named as a log: the logs within, or the command that makes one of a dump."""
    logs = sorted(folder.glob("*.mcap"))
    if logs:
        parts = f", or its {len(logs)} files as the parts of one: {folder}/*.mcap" if len(logs) > 1 else ""
        return f"{folder}: is a folder, expected a log, such as {logs[0]}{parts}"
    target = f"{folder if folder.name.strip('.') else folder.resolve().name}.mcap"
    command = shlex.join(("roadperc-convert", str(folder), target))
    return f"{folder}: is a folder, expected a log; a CARLA dump becomes one with: {command}"


def real_path(path: Path) -> Path:
    """The absolute path without links; of links that run in a circle the last one, where pathlib raises an error."""
    return Path(os.path.realpath(path))


@contextmanager
def target_errors(target: Path) -> Iterator[None]:
    """Turn an error of the system while a file is written into one that names the file.

    Raises:
        TargetError: the file or its folder cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise TargetError(f"{target}: {error.strerror or error}") from error


def sync_file(path: Path) -> None:
    """Make what is in a file durable, where the system can.

    Raises:
        TargetError: it cannot be written, as when the disk is full.
    """
    with target_errors(path), path.open("rb") as stream:
        os.fsync(stream.fileno())


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable, where the system can."""
    with suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def partial_of(target: Path, suffix: str = "", mark: str = "") -> Path:
    """The hidden name next to a target under which this process writes it.

    Args:
        target: the file or folder.
        suffix: how the name is to end, for libraries that go by it; by default as no file that is searched for does.
        mark: a text of one writer alone, where processes of other machines, whose numbers may be the same, write there.
    """
    return target.with_name(f".{target.name}.{mark or os.getpid()}.partial{suffix}")


def remove_dead_partials(target: Path) -> None:
    """Remove what processes that are no more left unfinished under the hidden names next to a target.

    Their numbers are in the names. A file whose number a living process has stays, even where that is another one by
    now; so do the files of other targets.
    """
    name = re.compile(rf"\.{re.escape(target.name)}\.(\d+)\.partial({re.escape(target.suffix)})?")
    with suppress(OSError):
        for path in target.parent.iterdir():
            found = name.fullmatch(path.name)
            if found and path.is_file() and not path.is_symlink() and not _is_alive(int(found[1])):
                path.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    """Whether a process has this number."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return process > 0


@contextmanager
def completing(target: Path, *, force: bool = True, mark: str = "") -> Iterator[Path]:
    """A name next to the target to write to, which becomes the target where the block ends without an error.

    Args:
        target: the file.
        force: replace a file that appeared there in the meantime.
        mark: of this writer alone, where other machines write to the same folder.

    Raises:
        TargetError: the folder or the file cannot be written, or may not be.
    """
    require_plain(target)
    temporary = partial_of(target, target.suffix, mark)
    try:
        with target_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            if target.exists() and not force:
                raise TargetError(f"{target}: written by another program; pass --force (force=True) to overwrite it")
            temporary.replace(target)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextmanager
def completing_folder(target: Path, keep: Callable[[Path], bool] = lambda _: False) -> Iterator[Path]:
    """A hidden folder to fill, which takes the target's place where the block ends without an error.

    Args:
        target: the folder; what stands there goes.
        keep: whether something that lies in it stays.

    Raises:
        TargetError: it cannot be made, or put there.
    """
    place = target.resolve()
    hidden = partial_of(place)
    former = hidden.with_suffix(".former")
    try:
        with target_errors(target):
            hidden.mkdir(parents=True)
            yield hidden
            if place.exists():
                place.rename(former)
            hidden.rename(place)
            for entry in [*former.iterdir()] if former.exists() else []:
                if keep(entry):
                    entry.rename(place / entry.name)
    finally:
        shutil.rmtree(hidden, ignore_errors=True)
        if former.exists() and not place.exists():
            former.rename(place)
        elif former.exists() and not any(map(keep, former.iterdir())):
            shutil.rmtree(former, ignore_errors=True)


class PartialFile(AbstractContextManager[Any], Protocol):
    """A file under a hidden name while it is written: the end of its context names it, or removes it after an error."""

    def complete(self) -> None:
        """Write what is still to be written: then nothing is left but to give the file its name."""

    def discard(self) -> None:
        """Remove what is not complete."""


@contextmanager
def all_or_none(*outputs: PartialFile) -> Iterator[None]:
    """Open outputs that get their names when all are complete: a disk that is full is full for all of them.

    Nothing half written stays, even where a signal comes while an output is being opened.
    """
    with ExitStack() as stack:
        for output in outputs:
            stack.callback(output.discard)
        for output in outputs:
            stack.enter_context(output)
        yield
        for output in outputs:
            output.complete()
