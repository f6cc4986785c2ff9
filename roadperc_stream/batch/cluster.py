"""Tasks on the machines of a Ray cluster.

A separate process speaks to Ray (``ray_session``). Ray prints, handles the signals, waits minutes for a missing
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

from roadperc_stream.batch.attempt import attempt
from roadperc_stream.batch.backend import Frames
from roadperc_stream.batch.task import Outcome, Task, code_digest
from roadperc_stream.errors import ClusterError
from roadperc_stream.system.progress import now_and_then

LOCAL: Final = "local"
"""The address of a Ray that the batch starts for itself on this machine."""
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
    """What a session needs to start.

    Args:
        address: of the cluster, or ``local``.
        jobs: CPUs of a local one.
        memory_bytes: what a task may take.
        code: digest of the code that the machines are to have.
    """

    address: str
    jobs: int
    memory_bytes: int
    code: str


@dataclass(frozen=True)
class ClusterState:
    """Current CPUs of the cluster, and the progress of the running tasks by their keys."""

    slots: int
    at_work: Mapping[str, Frames]


@dataclass(frozen=True)
class TaskEnd:
    """How the task of this key ended."""

    key: str
    outcome: Outcome


SessionMessage = ClusterState | TaskEnd | str
"""A text is the one-line error of a session that cannot start."""


class RayBackend:
    """A task of Ray for each log.

    Args:
        address: of a cluster, as Ray takes it (``auto``, ``host:6379``, ``ray://host:10001``), or ``local``.
        jobs: CPUs of a local one.
        memory_bytes: what Ray is to keep free for a task.

    Raises:
        ClusterError: Ray is not installed.
    """

    def __init__(self, address: str, jobs: int, memory_bytes: int) -> None:
        if importlib.util.find_spec("ray") is None:
            raise ClusterError("--ray: Ray is not installed: pip install 'roadperc_stream[cluster]'")
        self._request = ClusterRequest(address, jobs, memory_bytes, code_digest())
        self._tasks: dict[str, Task] = {}
        self._state = ClusterState(0, {})

    @property
    def slots(self) -> int:
        """CPUs of the cluster: they may come and go."""
        return self._state.slots

    @property
    def at_work(self) -> Mapping[str, Frames]:
        """The progress of the running tasks, by their keys, as their machines report it."""
        return {key: frames for key, frames in self._state.at_work.items() if key in self._tasks}

    def __enter__(self) -> Self:
        """Start Ray or join a cluster.

        Raises:
            ClusterError: no cluster listens at the address, or its code differs.
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
            raise ClusterError(f"--ray {self._request.address}: no cluster joined within {within_s:g} s")
        self._received()

    def submit(self, task: Task) -> None:
        """Begin with a task."""
        self._tasks[task.key] = task
        try:
            self._connection.send(task)
        except OSError:
            raise self._lost() from None

    def wait(self, timeout_s: float) -> list[tuple[Task, Outcome]]:
        """The tasks that have ended since.

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
        """The next message if a task has ended; None for a new state of the cluster, which is kept."""
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
        address = self._request.address
        return ClusterError(f"--ray {address}: the connection to the cluster is lost; the same command goes on later")

    def __exit__(self, *raised: object) -> None:
        """End all tasks and leave the cluster: the session does both when its pipe closes."""
        self._connection.close()
        has_begun = self._state.slots > 0 or self._request.address == LOCAL
        try:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_LEAVE_WITHIN_S if has_begun else 0)
        finally:
            self._process.kill()
            self._process.wait()


def _start_session(connection: Connection, address: str) -> "subprocess.Popen[bytes]":
    """Start the session in its own process group, which an interrupt from the terminal does not reach."""
    environment = _ENVIRONMENT | dict(os.environ)
    if address == LOCAL:  # others must not use it, and no key may stay in the user's home
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
    """Check at once that something listens at the address: Ray itself tries for minutes.

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
                raise ClusterError(f"--ray {address}: no cluster there: {error}") from None
            return
    raise ClusterError(f"--ray {address}: expected local, auto, HOST:PORT or ray://HOST:PORT")


_TELL_EVERY_S: Final = 1.0


def code_on_node() -> str:
    """Digest of the code that a machine has."""
    return code_digest()


class FrameCount:
    """Progress of the running tasks of all machines."""

    def __init__(self) -> None:
        self._done: dict[str, Frames] = {}

    def tell(self, key: str, frames: Frames) -> None:
        """Store the frames done and expected of a task."""
        self._done[key] = frames

    def forget(self, key: str) -> None:
        """Remove a task that has ended."""
        self._done.pop(key, None)

    def told(self) -> dict[str, Frames]:
        """The progress of all running tasks."""
        return self._done


def attempt_on_node(task: Task, count: Any) -> Outcome:
    """Replay a log and report its progress.

    Args:
        task: the log, and what to do with it.
        count: Ray's handle of a ``FrameCount``.
    """
    tell = now_and_then(lambda done, expected: count.tell.remote(task.key, (done, expected)), _TELL_EVERY_S)
    try:
        return attempt(task, tell=tell)
    finally:
        count.forget.remote(task.key)
