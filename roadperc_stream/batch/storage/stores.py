"""Files of a store: whole or not at all, by requests that are tried again, with errors of one line."""

import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import IO, Any, Final, TypeVar

from roadperc_stream.batch.storage.addresses import Parts, scheme_of
from roadperc_stream.batch.storage.disk import PIECE_BYTES, StoredFile, changed, disk_errors, fingerprint, pieces_of
from roadperc_stream.errors import RoadpercError, StorageError
from roadperc_stream.system.files import target_errors

Result = TypeVar("Result")
_CREDENTIALS: Final = ("AWS_ACCESS_KEY_ID", "AWS_PROFILE", "AWS_ROLE_ARN", "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI")
_PLAIN_CAUSES: Final[Mapping[str, str]] = {
    "NO_SUCH_BUCKET": "no such bucket",
    "ACCESS_DENIED": "access denied",
    "INVALID_ACCESS_KEY_ID": "access denied: the store does not know this access key",
    "SIGNATURE_DOES_NOT_MATCH": "access denied: the secret key is not that of the access key",
    "curlCode: 6": "the store's name does not resolve",
    "curlCode: 7": "the store takes no connection",
    "curlCode: 28": "the store does not answer",
    "Could not create a OAuth2 access token": "no credentials (GOOGLE_APPLICATION_CREDENTIALS)",
}
"""Marks in the clients' messages, and what they mean."""
_FINAL: Final = ("NO_SUCH_", "ACCESS_DENIED", "INVALID_", "SIGNATURE_DOES_NOT_MATCH", "EXPIRED", "HTTP status 3")
"""Marks of what the next try would find again."""
WAITS_S: Final = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Before each further try; the store's client has tried three times in each of them."""
_UNTOLD: Final = re.compile(r" \(Request ID: [^)]*\)|^When .*?(?=AWS Error )")
_LONGEST_CAUSE: Final = 300
_TIMES: Final = ("mtime", "LastModified", "last_modified", "updated", "modified", "created")
"""What the clients call the time of a file's last change."""


