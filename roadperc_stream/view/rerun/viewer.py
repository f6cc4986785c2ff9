"""What a recording goes to: the Rerun viewer as a program of its own, or a file through a pipe."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from io import FileIO
from pathlib import Path
from time import monotonic, sleep
from typing import Final

import rerun as rr

from roadperc_stream.errors import RoadpercError
from roadperc_stream.system.process import ending_signals

URL: Final = "rerun+http://127.0.0.1:9876/proxy"
_ADDRESS: Final = ("127.0.0.1", 9876)
_COMMAND: Final = (sys.executable, "-m", "rerun", "--bind", _ADDRESS[0], "--port", str(_ADDRESS[1]))
_STARTS_WITHIN_S: Final = 30.0
_ANSWERS_WITHIN_S: Final = 5.0
_FALLS_WITHIN_S: Final = 2.0
"""A viewer without a display listens for a moment before it notices."""


def start_viewer() -> None:
    """Start a viewer on the loopback address; where one listens there already, it is the one that is used.

    The SDK's own ``spawn`` listens on all addresses, and waits for ever for a viewer that has no display.

    Raises:
        RoadpercError: no viewer comes up, or another program has its port.
    """
    if _listening():
        if not _is_viewer():
            where = f"{_ADDRESS[0]}:{_ADDRESS[1]}"
            raise RoadpercError(f"{where}: taken by a program that is no Rerun viewer; --save FILE.rrd needs no port")
        return
    quiet = subprocess.DEVNULL
    viewer = subprocess.Popen(_COMMAND, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
    deadline = monotonic() + _STARTS_WITHIN_S
    while monotonic() < deadline and viewer.poll() is None and not _listening():
        sleep(0.1)
    with suppress(subprocess.TimeoutExpired):
        viewer.wait(_FALLS_WITHIN_S)
    if viewer.poll() is not None or not _listening():
        raise RoadpercError("the Rerun viewer does not start, is there a display? --save FILE.rrd writes a recording")


@contextmanager
def ending_at_once() -> Iterator[None]:
    """Let a signal end the program where it stands, as is right where no file is open.

    The SDK waits for a viewer that takes nothing, stopped or in a debugger, and no handler of Python's runs meanwhile.
    """
    signals = ending_signals() if threading.current_thread() is threading.main_thread() else ()
    before = {number: signal.signal(number, signal.SIG_DFL) for number in signals}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _listening() -> bool:
    try:
        socket.create_connection(_ADDRESS, timeout=1.0).close()
    except OSError:
        return False
    return True


def _is_viewer() -> bool:
    """Whether what listens answers as a viewer does: the SDK would wait for ever for a program that does not."""
    connection = HTTPConnection(*_ADDRESS, timeout=_ANSWERS_WITHIN_S)
    try:
        connection.request("OPTIONS", "/proxy")
        return connection.getresponse().status == HTTPStatus.OK
    except (OSError, HTTPException):
        return False
    finally:
        connection.close()


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
