"""This machine's files as a file system of fsspec, in which a file appears whole or not at all."""

import errno
import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from uuid import uuid4

from fsspec.implementations.local import LocalFileSystem

from roadperc_stream.batch.storage.addresses import Parts, left_of
from roadperc_stream.errors import StorageError
from roadperc_stream.system.files import completing, require_plain

PIECE_BYTES: Final = 16 << 20
"""Files are fetched and sent in pieces of this size."""


class LocalFiles(LocalFileSystem):  # type: ignore[misc] # fsspec has no types
    """Files of this machine, by their absolute paths; links are followed."""

    def info(self, path: str, **_: Any) -> dict[str, Any]:
        """Length and time of change in ns, as ``Location`` takes them."""
        facts = Path(path).stat()
        kind = "file" if stat.S_ISREG(facts.st_mode) else "other"
        return {"size": facts.st_size, "mtime": facts.st_mtime_ns, "type": kind}

    def walked(self, folder: str, pattern: Parts) -> Iterator[tuple[str, dict[str, Any]]]:
        """Path and ``info`` of all files below a folder; none without the folder.

        The walk enters a link to a folder, but not to one that the link is in. It gives a dead link as an empty file,
        which cannot be read: else nobody would miss the log.

        Args:
            folder: its absolute path.
            pattern: folders in which it matches nothing are left out.

        Raises:
            StorageError: a folder cannot be read.
        """

        def fail(error: OSError) -> None:
            raise StorageError(f"{error.filename}: {error.strerror}") from error

        base = Path(folder)
        for here, folders, names in os.walk(base, onerror=fail, followlinks=True) if base.is_dir() else ():
            below = Path(here).relative_to(base).parts
            folders[:] = [
                name for name in folders if left_of(pattern, (*below, name)) and not _leads_back(Path(here, name), base)
            ]
            for path in (os.path.join(here, name) for name in names):  # noqa: PTH118 - a Path for each takes long
                try:
                    yield path, self.info(path)
                except OSError:
                    if Path(path).is_symlink():
                        yield path, {"size": 0, "mtime": "0", "type": "file"}

    def pipe_file(self, path: str, value: bytes, **_: Any) -> None:
        """Write a file."""
        with completing(Path(path), mark=uuid4().hex) as hidden:
            hidden.write_bytes(value)

    def put_file(self, lpath: str, rpath: str, **_: Any) -> None:
        """Rename a file, or where the new name is on another disk, copy it to a hidden name first."""
        source, target = Path(lpath), Path(rpath)
        require_plain(target)
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            source.replace(target)
        except OSError as error:
            if error.errno != errno.EXDEV:
                raise
            with completing(target, mark=uuid4().hex) as hidden:
                shutil.copyfile(source, hidden)


def pieces_of(path: str) -> Iterator[bytes]:
    """The bytes of a file, in pieces."""
    with Path(path).open("rb") as stream:
        while piece := stream.read(PIECE_BYTES):
            yield piece


def _leads_back(folder: Path, base: Path) -> bool:
    """Whether it is a link to a folder of the walk that it is in; those above ``base`` are not walked."""
    walked = folder.parents[: len(folder.relative_to(base).parts)]
    return folder.is_symlink() and any(folder.samefile(above) for above in walked)