@dataclass(frozen=True)
class Store:
    """A file or a folder of a store; every method raises a StorageError where the store does not do it.

    Attributes:
        system: a file system of fsspec's.
        path: bucket and name, as the file system wants them.
        address: with the scheme.
    """

    system: Any
    path: str
    address: str

    @classmethod
    def of(cls, address: str) -> "Store":
        """The store that an address is in.

        Raises:
            StorageError: nothing that is installed knows the scheme, or the bucket's region cannot be found.
        """
        with store_errors(address):
            from roadperc_stream.batch.storage.clients import system_of

            return cls(*system_of(address), address)

    def file(self) -> StoredFile | None:
        """The file of this name; None for a folder, and where there is nothing."""
        with store_errors(self.address):
            try:
                return _stored(self.address, self.system.info(self.path))
            except FileNotFoundError:
                return None

    def is_folder(self) -> bool:
        """Whether there is any file below this name."""
        return any(True for _ in self.files_below(()))

    def files_below(self, pattern: Parts) -> Iterator[tuple[Parts, StoredFile]]:
        """The files of this folder, in no order, with their names from there on; none where there is no such folder.

        It is one listing.

        Args:
            pattern: where it stands for files of the folder itself alone, its folders are not listed.
        """
        depth = 1 if len(pattern) == 1 and pattern[0].endswith(".mcap") else None
        with store_errors(self.address):
            listed = self.system.find(self.path, maxdepth=depth, detail=True)
        start = f"{self.path.rstrip('/')}/"
        for path, info in listed.items():
            name = path.removeprefix(start)
            stored = _stored(f"{self.address}/{name}", info)
            if name != path and stored is not None:
                yield tuple(name.split("/")), stored

    def read(self) -> bytes | None:
        """All of the file, None where there is none."""
        with store_errors(self.address):
            try:
                data: bytes = self.system.cat_file(self.path)
            except FileNotFoundError:
                return None
        return data

    def write(self, data: bytes) -> None:
        """Write the file, which appears, or replaces another one, whole or not at all."""
        tried(partial(self._upload, lambda: [data], len(data)))

    def put(self, source: Path) -> None:
        """Move a file of this machine here."""
        with disk_errors(str(source)):
            size_bytes = source.stat().st_size
        tried(partial(self._upload, partial(pieces_of, str(source)), size_bytes))
        with target_errors(source):
            source.unlink(missing_ok=True)

    def remove(self) -> None:
        """Remove the file of this very name; it need not exist."""
        with store_errors(self.address), suppress(FileNotFoundError):
            self.system.rm_file(self.path)

    def copy_to(self, target: IO[bytes]) -> None:
        """Write all of the file to a stream, in pieces; a connection that breaks is taken up behind the last one.

        Raises:
            StorageError: it cannot be read, or changed meanwhile.
        """
        before = tried(self._identity)
        while target.tell() < before[0]:
            target.write(tried(partial(self._piece, target.tell(), before)))
        tried(partial(self._require, before))

    def _identity(self) -> tuple[int, str]:
        """The size of the file, and what differs when it does."""
        with store_errors(self.address):
            self.system.invalidate_cache()
            return self.system.info(self.path)["size"], self.system.ukey(self.path)

    def _require(self, before: tuple[int, str]) -> None:
        if self._identity() != before:
            raise changed(self.address)

    def _piece(self, start: int, before: tuple[int, str]) -> bytes:
        end = min(start + PIECE_BYTES, before[0])
        try:
            with store_errors(self.address):
                data: bytes = self.system.cat_file(self.path, start=start, end=end)
                if len(data) < end - start:
                    raise OSError(f"ends at byte {start + len(data)}, expected {before[0]}")
        except StorageError:
            self._require(before)
            raise
        return data

    def _upload(self, pieces: Callable[[], Iterable[bytes]], size_bytes: int) -> None:
        """Write a file in pieces.

        A stream that is closed makes a file of what it was given, even where an error closes it: then what is not whole
        goes. Where it is the store that failed, closing fails too, and what was there before stays: S3's client
        remembers a failure as long as it writes in the background. It is waited for after each piece, or all of a file
        that is faster read than sent would be in memory.
        """
        with store_errors(self.address):
            stream = self.system.open(self.path, "wb")
        try:
            for piece in pieces():
                with store_errors(self.address):
                    stream.write(piece)
                    stream.flush()
            with store_errors(self.address):
                stream.close()
        except BaseException:
            with suppress(Exception):
                is_whole = stream.closed or stream.tell() == size_bytes
                stream.close()
                if not is_whole:
                    self.system.rm_file(self.path)
            raise


@contextmanager
def store_errors(address: str) -> Iterator[None]:
    """What a store or its client says, as one line that names the address.

    Raises:
        StorageError: whatever was raised: the clients of the many schemes have no error in common.
    """
    try:
        yield
    except RoadpercError:
        raise
    except Exception as error:
        raise StorageError(f"{address}: {_cause(address, error)}") from error


def tried(action: Callable[[], Result]) -> Result:
    """What an action gives, where need be after some tries with growing waits.

    Raises:
        StorageError: of the last try, or what another one would find again.
    """
    for wait_s in WAITS_S:
        try:
            return action()
        except StorageError as error:
            cause = error.__cause__
            is_missing = cause is None or isinstance(cause, FileNotFoundError | PermissionError)
            if is_missing or any(mark in str(cause) for mark in _FINAL):
                raise
            time.sleep(wait_s)
    return action()


def _cause(address: str, error: Exception) -> str:
    said = _UNTOLD.sub("", " ".join(str(error).split())) or type(error).__name__
    said = said if len(said) <= _LONGEST_CAUSE else f"{said[:_LONGEST_CAUSE]}…"
    plain = next((words for mark, words in _PLAIN_CAUSES.items() if mark in str(error)), "")
    if plain == "access denied" and scheme_of(address) == "s3" and not any(map(os.environ.get, _CREDENTIALS)):
        plain += ", and no credentials in the environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY)"
    if isinstance(error, FileNotFoundError):
        return "no such file"
    return f"{plain} ({said})" if plain else said


def _stored(address: str, info: Mapping[str, Any]) -> StoredFile | None:
    modified = next((info[name] for name in _TIMES if info.get(name)), None)
    modified = modified.timestamp() if isinstance(modified, datetime) else modified
    is_file = info["type"] == "file"
    return StoredFile(address, info["size"], fingerprint(info["size"], modified)) if is_file else None
