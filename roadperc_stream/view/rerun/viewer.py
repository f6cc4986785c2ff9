"""Starts the Rerun viewer."""

import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from time import monotonic, sleep
from typing import Final

from roadperc_stream.errors import RoadpercError
from roadperc_stream.system.process import ending_signals

URL: Final = "rerun+http://127.0.0.1:9876/proxy"
_ADDRESS: Final = ("127.0.0.1", 9876)
_COMMAND: Final = (sys.executable, "-m", "rerun", "--bind", _ADDRESS[0], "--port", str(_ADDRESS[1]))
_STARTS_WITHIN_S: Final = 30.0
_EXITS_WITHIN_S: Final = 2.0
"""A viewer without a display listens briefly before it exits."""


def start_viewer() -> None:
    """Start a viewer on the loopback address, or use the running one.

    The SDK's own ``spawn`` listens on all addresses and waits forever for a viewer without a display.

    Raises:
        RoadpercError: no viewer starts.
    """
    if _listening():
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
