"""Tasks on the machines of a Ray cluster.

A separate process connects to Ray (``ray_session``). Ray prints, handles the signals, waits minutes for a missing
cluster, and ends its process if the cluster's head dies. None of this affects the batch.
"""

import contextlib
import importlib.util
import os
import secrets
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, Final, Self
from urllib.parse import urlsplit

from roadperc_stream import __version__
from roadperc_stream.batch.attempt import attempt
from roadperc_stream.batch.backend import Frames
from roadperc_stream.batch.task import RESULTS_VERSION, Outcome, Task
from roadperc_stream.errors import ClusterError
from roadperc_stream.system.progress import at_most_every

LOCAL: Final = "local"
"""The address for a Ray that the batch starts and ends on this machine."""
_CLIENT: Final = "ray"
_CLIENT_PORT: Final = 10001
_ANSWER_WITHIN_S: Final = 5.0
_JOIN_WITHIN_S: Final = 90.0
_START_WITHIN_S: Final = 120.0
_LEAVE_WITHIN_S: Final = 15.0
_SESSION: Final = "roadperc_stream.batch.ray_session"
_ENVIRONMENT: Final = {
    # Otherwise Ray sends the working folder, logs included, to the machines and runs uv there.
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",
    "RAY_gcs_server_request_timeout_seconds": "20",
    "RAY_USAGE_STATS_ENABLED": "0",
}
"""Environment variables for Ray, unless the user sets them."""


@dataclass(frozen=True)
class ClusterRequest:
    """The cluster that a session joins or starts.

    ``jobs`` are the CPUs of a local cluster. ``memory_bytes`` is the memory of a task. Every machine must have
    ``version``.
    """

    address: str
    jobs: int
    memory_bytes: int
    version: str


@dataclass(frozen=True)
class ClusterState:
    """Current CPUs of the cluster, and the progress of the running tasks by their keys."""

    slots: int
    running: Mapping[str, Frames]


@dataclass(frozen=True)
class TaskEnd:
    """The outcome of the task with this key."""

    key: str
    outcome: Outcome


SessionMessage = ClusterState | TaskEnd | str
"""Messages of a session; a string is the one-line error of a session that cannot start."""


class RayBackend:
    """A task of Ray for each log.

    Args:
        address: of a cluster, as Ray takes it (``auto``, ``host:6379``, ``ray://host:10001``), or ``local``.
        jobs: CPUs of a local cluster.
        memory_bytes: memory that Ray reserves for a task.

    Raises:
        ClusterError: Ray is not installed.
    """

    def __init__(self, address: str, jobs: int, memory_bytes: int) -> None:
        if importlib.util.find_spec("ray") is None:
            raise ClusterError("--ray: Ray is not installed; pip install '.[cluster]' in the project's folder")
        self._request = ClusterRequest(address, jobs, memory_bytes, version_on_node())
        self._tasks: dict[str, Task] = {}
        self._state = ClusterState(0, {})

    @property
    def slots(self) -> int:
        """CPUs of the cluster, which may grow and shrink."""
        return self._state.slots

    @property
    def running(self) -> Mapping[str, Frames]:
        """The progress of the running tasks, by their keys."""
        return {key: frames for key, frames in self._state.running.items() if key in self._tasks}

    def __enter__(self) -> Self:
        """Start Ray or join a cluster.

        Raises:
            ClusterError: no cluster listens at the address, or its version differs.
        """
        _require_listener(self._request.address)
        self._connection, other = Pipe()
        self._process = _start_session(other, self._request.address)
        other.close()
        try:
            self._connection.send(self._request)
            self._await_session()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _await_session(self) -> None:
        within_s = _START_WITHIN_S if self._request.address == LOCAL else _JOIN_WITHIN_S
        if not self._connection.poll(within_s):
            error = f"no cluster joined within {within_s:g} s; check the address"
            raise ClusterError(f"--ray {self._request.address}: {error}")
        self._received()

    def submit(self, task: Task) -> None:
        """Start a task."""
        self._tasks[task.key] = task
        try:
            self._connection.send(task)
        except OSError:
            raise self._lost() from None

    def wait(self, timeout_s: float) -> list[tuple[Task, Outcome]]:
        """The tasks that ended since the last call.

        Raises:
            ClusterError: the connection to the cluster is lost.
        """
        ended: list[tuple[Task, Outcome]] = []
        until = time.monotonic() + timeout_s
        while self._connection.poll(0 if ended else max(0, until - time.monotonic())):
            if (end := self._received()) is not None:
                ended.append((self._tasks.pop(end.key), end.outcome))
        return ended

    def _received(self) -> TaskEnd | None:
        """The next message if a task has ended; None for a new state of the cluster, which is stored."""
        try:
            message: SessionMessage = self._connection.recv()
        except (EOFError, OSError):
            raise self._lost() from None
        if isinstance(message, str):
            raise ClusterError(f"--ray {self._request.address}: {message}")
        if isinstance(message, TaskEnd):
            return message
        self._state = message
        return None

    def _lost(self) -> ClusterError:
        error = "lost the connection to the cluster; run the same command again to continue"
        return ClusterError(f"--ray {self._request.address}: {error}")

    def __exit__(self, *raised: object) -> None:
        """End all tasks and leave the cluster: the session does both when its pipe closes."""
        self._connection.close()
        has_joined = self._state.slots > 0 or self._request.address == LOCAL
        try:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_LEAVE_WITHIN_S if has_joined else 0)
        finally:
            self._process.kill()
            self._process.wait()


