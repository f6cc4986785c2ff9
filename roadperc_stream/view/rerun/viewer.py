"""Starts the Rerun viewer, and saves a recording through a pipe: the SDK may wait forever for a full disk."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
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
_EXITS_WITHIN_S: Final = 2.0
"""A viewer without a display listens briefly before it exits."""


def start_viewer() -> None:
    """Start a viewer on the loopback address, or use the running one.

    The SDK's own ``spawn`` listens on all addresses and waits forever for a viewer without a display.

    Raises:
        RoadpercError: no viewer starts, or another program uses its port.
    """
    if _listening():
        if not _is_viewer():
            where = "{}:{}".format(*_ADDRESS)
            raise RoadpercError(
                f"{where}: another program uses this port; close it, or write a file with --save FILE.rrd"
            )
        return
    quiet = subprocess.DEVNULL
    viewer = subprocess.Popen(_COMMAND, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
    deadline = monotonic() + _STARTS_WITHIN_S
    while monotonic() < deadline and viewer.poll() is None and not _listening():
        sleep(0.1)
    with suppress(subprocess.TimeoutExpired):
        viewer.wait(_EXITS_WITHIN_S)
    if viewer.poll() is not None or not _listening():
        raise RoadpercError(
            "the Rerun viewer does not start; without a display pass --save FILE.rrd to write a recording"
        )


@contextmanager
def ending_at_once() -> Iterator[None]:
    """Let a signal end the program at once. Safe because no file is open.

    The SDK waits for a viewer that does not read, and Python runs no signal handler during that wait.
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
    """Whether the listener is a viewer; the SDK would wait forever for another program."""
    with closing(HTTPConnection(*_ADDRESS, timeout=_ANSWERS_WITHIN_S)) as connection:
        try:
            connection.request("OPTIONS", "/proxy")
            return connection.getresponse().status == HTTPStatus.OK
        except (OSError, HTTPException):
            return False


_PIECE_BYTES: Final = 2**20


@contextmanager
def saving(recording: rr.RecordingStream, path: Path) -> Iterator[Callable[[], None]]:
    """Save a recording through a pipe to a file, which is complete if no error is raised.

    Yields:
        A check that the file has all bytes from the pipe; it raises the same errors.

    Raises:
        OSError: the SDK cannot open the pipe, or the file cannot be completed, as on a full disk.
    """
    readable, writable = os.pipe()
    with FileIO(readable) as pipe, ThreadPoolExecutor(1, "recording") as thread, FileIO(writable, "wb") as end:
        try:
            copied = thread.submit(_copy, pipe, path)
            thread.submit(_drain, pipe)
            _open(recording, end)
            yield lambda: copied.result() if copied.done() else None
        finally:
            recording.disconnect()
    copied.result()


def _open(recording: rr.RecordingStream, end: FileIO) -> None:
    """Save a recording into the pipe. From here on, only the SDK holds this end."""
    try:
        recording.save(f"/dev/fd/{end.fileno()}")
    except RuntimeError as error:  # raised by the SDK
        raise OSError(str(error)) from error
    finally:
        end.close()


def _copy(pipe: FileIO, path: Path) -> None:
    with path.open("wb") as file:
        shutil.copyfileobj(pipe, file, _PIECE_BYTES)


def _drain(pipe: FileIO) -> None:
    """Empty the pipe after a failed copy, so that the SDK can disconnect."""
    while pipe.read(_PIECE_BYTES):
        pass
