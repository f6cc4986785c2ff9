"""File systems of fsspec: this machine's disk, pyarrow's for S3 and Google, fsspec's own packages for other schemes."""

import os
import stat
from collections.abc import Iterator
from datetime import timedelta
from functools import lru_cache
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit
from uuid import uuid4

from fsspec.core import url_to_fs
from fsspec.implementations.arrow import ArrowFile, ArrowFSWrapper
from fsspec.implementations.local import LocalFileSystem
from pyarrow.fs import AwsStandardS3RetryStrategy, FileSelector, GcsFileSystem, S3FileSystem, resolve_s3_region

from roadperc_stream.batch.addresses import is_address
from roadperc_stream.errors import StorageError
from roadperc_stream.system.files import completing

_S3: Final[dict[str, Any]] = {
    "connect_timeout": 5.0,
    "request_timeout": 10.0,  # the default of one second is too short for a busy store
    "retry_strategy": AwsStandardS3RetryStrategy(max_attempts=5),  # waits of up to 15 s in all
}
"""Options of S3's client, which repeats failed requests after growing waits."""
_GOOGLE_RETRY: Final = timedelta(seconds=10)
"""Limit of Google's client for one request; its default is a quarter of an hour."""


def system_of(address: str) -> tuple[Any, str]:
    """The file system of an address, and its path there.

    Raises:
        StorageError: no installed package supports the scheme.
        OSError: the bucket's region cannot be found.
    """
    if not is_address(address):
        return LocalFiles(), address
    scheme, _, path = address.partition("://")
    if scheme in {"s3", "gs", "gcs"}:
        settings = tuple(sorted(item for item in os.environ.items() if item[0].startswith("AWS_")))
        return _pyarrow_files(scheme, path.split("/")[0], settings), path
    try:
        system, path = url_to_fs(address)
    except ImportError as error:
        need = f"needs fsspec's package for {scheme}:// (adlfs for abfs://, sshfs for sftp://)"
        raise StorageError(f"{address}: {need}; pip install it ({error})") from error
    except ValueError as error:
        raise StorageError(f"{address}: fsspec knows no scheme {scheme}:// ({error})") from error
    system.invalidate_cache()
    return system, path


class LocalFiles(LocalFileSystem):  # type: ignore[misc] # fsspec has no types
    """Files of this machine, by their absolute paths; links are followed."""

    def info(self, path: str, **_: Any) -> dict[str, Any]:
        """Size and modification time in ns."""
        facts = Path(path).stat()
        kind = "file" if stat.S_ISREG(facts.st_mode) else "other"
        return {"size": facts.st_size, "mtime": facts.st_mtime_ns, "type": kind}

    def find(self, path: str, maxdepth: int | None = None, **_: Any) -> dict[str, dict[str, Any]]:
        """Path and ``info`` of all files below a folder, which need not exist; each folder is walked once.

        A broken link counts as an empty file: its log is reported as missing.

        Raises:
            OSError: a folder cannot be read.
        """
        return dict(self._walked(path, maxdepth)) if Path(path).is_dir() else {}

    def _walked(self, base: str, maxdepth: int | None) -> Iterator[tuple[str, dict[str, Any]]]:
        walked = set[str]()
        for here, folders, names in os.walk(base, onerror=_raise, followlinks=True):
            folders[:] = [] if maxdepth == 1 else [name for name in folders if not name.startswith(".")]
            real = os.path.realpath(here)
            if real in walked:  # a link leads back
                folders.clear()
                continue
            walked.add(real)
            for path in (os.path.join(here, name) for name in names):  # noqa: PTH118 - a Path for each is slow
                try:
                    yield path, self.info(path)
                except OSError:
                    yield path, {"size": 0, "mtime": "0", "type": "file"}

    def pipe_file(self, path: str, value: bytes, **_: Any) -> None:
        """Write a file, whole or not at all."""
        with completing(Path(path), mark=uuid4().hex) as hidden:
            hidden.write_bytes(value)


def _raise(error: OSError) -> None:
    raise error


class PyarrowFiles(ArrowFSWrapper):  # type: ignore[misc] # fsspec has no types
    """A file system of pyarrow with fewer requests than fsspec's wrapper; a written file is complete or absent."""

    def _open(self, path: str, mode: str = "rb", **_: Any) -> ArrowFile:
        """Open a file; fsspec's own method reports an unknown access key as a missing file."""
        is_read = mode == "rb"
        stream = self.fs.open_input_file(path) if is_read else self.fs.open_output_stream(path, compression=None)
        return ArrowFile(self, stream, path, mode)

    def find(self, path: str, maxdepth: int | None = None, **_: Any) -> dict[str, dict[str, Any]]:
        """All files of a folder by one listing; the wrapper itself lists each folder."""
        try:
            infos = self.fs.get_file_info(FileSelector(path, recursive=maxdepth is None))
        except FileNotFoundError:
            return {}
        return {info.path: self._make_entry(info) for info in infos if info.is_file}

    def ukey(self, path: str) -> str:
        """A text that changes with the file: S3's ETag, not only size and time."""
        with self.fs.open_input_file(path) as stream:
            return str(stream.metadata() or self.info(path))


@lru_cache(maxsize=16)
def _pyarrow_files(scheme: str, bucket: str, settings: tuple[tuple[str, str], ...]) -> PyarrowFiles:
    """The file system of a bucket, shared by all its files because a client keeps connections open.

    pyarrow's S3FileSystem reads keys from the environment or ``~/.aws``. Endpoint, region and certificates come from
    the same variables as for AWS's own programs.
    """
    if scheme != "s3":
        return PyarrowFiles(GcsFileSystem(retry_time_limit=_GOOGLE_RETRY), skip_instance_cache=True)
    known, options = dict(settings), dict(_S3)
    endpoint = known.get("AWS_ENDPOINT_URL_S3") or known.get("AWS_ENDPOINT_URL")
    region = known.get("AWS_REGION") or known.get("AWS_DEFAULT_REGION")
    options["region"] = region or ("us-east-1" if endpoint else resolve_s3_region(bucket))
    if endpoint:
        url = urlsplit(endpoint if "://" in endpoint else f"https://{endpoint}")
        options |= {"endpoint_override": url.netloc, "scheme": url.scheme}
    if bundle := known.get("AWS_CA_BUNDLE"):
        options["tls_ca_file_path"] = bundle
    return PyarrowFiles(S3FileSystem(**options), skip_instance_cache=True)