def _start_session(connection: Connection, address: str) -> "subprocess.Popen[bytes]":
    """Start the session in its own process group, which an interrupt from the terminal does not reach."""
    environment = _ENVIRONMENT | dict(os.environ)
    if address == LOCAL:  # only for this batch, and without a key in the user's home
        environment |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    return subprocess.Popen(
        [sys.executable, "-P", "-m", _SESSION, str(connection.fileno())],
        env=environment,
        pass_fds=[connection.fileno()],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _require_listener(address: str) -> None:
    """Check at once that something listens at the address; Ray itself tries for minutes.

    Raises:
        ClusterError: nothing listens at the address, or it is invalid.
    """
    if address in {LOCAL, "auto"}:
        return
    parts = urlsplit(address if "://" in address else f"//{address}")
    with contextlib.suppress(ValueError):
        host, port = parts.hostname, parts.port or (_CLIENT_PORT if parts.scheme == _CLIENT else None)
        if parts.scheme in {"", _CLIENT} and host and port:
            try:
                socket.create_connection((host, port), _ANSWER_WITHIN_S).close()
            except OSError as error:
                raise ClusterError(f"--ray {address}: no cluster at this address: {error}") from None
            return
    raise ClusterError(f"--ray {address}: expected local, auto, HOST:PORT or ray://HOST:PORT")


_PROGRESS_EVERY_S: Final = 1.0


def version_on_node() -> str:
    """The versions of program and results on the machine that runs this; Ray takes only plain functions."""
    return f"{__version__}, results {RESULTS_VERSION}"


class FrameCount:
    """Progress of the running tasks of all machines."""

    def __init__(self) -> None:
        self._done: dict[str, Frames] = {}

    def store(self, key: str, frames: Frames) -> None:
        """Store the frames done and expected of a task."""
        self._done[key] = frames

    def remove(self, key: str) -> None:
        """Remove a task that has ended."""
        self._done.pop(key, None)

    def all(self) -> dict[str, Frames]:
        """The progress of all running tasks."""
        return self._done


def attempt_on_node(task: Task, count: Any) -> Outcome:
    """Replay a log and report its progress.

    ``count`` is Ray's handle of a ``FrameCount``.
    """

    def report(done: int, expected: int) -> None:
        count.store.remote(task.key, (done, expected))

    try:
        return attempt(task, on_progress=at_most_every(_PROGRESS_EVERY_S, report))
    finally:
        count.remove.remote(task.key)
