"""Files: read up to a size; written without replacing a file unless forced, and under their names only if complete."""

import errno
import os
import re
import shlex
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, BinaryIO, Final, Protocol

from roadperc_stream.errors import TargetError

TABLE_SUFFIX: Final = ".parquet"
METRICS_SUFFIX: Final = ".metrics.parquet"
OBJECTS_SUFFIX: Final = ".objects.parquet"
BAG_METADATA: Final = "metadata.yaml"
_LOG_NAMES: Final = ("*.mcap", "*.db3", "*.bag", "*.mcap.zst*", "*.db3.zst*")


def open_file(path: Path) -> BinaryIO:
    """Open a regular file to read it. A pipe may block, and a device may have no end.

    Raises:
        OSError: it cannot be read, or is something else; ``strerror`` is the reason.
    """
    try:
        stream = open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK))  # noqa: SIM115
    except IsADirectoryError as error:
        raise OSError(errno.EISDIR, "is a folder, expected a file", str(path)) from error
    except ValueError as error:
        raise OSError(errno.EINVAL, f"is not a name of a file: {error}", str(path)) from error
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        raise OSError(errno.EINVAL, "is a pipe or a device, expected a file", str(path))
    return stream


def read_file(path: Path, most_bytes: int) -> bytes:
    """The content of a regular file.

    Raises:
        OSError: it cannot be read, is something else, or is larger; ``strerror`` is the reason.
    """
    with open_file(path) as stream:
        is_large = os.fstat(stream.fileno()).st_size > most_bytes
        data = b"" if is_large else stream.read(most_bytes + 1)
    if is_large or len(data) > most_bytes:
        raise OSError(errno.EFBIG, f"is larger than {most_bytes / 1e6:g} MB", str(path))
    return data


def require_free(target: Path, *, force: bool, suffix: str, source: Path | None = None) -> None:
    """Check that a file may be written.

    ``force`` allows to replace an existing file, but never ``source``, the input. ``suffix`` is the required end of its
    name.

    Raises:
        TargetError: it may not be written.
    """
    require_plain(target)
    require_suffix(target, suffix)
    if source is not None and target.exists() and source.exists() and target.samefile(source):
        raise TargetError(f"{target}: is the input; name another output")
    if target.exists() and not force:
        raise TargetError(f"{target}: exists", "--force", "to overwrite it")


def require_plain(target: Path) -> None:
    """Check that a path is a file or does not exist: links and devices would be replaced instead of written to.

    Raises:
        TargetError: it is something else, or not UTF-8, which some libraries need.
    """
    if os.fsencode(target).decode("utf-8", "replace") != str(target):
        raise TargetError(f"{str(target)!a}: expected a name in UTF-8")
    if target.is_symlink():
        raise TargetError(f"{target}: is a link; name the file that it points to")
    if target.is_dir():
        raise TargetError(f"{target}: is a folder, expected the name of a file")
    if target.exists() and not target.is_file():
        raise TargetError(f"{target}: is a device or a pipe, expected the name of a file")


def require_suffix(target: Path, *suffixes: str) -> None:
    """Check the suffix of an output, so that no log or table is replaced by another kind of file.

    Raises:
        TargetError: the suffix is not one of ``suffixes``.
    """
    if target.suffix.lower() not in suffixes:
        raise TargetError(f"{target}: expected a name that ends in {' or '.join(suffixes)}")


