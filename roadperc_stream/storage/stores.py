"""Files of a store, by pyarrow's file systems and, for other schemes, by fsspec's.

Both are imported when a store is first asked for: most commands know only this machine's files.
"""

import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from functools import lru_cache
from typing import Any, Final, TypeVar
from urllib.parse import urlsplit

from roadperc_stream.errors import RoadpercError, StorageError
from roadperc_stream.storage.addresses import scheme_of
from roadperc_stream.storage.patterns import Parts
from roadperc_stream.storage.stored import StoredFile, fingerprint

Result = TypeVar("Result")
_RETRY_S: Final = 10
"""How long Google's client tries one request, instead of its quarter of an hour."""
_TIMEOUTS_S: Final[Mapping[str, float]] = {"connect_timeout": 5.0, "request_timeout": 10.0}
"""Of S3's client, which tries three times: its own one second and three are too few for a store that is busy."""
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
"""Before each further try of what has begun well; the store's client has tried three times in each of them."""
_UNTOLD: Final = re.compile(r" \(Request ID: [^)]*\)|^When .*?(?=AWS Error )")
_LONGEST_CAUSE: Final = 300


@dataclass(frozen=True)
class Store:
    """A file system and the name of something within it.

    Attributes:
        system: a file system of pyarrow's.
        path: bucket and name, as the file system wants them.
        address: with the scheme.
    """

    system: Any
    path: str
    address: str

    def file(self) -> StoredFile | None:
        """The file of this name; None for a folder, and where there is nothing.

        Raises:
            StorageError: the store cannot be asked.
        """
        with store_errors(self.address):
            return _stored(self.address, self.system.get_file_info([self.path])[0])

    def files_below(self, *, deep: bool) -> Iterator[tuple[Parts, StoredFile]]:
        """The files of this folder, in no order, with their names from there on; none where there is no such folder.

        Args:
            deep: those of its folders too. It is one listing either way.

        Raises:
            StorageError: the store cannot be asked, or has no such bucket.
        """
        start = len(self.path.rstrip("/")) + 1
        for info in self._listed(deep=deep):
            name = info.path[start:]
            stored = _stored(f"{self.address}/{name}", info)
            if stored is not None:
                yield tuple(name.split("/")), stored

    def _listed(self, *, deep: bool) -> list[Any]:
        from pyarrow.fs import FileSelector

        with store_errors(self.address):
            try:
                listed: list[Any] = self.system.get_file_info(FileSelector(self.path, recursive=deep))
            except FileNotFoundError:
                return []
        return listed


def store_of(address: str) -> Store:
    """The store that an address is in.

    Raises:
        StorageError: nothing that is installed knows the scheme, or the bucket's region cannot be found.
    """
    scheme, path = scheme_of(address), address.partition("://")[2]
    if scheme == "s3":
        return Store(_s3(path.split("/")[0], address), path, address)
    if scheme in {"gs", "gcs"}:
        return Store(_google(), path, address)
    from roadperc_stream.storage.fsspec_stores import open_by_fsspec

    return Store(*open_by_fsspec(address), address)


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
            if _is_final(error):
                raise
            time.sleep(wait_s)
    return action()


def _is_final(error: StorageError) -> bool:
    cause = error.__cause__
    return (
        cause is None
        or isinstance(cause, FileNotFoundError | PermissionError)
        or any(mark in str(cause) for mark in _FINAL)
    )


def _cause(address: str, error: Exception) -> str:
    said = _UNTOLD.sub("", " ".join(str(error).split())) or type(error).__name__
    said = said if len(said) <= _LONGEST_CAUSE else f"{said[:_LONGEST_CAUSE]}…"
    plain = next((words for mark, words in _PLAIN_CAUSES.items() if mark in str(error)), "")
    if plain == "access denied" and scheme_of(address) == "s3" and not any(map(os.environ.get, _CREDENTIALS)):
        plain += ", and no credentials in the environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY)"
    if isinstance(error, FileNotFoundError):
        return "no such file"
    return f"{plain} ({said})" if plain else said


def _stored(address: str, info: Any) -> StoredFile | None:
    return StoredFile(address, info.size, fingerprint(info.size, info.mtime_ns)) if info.is_file else None


def _s3(bucket: str, address: str) -> Any:
    """The file system of a bucket, by the environment's settings.

    pyarrow's S3FileSystem reads keys from the environment or ``~/.aws``, but neither endpoint nor region as the
    stores' own programs do.
    """
    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or ""
    region = os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION") or ""
    keys = tuple(sorted(item for item in os.environ.items() if item[0].startswith("AWS_")))
    with store_errors(address):
        return _s3_system("" if endpoint or region else bucket, endpoint, region, keys)


@lru_cache(maxsize=16)
def _s3_system(bucket: str, endpoint: str, region: str, environment: tuple[tuple[str, str], ...]) -> Any:
    """A client for all files, as it keeps connections open; another one where the environment is another."""
    from pyarrow.fs import S3FileSystem, resolve_s3_region

    given: dict[str, Any] = {"region": region or (resolve_s3_region(bucket) if bucket else "us-east-1"), **_TIMEOUTS_S}
    if endpoint:
        url = urlsplit(endpoint if "://" in endpoint else f"https://{endpoint}")
        given |= {"endpoint_override": url.netloc, "scheme": url.scheme}
    bundle = dict(environment).get("AWS_CA_BUNDLE")
    return S3FileSystem(**given, **({"tls_ca_file_path": bundle} if bundle else {}))


@lru_cache(maxsize=1)
def _google() -> Any:
    from pyarrow.fs import GcsFileSystem

    return GcsFileSystem(retry_time_limit=timedelta(seconds=_RETRY_S))
