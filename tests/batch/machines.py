"""A real Ray cluster on this machine: each of its machines is a raylet with its own workers."""

import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

ROOT = Path(__file__).parents[2]
RAY = ("-c", "from ray.scripts.scripts import main; main()")
START_WITHIN_S = 180
STARTS = 3


class Machines:
    """The head with one CPU, and further machines; all end with the context."""

    def __init__(self, folder):
        self.address, self._folder = f"127.0.0.1:{free_port()}", folder
        self.variables = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32), "PYTHONPATH": str(ROOT)}
        patient = {"RAY_CLIENT_SERVER_CHECK_CHANNEL_TIMEOUT_S": "120", "RAY_USAGE_STATS_ENABLED": "0"}
        self._environment = os.environ | self.variables | patient
        self.client_address = f"ray://127.0.0.1:{(client_port := free_port())}"
        port = self.address.partition(":")[2]
        self._python = folder / "venv" / Path(sys.executable).relative_to(sys.prefix)
        (folder / "venv").symlink_to(sys.prefix)  # Ray starts its client server in a shell, which splits at blanks
        self.started = []
        self.add("--head", f"--port={port}", f"--ray-client-server-port={client_port}", "--include-dashboard=false",
                 f"--temp-dir={folder}", "--num-cpus=1")  # fmt: skip

    def add(self, *options):
        """Start a machine, by default with two CPUs; retried, because Ray gives up after half a minute."""
        words = options or (f"--address={self.address}", "--num-cpus=2")
        for _ in range(STARTS):
            process, printed = self._started(words)
            if process.poll() is None:
                return psutil.Process(process.pid)
            self.started.remove(process)
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        raise AssertionError(printed)

    def _started(self, words):
        """The process of a machine, and its output when it is ready or has ended."""
        always = ("--block", "--object-store-memory=80000000", "--min-worker-port=0", "--max-worker-port=0")
        printed = self._folder / f"printed_{time.monotonic_ns()}.txt"
        with printed.open("w") as output:
            process = subprocess.Popen(
                [self._python, *RAY, "start", *words, *always],
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )
        self.started.append(process)
        wait_until(lambda: "Ray runtime started" in printed.read_text() or self._has_ended(), START_WITHIN_S)
        return process, printed.read_text()

    def _has_ended(self):
        return any(process.poll() is not None for process in self.started)

    def held(self, machine):
        """The workers of a machine that replay a log, suspended so that they do not finish."""
        found = [child for child in machine.children(recursive=True) if is_at_log(child)]
        for worker in found:
            worker.suspend()
        return [worker for worker in found if is_at_log(worker)]

    def end(self):
        for process in reversed(self.started):
            kill(psutil.Process(process.pid)) if process.poll() is None else None
            process.wait()


def kill(machine):
    """Kill a machine with all its processes at once, as a power failure does."""
    family = [machine, *machine.children(recursive=True)]
    for process in family:
        with suppress(psutil.NoSuchProcess):
            process.kill()
    psutil.wait_procs(family, timeout=10)


def title(process):
    with suppress(psutil.Error):
        return " ".join(process.cmdline())
    return ""


def is_at_log(process):
    """Whether a process is a worker of Ray that replays a log."""
    if not title(process).startswith("ray::Worker"):
        return False
    with suppress(psutil.Error):
        return any("forkserver" in title(child) and child.children() for child in process.children())
    return False


def wait_until(holds, within_s):
    until = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < until, "timeout"
        time.sleep(0.05)


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@contextmanager
def machines():
    """A cluster; its folder has a short name because of the sockets in it."""
    folder = Path(tempfile.mkdtemp(prefix="ray-", dir="/tmp"))
    found = None
    try:
        found = Machines(folder)
        yield found
    finally:
        if found:
            found.end()
        shutil.rmtree(folder, ignore_errors=True)
