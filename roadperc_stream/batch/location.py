"""Files and folders of this machine or of a store: find, read, write, copy. An error is one line with the address."""

import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from textwrap import shorten
from typing import Any, Final
from uuid import uuid4

from fsspec.utils import glob_translate

from roadperc_stream.batch.addresses import is_address, natural, split_pattern, whole
from roadperc_stream.batch.stores import system_of
from roadperc_stream.errors import RoadpercError, StorageError
from roadperc_stream.system.files import completing, require_plain

_LOG_SUFFIX: Final = ".mcap"
_PIECE_BYTES: Final = 16 << 20
"""Files are fetched and sent in pieces of this size; the client repeats a failed piece."""
_LONGEST_CAUSE: Final = 300
_TIMES: Final = ("mtime", "LastModified", "last_modified", "updated", "modified", "created")
"""The clients' names for the modification time of a file."""


@dataclass(frozen=True)
class StoredFile:
    """A file that was found: its absolute path or address, its size, and a text that changes with its content.

    ``fingerprint`` is ``size_bytes:modification_time``.
    """

    address: str
    size_bytes: int
    fingerprint: str


@dataclass(frozen=True)
class Location:
    """A file or a folder, which need not exist; other processes and machines can use it.

    ``address`` is the absolute path or the address; a relative path starts at the current folder. All methods raise a
    StorageError if this machine or the store refuses.
    """

    address: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "address", whole(self.address))

    @property
    def is_local(self) -> bool:
        """Whether it is on this machine, or mounted here."""
        return not is_address(self.address)

    def at(self, name: str) -> "Location":
        """A file or a folder below this one."""
        return Location(f"{self.address.rstrip('/')}/{name}")

    def file(self) -> StoredFile | None:
        """The file of this name; None for a folder, and if nothing has this name."""
        with _errors(self.address), suppress(FileNotFoundError, NotADirectoryError):
            system, path = system_of(self.address)
            return _stored(self.address, system.info(path))
        return None

    def files(self, suffix: str, pattern: str = "") -> dict[str, StoredFile]:
        """The files below this folder, which need not exist, by their relative names: log2 before log10.

        A store is listed once. Hidden files and folders are left out.

        Args:
            suffix: the suffix of the names; case does not matter.
            pattern: a glob for the names or for a folder above.
        """
        depth = 1 if pattern.endswith(_LOG_SUFFIX) and "/" not in pattern else None
        files = dict[str, StoredFile]()
        with _errors(self.address):
            system, base = system_of(self.address)
            form = re.compile(glob_translate(pattern)) if pattern else None
            for path, info in system.find(base, maxdepth=depth, detail=True).items():
                name = path.removeprefix(f"{base.rstrip('/')}/")
                is_match = path != name and name.lower().endswith(suffix) and _matches(name, form)
                if is_match and (stored := _stored(self.at(name).address, info)):
                    files[name] = stored
        return dict(sorted(files.items(), key=lambda item: natural(item[0])))

    def read(self) -> bytes | None:
        """The content of the file, None if it does not exist."""
        with _errors(self.address), suppress(FileNotFoundError, NotADirectoryError):
            system, path = system_of(self.address)
            return bytes(system.cat_file(path))
        return None

    def write(self, data: bytes) -> None:
        """Write or replace a small file, whole or not at all."""
        with _errors(self.address):
            system, path = system_of(self.address)
            system.pipe_file(path, data)

    def put(self, source: Path) -> None:
        """Move a file of this machine here."""
        with _errors(self.address):
            if self.is_local:
                _move(source, Path(self.address))
                return
            system, path = system_of(self.address)
            with source.open("rb") as stream, _complete_or_absent(system, path) as target:
                while piece := stream.read(_PIECE_BYTES):
                    target.write(piece)
                    target.flush()  # S3's client sends in the background: without this, memory grows with the file
            source.unlink()

    def remove(self) -> None:
        """Remove the file if it exists."""
        with _errors(self.address), suppress(FileNotFoundError):
            system, path = system_of(self.address)
            system.rm_file(path)

    def fetch(self, target: Path) -> None:
        """Copy the file to this machine, whole or not at all.

        Raises:
            StorageError: it cannot be read, or it changed during the copy.
            TargetError: the target cannot be written.
        """
        with completing(target, mark=uuid4().hex) as hidden, _errors(self.address):
            system, path = system_of(self.address)
            before = system.ukey(path)
            with system.open(path, "rb") as source, hidden.open("wb") as stream:
                shutil.copyfileobj(source, stream, _PIECE_BYTES)
            system.invalidate_cache()
            if (system.ukey(path), system.info(path)["size"]) != (before, hidden.stat().st_size):
                raise StorageError(f"{self.address}: changed while it was read; run the command again")


