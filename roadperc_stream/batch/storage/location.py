"""Files and folders of this machine or of a store: find, read, write, copy.

A failed request to a store is retried. An error is one line with the address.
"""

import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from textwrap import shorten
from typing import Any, Final, TypeVar
from uuid import uuid4

from roadperc_stream.batch.storage.addresses import Parts, is_address, natural, remainders, split_pattern, whole
from roadperc_stream.batch.storage.stores import PIECE_BYTES, move, system_of, upload
from roadperc_stream.errors import RoadpercError, StorageError
from roadperc_stream.system.files import completing

Result = TypeVar("Result")
WAITS_S: Final = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Waits before the retries; the store's client makes three attempts in each."""
_LOG_SUFFIX: Final = ".mcap"
_CREDENTIALS: Final = ("AWS_ACCESS_KEY_ID", "AWS_PROFILE", "AWS_ROLE_ARN", "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI")
_PLAIN_CAUSES: Final[Mapping[str, str]] = {
    "NO_SUCH_BUCKET": "no such bucket",
    "ACCESS_DENIED": "access denied",
    "INVALID_ACCESS_KEY_ID": "access denied: the store does not know this access key",
    "SIGNATURE_DOES_NOT_MATCH": "access denied: the secret key does not belong to the access key",
    "curlCode: 6": "the store's name does not resolve",
    "curlCode: 7": "the store refuses the connection",
    "curlCode: 28": "the store does not answer",
    "Could not create a OAuth2 access token": "no credentials; set GOOGLE_APPLICATION_CREDENTIALS",
}
"""Marks in the clients' messages, and their meanings."""
_FINAL: Final = ("NO_SUCH_", "ACCESS_DENIED", "INVALID_", "SIGNATURE_DOES_NOT_MATCH", "EXPIRED", "HTTP status 3")
"""Marks of errors that a retry cannot fix."""
_NOISE: Final = re.compile(r" \(Request ID: [^)]*\)|^When .*?(?=AWS Error )")
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

    def files(self, suffix: str, pattern: Parts = ()) -> dict[str, StoredFile]:
        """The files below this folder, which need not exist, by their relative names: log2 before log10.

        A store is listed once.

        Args:
            suffix: the suffix of the names; case does not matter.
            pattern: matches the names or a folder above; only a part with a dot matches hidden files.
        """
        depth = 1 if len(pattern) == 1 and pattern[0].endswith(_LOG_SUFFIX) else None
        files = dict[str, StoredFile]()
        with _errors(self.address):
            system, base = system_of(self.address)
            found = system.walked(base, pattern) if self.is_local else system.find(base, depth, detail=True).items()
            for path, info in found:
                name = path.removeprefix(f"{base.rstrip('/')}/")
                is_match = name.lower().endswith(suffix) and () in remainders(pattern, name.split("/"))
                if path != name and is_match and (stored := _stored(self.at(name).address, info)):
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
        self._retried(lambda system, path: system.pipe_file(path, data))

    def put(self, source: Path) -> None:
        """Move a file of this machine here, whole or not at all."""
        self._retried(partial(move if self.is_local else upload, source))
        source.unlink(missing_ok=True)

    def remove(self) -> None:
        """Remove the file if it exists."""
        with _errors(self.address), suppress(FileNotFoundError):
            system, path = system_of(self.address)
            system.rm_file(path)

    def fetch(self, target: Path) -> None:
        """Copy the file to this machine, whole or not at all; a broken connection repeats only the current piece.

        Raises:
            StorageError: it cannot be read, or it changed during the copy.
            TargetError: the target cannot be written.
        """
        with completing(target, mark=uuid4().hex) as hidden, hidden.open("wb") as stream:
            size_bytes, _ = before = self._retried(_identity)
            try:
                for start in range(0, size_bytes, PIECE_BYTES):
                    piece = partial(_piece, start=start, end=min(start + PIECE_BYTES, size_bytes))
                    stream.write(self._retried(piece))
            except StorageError:
                self._require(before)
                raise
            self._require(before)

    def _require(self, before: tuple[int, str]) -> None:
        if self._retried(_identity) != before:
            raise StorageError(f"{self.address}: changed while it was read; run the command again")

    def _retried(self, action: Callable[[Any, str], Result]) -> Result:
        """The result of an action, which takes file system and path; retried if a store fails."""
        waits_s = iter(() if self.is_local else WAITS_S)
        while True:
            try:
                with _errors(self.address):
                    return action(*system_of(self.address))
            except StorageError as error:
                wait_s = next(waits_s, None)
                if wait_s is None or _is_final(error.__cause__):
                    raise
                time.sleep(wait_s)


def find_files(pattern: str) -> list[StoredFile]:
    """The files that a text names, log2 before log10.

    Args:
        pattern: a file of any suffix; a folder, for all logs below it; or a glob with ``*``, ``?``, ``[..]`` and
            ``**``. Hidden files and folders match only a part that begins with a dot.

    Raises:
        StorageError: nothing was found, or the place cannot be read.
    """
    address = whole(pattern)
    if (exact := Location(address).file()) is not None:
        return [exact]
    base, parts = split_pattern(address)
    found = list(Location(base).files(_LOG_SUFFIX, parts).values())
    if not found:
        why = f"no {_LOG_SUFFIX} file matches" if parts else f"no such file, and no {_LOG_SUFFIX} file below it"
        hint = "; pass ROS bags and compressed logs by their names" if Path(address).is_dir() else ""
        raise StorageError(f"{address}: {why}{hint}")
    return found


def _identity(system: Any, path: str) -> tuple[int, str]:
    """The size of a file, and a text that changes with the file."""
    system.invalidate_cache()
    return system.info(path)["size"], system.ukey(path)


def _piece(system: Any, path: str, start: int, end: int) -> bytes:
    data: bytes = system.cat_file(path, start=start, end=end)
    if len(data) < end - start:
        raise OSError(f"ends at byte {start + len(data)}, expected {end} or more")
    return data


def _is_final(cause: BaseException | None) -> bool:
    is_missing = cause is None or isinstance(cause, FileNotFoundError | PermissionError)
    return is_missing or any(mark in str(cause) for mark in _FINAL)


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
    except Exception as error:
        raise StorageError(f"{address}: {_cause(address, error)}") from error


def _cause(address: str, error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return "no such file"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    text = shorten(_NOISE.sub("", str(error)), _LONGEST_CAUSE, placeholder="…") or type(error).__name__
    plain = next((words for mark, words in _PLAIN_CAUSES.items() if mark in str(error)), "")
    if plain == "access denied" and address.startswith("s3://") and not any(map(os.environ.get, _CREDENTIALS)):
        plain += ", and no credentials in the environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY)"
    return f"{plain} ({text})" if plain else text


def _stored(address: str, info: Mapping[str, Any]) -> StoredFile | None:
    """A file from fsspec's facts; None for a folder. A file without a modification time has a random fingerprint."""
    modified = next((info[name] for name in _TIMES if info.get(name) is not None), uuid4().hex)
    modified = modified.timestamp() if isinstance(modified, datetime) else modified
    is_file = info["type"] == "file"
    return StoredFile(address, info["size"], f"{info['size']}:{modified}") if is_file else None