def make_private(folder: Path) -> None:
    """Make a folder that only this user can enter, or check that it is one; links are not followed.

    Raises:
        TargetError: it cannot be made, or other users own it or can enter it.
    """
    with target_errors(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        facts = folder.lstat()
    if not stat.S_ISDIR(facts.st_mode) or facts.st_uid != os.geteuid() or facts.st_mode & 0o077:
        problem = "expected a folder of this user with mode 700; remove it, or name another with --scratch"
        raise TargetError(f"{folder}: {problem}")


def is_bag_folder(path: Path) -> bool:
    """Whether a path is the folder of a ROS 2 bag."""
    return os.path.isfile(path / BAG_METADATA)  # noqa: PTH113 - false for a folder that cannot be read


def not_a_log(folder: Path) -> str:
    """The error for a folder instead of a log: names the logs in it, or the command that converts a dump."""
    pattern = next((pattern for pattern in _LOG_NAMES if any(folder.glob(pattern))), "")
    if pattern:
        logs = sorted(folder.glob(pattern))
        files = f", or all {len(logs)} files of one log: {folder}/{pattern}" if len(logs) > 1 else ""
        return f"{folder}: is a folder, expected a log, such as {logs[0]}{files}"
    target = f"{folder if folder.name.strip('.') else folder.resolve().name}.mcap"
    command = shlex.join(("roadperc-convert", str(folder), target))
    return f"{folder}: is a folder, expected a log; convert frames or a dataset with: {command}"


def real_path(path: Path) -> Path:
    """The absolute path without links; unlike pathlib, no error for links in a circle."""
    return Path(os.path.realpath(path))


def is_inside(path: Path, folder: Path) -> bool:
    """Whether a path is below a folder, with the links in both resolved."""
    try:
        return real_path(path).is_relative_to(real_path(folder))
    except ValueError:  # no name of a file
        return False


@contextmanager
def target_errors(target: Path) -> Iterator[None]:
    """Turn an error of the system into an error that names the file.

    Raises:
        TargetError: the file or its folder cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise TargetError(f"{target}: {error.strerror or error}") from error


def partial_of(target: Path, suffix: str = "", mark: str = "") -> Path:
    """The hidden path next to a target where this process writes it: its partial file.

    Args:
        target: the file or folder.
        suffix: suffix for libraries that need it; by default a suffix that no command reads.
        mark: unique text instead of the process number, for folders shared with other machines.
    """
    return target.with_name(f".{target.name}.{mark or os.getpid()}.partial{suffix}")


def remove_stale_partials(target: Path) -> None:
    """Remove the partial files and folders of a target whose processes have ended; all writers call it first.

    The names contain the process numbers. A file stays if any process has its number now.
    """
    name = re.compile(rf"\.{re.escape(target.name)}\.(\d+)\.partial(\.\w+)?")
    with suppress(OSError):
        for path in target.parent.iterdir():
            found = name.fullmatch(path.name)
            if not found or path.is_symlink() or _is_alive(int(found[1])):
                continue
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path.is_file():
                path.unlink(missing_ok=True)


@contextmanager
def scratch_folder(target: Path) -> Iterator[Path]:
    """A hidden folder beside a target for files that are needed only during the block.

    Raises:
        TargetError: it cannot be made.
    """
    with target_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        remove_stale_partials(target)
        folder = Path(mkdtemp(prefix=f"{partial_of(target).name}.", dir=target.parent))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


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
    """A partial file, which is renamed to the target if the block ends without an error.

    ``force`` replaces a file that another program wrote during the block. ``mark`` is as in ``partial_of``.

    Raises:
        TargetError: the folder or the file cannot or may not be written.
    """
    require_plain(target)
    temporary = partial_of(target, target.suffix, mark)
    try:
        with target_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            if not mark:
                remove_stale_partials(target)
            yield temporary
            if target.exists() and not force:
                raise TargetError(f"{target}: written by another program", "--force", "to overwrite it")
            temporary.replace(target)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_whole(target: Path, content: bytes | str, *, force: bool = True) -> None:
    """Write a file, texts in UTF-8; it gets its name when it is complete.

    Raises:
        TargetError: as ``completing``.
    """
    with completing(target, force=force) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def completing_folder(target: Path, keep: Callable[[Path], bool] = lambda _: False) -> Iterator[Path]:
    """A hidden folder, which replaces the target if the block ends without an error.

    The target's earlier content is removed; an entry stays if ``keep`` says so.

    Raises:
        TargetError: the folder cannot be written.
    """
    place = target.resolve()
    hidden = partial_of(place)
    former = hidden.with_suffix(".former")
    try:
        with target_errors(target):
            remove_stale_partials(place)
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
    """A partial file: the end of its context renames it to its target, or removes it after an error."""

    def complete(self) -> None:
        """Write the rest, so that only the renaming can fail."""

    def discard(self) -> None:
        """Remove the partial file."""


@contextmanager
def all_or_none(*outputs: PartialFile) -> Iterator[None]:
    """Open outputs, and rename them to their targets when all are complete.

    No partial file stays after an error, even if a signal arrives while an output is opened.
    """
    with ExitStack() as stack:
        for output in outputs:
            stack.callback(output.discard)
        for output in outputs:
            stack.enter_context(output)
        yield
        for output in outputs:
            output.complete()