def find_files(pattern: str) -> list[StoredFile]:
    """The files that a text names, log2 before log10.

    Args:
        pattern: a file of any suffix; a folder, for all logs below it; or a glob with ``*``, ``?``, ``[..]`` and
            ``**``, for logs and folders. Hidden files and folders are not found.

    Raises:
        StorageError: nothing was found, or the place cannot be read.
    """
    address = whole(pattern)
    if (exact := Location(address).file()) is not None:
        return [exact]
    base, pattern = split_pattern(address)
    found = list(Location(base).files(_LOG_SUFFIX, pattern).values())
    if not found:
        why = f"no {_LOG_SUFFIX} file matches" if pattern else f"no such file, and no {_LOG_SUFFIX} file below it"
        hint = "; pass ROS bags and compressed logs by their names" if Path(address).is_dir() else ""
        raise StorageError(f"{address}: {why}{hint}")
    return found


def _matches(name: str, form: re.Pattern[str] | None) -> bool:
    """Whether a pattern matches a name or a folder above it, and nothing of it is hidden."""
    parts = name.split("/")
    if any(part.startswith(".") for part in parts):
        return False
    return form is None or any(form.match("/".join(parts[:length])) for length in range(1, len(parts) + 1))


def _move(source: Path, target: Path) -> None:
    """Rename a file of this machine, or copy it to another disk."""
    require_plain(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        source.replace(target)
    except OSError:  # another disk
        with completing(target, mark=uuid4().hex) as hidden:
            shutil.copyfile(source, hidden)
        source.unlink()


@contextmanager
def _complete_or_absent(system: Any, path: str) -> Iterator[Any]:
    """A new file of a store. After an error it is closed, which completes it, and removed.

    If it cannot be closed, as after an error of S3's client, it is not completed, and an earlier file stays.
    """
    stream = system.open(path, "wb")
    try:
        yield stream
    except BaseException:
        with suppress(Exception):
            stream.close()
            system.rm_file(path)
        raise
    stream.close()


@contextmanager
def _errors(address: str) -> Iterator[None]:
    """Turn errors of the system, a store or its client into one line with the address.

    Raises:
        StorageError: for any exception, because the clients of the many schemes share no base class.
    """
    try:
        yield
    except RoadpercError:
        raise
    except FileNotFoundError as error:
        raise StorageError(f"{address}: no such file") from error
    except Exception as error:
        reason = error.strerror if isinstance(error, OSError) else None
        cause = shorten(reason or str(error), _LONGEST_CAUSE, placeholder="…") or type(error).__name__
        raise StorageError(f"{getattr(error, 'filename', None) or address}: {cause}") from error


def _stored(address: str, info: Mapping[str, Any]) -> StoredFile | None:
    """A file from fsspec's facts; None for a folder. A file without a modification time has a random fingerprint."""
    modified = next((info[name] for name in _TIMES if info.get(name) is not None), uuid4().hex)
    modified = modified.timestamp() if isinstance(modified, datetime) else modified
    is_file = info["type"] == "file"
    return StoredFile(address, info["size"], f"{info['size']}:{modified}") if is_file else None
