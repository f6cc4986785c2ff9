"""Stores that pyarrow has no file system for, by whatever package of fsspec's is installed."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Final

from pyarrow.fs import FileInfo, FSSpecHandler, PyFileSystem

from roadperc_stream.errors import StorageError
from roadperc_stream.storage.addresses import scheme_of

_TIMES: Final = ("mtime", "LastModified", "last_modified", "updated", "modified", "created")
"""What the implementations call the time of a file's last change."""


def open_by_fsspec(address: str) -> tuple[Any, str]:
    """The file system of an address, and its path there.

    Raises:
        StorageError: fsspec, or its package for this scheme, is not installed.
    """
    try:
        from fsspec.core import url_to_fs

        system, path = url_to_fs(address)
    except ImportError as error:
        why = "" if error.name == "fsspec" else f" ({error})"
        need = f"needs fsspec and its package for {scheme_of(address)}:// (adlfs for abfs://, sshfs for sftp://)"
        raise StorageError(f"{address}: {need}; pip install them{why}") from error
    except ValueError as error:
        raise StorageError(f"{address}: fsspec knows no scheme {scheme_of(address)}:// ({error})") from error
    system.invalidate_cache()
    return PyFileSystem(_Handler(system)), path


class _Handler(FSSpecHandler):  # type: ignore[misc] # pyarrow has no types
    """fsspec for pyarrow, as far as pyarrow's own class does not do it."""

    def delete_file(self, path: str) -> None:
        """Remove the file of this very name: ``fs.rm`` would take ``[1]`` and ``?`` for a pattern."""
        self.fs.rm_file(path)

    @staticmethod
    def _create_file_info(path: str, info: Mapping[str, Any]) -> FileInfo:
        """With the time of change under whatever name the implementation has it."""
        said = next((info[name] for name in _TIMES if info.get(name)), None)
        created: FileInfo = FSSpecHandler._create_file_info(path, {**info, "mtime": _time(said)})
        return created


def _time(said: float | str | datetime | None) -> datetime | None:
    """A file's time to the microsecond."""
    if isinstance(said, int | float):
        return datetime.fromtimestamp(said, UTC)
    return datetime.fromisoformat(said) if isinstance(said, str) else said
