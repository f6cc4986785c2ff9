"""The file systems of stores: pyarrow's for S3 and Google, fsspec's own packages for other schemes.

This module is imported when a store is first needed, for most batches know only this machine's files.
"""

import os
from contextlib import suppress
from datetime import timedelta
from functools import lru_cache
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from fsspec.core import url_to_fs
from fsspec.implementations.arrow import ArrowFile, ArrowFSWrapper
from pyarrow.fs import FileSelector, GcsFileSystem, S3FileSystem, resolve_s3_region

from roadperc_stream.batch.storage.disk import pieces_of
from roadperc_stream.errors import StorageError

TIMEOUTS_S: Final = {"connect_timeout": 5.0, "request_timeout": 10.0}
"""Of S3's client, which tries three times: its own one second and three are too few for a store that is busy."""
_GOOGLE_RETRY: Final = timedelta(seconds=10)
"""How long Google's client tries one request, instead of its quarter of an hour."""


class PyarrowFiles(ArrowFSWrapper):  # type: ignore[misc] # fsspec has no types
    """A file system of pyarrow's with fewer requests than fsspec's wrapper, and files that are whole."""

    def _open(self, path: str, mode: str = "rb", **_: Any) -> ArrowFile:
        """Open a file; fsspec's own method takes an unknown access key for a missing file."""
        is_read = mode == "rb"
        stream = self.fs.open_input_file(path) if is_read else self.fs.open_output_stream(path, compression=None)
        return ArrowFile(self, stream, path, mode)

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


def upload(source: Path, system: Any, path: str) -> None:
    """Send a file in pieces to a store, where it appears whole or not at all.

    A stream that is closed makes a file of what it was given, even where an error closes it: then what is not whole
    goes. Where it is the store that failed, closing fails too, and what was there before stays: S3's client
    remembers a failure as long as it writes in the background. It is waited for after each piece, or all of a file
    that is faster read than sent would be in memory.
    """
    stream = system.open(path, "wb")
    try:
        for piece in pieces_of(str(source)):
            stream.write(piece)
            stream.flush()
        stream.close()
    except BaseException:
        with suppress(Exception):
            is_whole = stream.closed or stream.tell() == source.stat().st_size
            stream.close()
            if not is_whole:
                system.rm_file(path)
        raise


def store_of(address: str) -> tuple[Any, str]:
    """The file system of an address, and its path there.

    Raises:
        StorageError: nothing that is installed knows the scheme.
        OSError: the bucket's region cannot be found.
    """
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


@lru_cache(maxsize=16)
def _pyarrow_files(scheme: str, bucket: str, settings: tuple[tuple[str, str], ...]) -> PyarrowFiles:
    """The file system of a bucket: one for all its files, for a client keeps connections open.

    pyarrow's S3FileSystem reads keys from the environment or ``~/.aws``, but neither endpoint nor region as the
    stores' own programs do.
    """
    if scheme != "s3":
        return PyarrowFiles(GcsFileSystem(retry_time_limit=_GOOGLE_RETRY), skip_instance_cache=True)
    known, given = dict(settings), dict[str, Any](TIMEOUTS_S)
    endpoint = known.get("AWS_ENDPOINT_URL_S3") or known.get("AWS_ENDPOINT_URL")
    region = known.get("AWS_REGION") or known.get("AWS_DEFAULT_REGION")
    given["region"] = region or ("us-east-1" if endpoint else resolve_s3_region(bucket))
    if endpoint:
        url = urlsplit(endpoint if "://" in endpoint else f"https://{endpoint}")
        given |= {"endpoint_override": url.netloc, "scheme": url.scheme}
    if bundle := known.get("AWS_CA_BUNDLE"):
        given["tls_ca_file_path"] = bundle
    return PyarrowFiles(S3FileSystem(**given), skip_instance_cache=True)
