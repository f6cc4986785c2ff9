"""File systems of fsspec: this machine's disk, pyarrow's for S3 and Google, fsspec's own packages for other schemes.

A written file appears whole or not at all.
"""

import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import suppress
from datetime import timedelta
from functools import lru_cache
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit
from uuid import uuid4

from fsspec.core import url_to_fs
from fsspec.implementations.arrow import ArrowFile, ArrowFSWrapper
from fsspec.implementations.local import LocalFileSystem
from pyarrow.fs import FileSelector, GcsFileSystem, S3FileSystem, resolve_s3_region

from roadperc_stream.batch.storage.addresses import Parts, is_address, remainders
from roadperc_stream.errors import StorageError
from roadperc_stream.system.files import completing, require_plain

PIECE_BYTES: Final = 16 << 20
"""Files are fetched and sent in pieces of this size."""
TIMEOUTS_S: Final = {"connect_timeout": 5.0, "request_timeout": 10.0}
"""For S3's client, which makes three attempts: its default of one second is too short for a busy store."""
_GOOGLE_RETRY: Final = timedelta(seconds=10)
"""Limit of Google's client for one request; its default is a quarter of an hour."""


class LocalFiles(LocalFileSystem):  # type: ignore[misc] # fsspec has no types
    """Files of this machine, by their absolute paths; links are followed."""

    def info(self, path: str, **_: Any) -> dict[str, Any]:
        """Size and modification time in ns."""
        facts = Path(path).stat()
        kind = "file" if stat.S_ISREG(facts.st_mode) else "other"
        return {"size": facts.st_size, "mtime": facts.st_mtime_ns, "type": kind}

    def walked(self, folder: str, pattern: Parts) -> Iterator[tuple[str, dict[str, Any]]]:
        """Path and ``info`` of all files below a folder, which need not exist.

        The walk skips folders that cannot contain a match of the pattern. It follows a link to a folder unless the link
        leads back to a folder that contains it. A broken link counts as an empty file: its log is reported as missing.

        Raises:
            StorageError: a folder cannot be read.
        """

        def fail(error: OSError) -> None:
            raise StorageError(f"{error.filename}: {error.strerror}") from error

        base = Path(folder)
        for here, folders, names in os.walk(base, onerror=fail, followlinks=True) if base.is_dir() else ():
            below = Path(here).relative_to(base).parts
            folders[:] = [
                name
                for name in folders
                if remainders(pattern, (*below, name)) and not _leads_back(Path(here, name), base)
            ]
            for path in (os.path.join(here, name) for name in names):  # noqa: PTH118 - a Path for each is slow
                try:
                    yield path, self.info(path)
                except OSError:
                    if Path(path).is_symlink():
                        yield path, {"size": 0, "mtime": "0", "type": "file"}

    def pipe_file(self, path: str, value: bytes, **_: Any) -> None:
        """Write a file."""
        with completing(Path(path), mark=uuid4().hex) as hidden:
            hidden.write_bytes(value)


def _leads_back(folder: Path, base: Path) -> bool:
    """Whether it is a link to a folder between ``base`` and itself."""
    walked = folder.parents[: len(folder.relative_to(base).parts)]
    return folder.is_symlink() and any(folder.samefile(above) for above in walked)


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


def move(source: Path, _system: Any, path: str) -> None:
    """Rename a file of this machine, or copy it to another disk."""
    target = Path(path)
    require_plain(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        source.replace(target)
    except OSError:  # another disk
        with completing(target, mark=uuid4().hex) as hidden:
            shutil.copyfile(source, hidden)


def upload(source: Path, system: Any, path: str) -> None:
    """Send a file in pieces to a store.

    Closing a stream creates a file from the written bytes, also after an error here; this file is then removed. If the
    store fails, closing also fails, and an earlier file stays. S3's client writes in the background; waiting after
    each piece limits the memory to one piece.
    """
    stream = system.open(path, "wb")
    try:
        for piece in pieces_of(source):
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


def pieces_of(path: Path) -> Iterator[bytes]:
    """The bytes of a file, in pieces."""
    with path.open("rb") as stream:
        while piece := stream.read(PIECE_BYTES):
            yield piece


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


@lru_cache(maxsize=16)
def _pyarrow_files(scheme: str, bucket: str, settings: tuple[tuple[str, str], ...]) -> PyarrowFiles:
    """The file system of a bucket, shared by all its files because a client keeps connections open.

    pyarrow's S3FileSystem reads keys from the environment or ``~/.aws``. Endpoint, region and certificates come from
    the same variables as for AWS's own programs.
    """
    if scheme != "s3":
        return PyarrowFiles(GcsFileSystem(retry_time_limit=_GOOGLE_RETRY), skip_instance_cache=True)
    known, options = dict(settings), dict[str, Any](TIMEOUTS_S)
    endpoint = known.get("AWS_ENDPOINT_URL_S3") or known.get("AWS_ENDPOINT_URL")
    region = known.get("AWS_REGION") or known.get("AWS_DEFAULT_REGION")
    options["region"] = region or ("us-east-1" if endpoint else resolve_s3_region(bucket))
    if endpoint:
        url = urlsplit(endpoint if "://" in endpoint else f"https://{endpoint}")
        options |= {"endpoint_override": url.netloc, "scheme": url.scheme}
    if bundle := known.get("AWS_CA_BUNDLE"):
        options["tls_ca_file_path"] = bundle
    return PyarrowFiles(S3FileSystem(**options), skip_instance_cache=True)
