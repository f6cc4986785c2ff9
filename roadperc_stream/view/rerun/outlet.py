"""From Rerun's SDK to a file through a pipe, so that the SDK never meets a full disk.

Where a write fails, the thread of ``rerun-sdk`` that does it ends, and another one may wait for its answer without end:
with 0.41 every fourth recording onto a full disk never came back. A pipe takes all it is given, and why the file does
not is known here.
"""

import os
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import Final

import rerun as rr

_PIECE_BYTES: Final = 2**20


class Outlet:
    """Copies what comes out of a pipe into a file."""

    def __init__(self, path: Path) -> None:
        readable, self._writable = os.pipe()
        self._path = path
        self._error: OSError | None = None
        self._copier = threading.Thread(target=self._copy, args=(FileIO(readable),), name="recording", daemon=True)
        self._copier.start()

    def open(self, recording: rr.RecordingStream) -> None:
        """Have a recording written into the pipe; its end is the SDK's alone from here on.

        Raises:
            OSError: the SDK cannot open it.
        """
        try:
            recording.save(f"/dev/fd/{self._writable}")
        except RuntimeError as error:  # what the SDK throws
            raise OSError(str(error)) from error
        finally:
            os.close(self._writable)

    def check(self) -> None:
        """See that all that came out of the pipe so far is in the file.

        Raises:
            OSError: it is not, as when the disk is full.
        """
        if self._error:
            raise self._error

    def close(self) -> None:
        """Wait for the end of what comes; the recording is disconnected."""
        self._copier.join()

    def _copy(self, readable: FileIO) -> None:
        with readable:
            try:
                with self._path.open("wb") as file:
                    shutil.copyfileobj(readable, file, _PIECE_BYTES)
            except OSError as error:
                self._error = error
            while readable.read(_PIECE_BYTES):
                pass  # the SDK goes on writing until it is disconnected, which needs an empty pipe


@contextmanager
def saving(recording: rr.RecordingStream, path: Path) -> Iterator[Outlet]:
    """Save a recording to a file, which is whole where the block and this end without an error.

    Raises:
        OSError: the file cannot be written whole.
    """
    outlet = Outlet(path)
    try:
        outlet.open(recording)
        yield outlet
    finally:
        recording.disconnect()
        outlet.close()
    outlet.check()
