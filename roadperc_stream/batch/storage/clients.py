"""The clients of stores, as file systems of fsspec: pyarrow's for S3 and Google, its own packages for other schemes.

This module is imported when a store is first asked for: most commands know only this machine's files.
"""

import os
from datetime import timedelta
from functools import lru_cache
from typing import Any, Final
from urllib.parse import urlsplit

from fsspec.core import url_to_fs
from fsspec.implementations.arrow import ArrowFile, ArrowFSWrapper
from pyarrow.fs import FileSelector, GcsFileSystem, S3FileSystem, resolve_s3_region

from roadperc_stream.batch.storage.addresses import scheme_of
from roadperc_stream.errors import StorageError

_RETRY_S: Final = 10
"""How long Google's client tries one request, instead of its quarter of an hour."""
TIMEOUTS_S: Final = {"connect_timeout": 5.0, "request_timeout": 10.0}
"""Of S3's client, which tries three times: its own one second and three are too few for a store that is busy."""


class PyarrowFiles(ArrowFSWrapper):  # type: ignore[misc] # fsspec has no types
    """A file system of pyarrow's, where fsspec's wrapper asks too often or takes an unknown key for a missing file."""

    def _open(self, path: str, mode: str = "rb", **_: Any) -> ArrowFile:
        is_read = mode == "rb"
        stream = self.fs.open_input_file(path) if is_read else self.fs.open_output_stream(path, compression=None)
        return ArrowFile(self, stream, path, mode)

    def rm_file(self, path: str) -> None:
        """Remove a file."""
        self.fs.delete_file(path)

    def find(self, path: str, maxdepth: int | None = None, **_: Any) -> dict[str, dict[str, Any]]:
        """All files of a folder by one listing; the wrapper itself asks for each folder."""
        try:
            infos = self.fs.get_file_info(FileSelector(path, recursive=maxdepth is None))
        except FileNotFoundError:
            return {}
        return {info.path: self._make_entry(info) for info in infos if info.is_file}

    def ukey(self, path: str) -> str:
        """A text that differs when the file does: by S3's ETag, not only by size and time."""
        with self.fs.open_input_file(path) as stream:
            return str(stream.metadata() or self.info(path))


def system_of(address: str) -> tuple[Any, str]:
    """The file system of an address, and its path there.

    Raises:
        StorageError: nothing that is installed knows the scheme.
        OSError: the bucket's region cannot be found.
    """
    scheme, path = scheme_of(address), address.partition("://")[2]
    if scheme == "s3":
        return _s3(path.split("/")[0]), path
    if scheme in {"gs", "gcs"}:
        return _google(), path
    try:
        system, path = url_to_fs(address)
    except ImportError as error:
        need = f"needs fsspec's package for {scheme}:// (adlfs for abfs://, sshfs for sftp://)"
        raise StorageError(f"{address}: {need}; pip install it ({error})") from error
    except ValueError as error:
        raise StorageError(f"{address}: fsspec knows no scheme {scheme}:// ({error})") from error
    system.invalidate_cache()
    return system, path


def _s3(bucket: str) -> PyarrowFiles:
    """The file system of a bucket, by the environment's settings.

    pyarrow's S3FileSystem reads keys from the environment or ``~/.aws``, but neither endpoint nor region as the
    stores' own programs do.
    """
    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or ""
    region = os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION") or ""
    keys = tuple(sorted(item for item in os.environ.items() if item[0].startswith("AWS_")))
    return _s3_system("" if endpoint or region else bucket, endpoint, region, keys)


@lru_cache(maxsize=16)
def _s3_system(bucket: str, endpoint: str, region: str, environment: tuple[tuple[str, str], ...]) -> PyarrowFiles:
    """A client for all files, as it keeps connections open; another one where the environment is another."""
    given: dict[str, Any] = {"region": region or (resolve_s3_region(bucket) if bucket else "us-east-1"), **TIMEOUTS_S}
    if endpoint:
        url = urlsplit(endpoint if "://" in endpoint else f"https://{endpoint}")
        given |= {"endpoint_override": url.netloc, "scheme": url.scheme}
    if bundle := dict(environment).get("AWS_CA_BUNDLE"):
        given["tls_ca_file_path"] = bundle
    return PyarrowFiles(S3FileSystem(**given), skip_instance_cache=True)


@lru_cache(maxsize=1)
def _google() -> PyarrowFiles:
    return PyarrowFiles(GcsFileSystem(retry_time_limit=timedelta(seconds=_RETRY_S)), skip_instance_cache=True)
