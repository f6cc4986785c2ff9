"""Tasks on the machines of a Ray cluster: an actor for each CPU, which replays one log after the other."""

import os
import signal
import socket
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import Any, Final, Self
from urllib.parse import urlsplit

import ray
from ray.exceptions import RayError

from roadperc_stream.batch.attempt import attempt
from roadperc_stream.batch.backend import Frames
from roadperc_stream.batch.task import Outcome, Task
from roadperc_stream.errors import ClusterError

LOCAL: Final = "local"
"""The address for a Ray that the batch starts and ends on this machine."""
_CLIENT: Final = "ray"
_CLIENT_PORT: Final = 10001
_ANSWER_WITHIN_S: Final = 5.0
_SETTINGS: Final = b"\x04"
"""The type of each side's first frame in HTTP/2, the protocol of Ray's servers; it follows three bytes of length."""
_GREETING: Final = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(3) + _SETTINGS + bytes(5)
_STATE_EVERY_S: Final = 1.0
_OBJECTS_BYTES: Final = 100_000_000
"""Ray's object store, of the smallest size: outcomes are small and bypass it."""
_LONGEST_FOLDER: Final = 36
"""Characters of a folder below which Ray's sockets have names short enough for the system."""


class Worker:
    """An actor: a process of Ray on one of the machines."""

    def __init__(self) -> None:
        self._frames = 0, 0
        sys.modules["__main__"] = ModuleType("__main__")  # Ray's takes a second to import in the forked processes
        os.environ["OPENBLAS_NUM_THREADS"] = "1"  # a process that forks must have no threads of libraries

    def attempt(self, task: Task) -> Outcome:
        """Replay a log."""
        self._frames = 0, 0
        return attempt(task, on_progress=self._note)

    def _note(self, done: int, expected: int) -> None:
        self._frames = done, expected

    def frames(self) -> Frames:
        """The progress of the running replay."""
        return self._frames


class RayBackend(AbstractContextManager["RayBackend"]):
    """Runs as many tasks at a time as the cluster has CPUs.

    Args:
        address: of a cluster, as Ray takes it (``auto``, ``host:6379``, ``ray://host:10001``), or ``local``.
        jobs: CPUs of a local cluster.
        memory_bytes: memory that Ray reserves for a task.
    """

    def __init__(self, address: str, jobs: int, memory_bytes: int) -> None:
        self._address, self._jobs, self._memory_bytes = address, jobs, memory_bytes
        self.slots = 0
        self.running: Mapping[str, Frames] = {}
        self._tasks: dict[Any, tuple[Task, Any]] = {}
        self._waiting: deque[Task] = deque()
        self._starting: dict[Any, Any] = {}
        self._idle: list[Any] = []
        self._largest_bytes = 0
        self._state_at_s = 0.0
        self._exits = ExitStack()

    def __enter__(self) -> Self:
        """Start Ray or join a cluster.

        Raises:
            ClusterError: no cluster listens at the address, or Ray cannot join it.
        """
        _require_listener(self._address)
        with ExitStack() as stack:
            stack.enter_context(_joined(self._address, self._jobs, self._memory_bytes))
            self._update()
            self._exits = stack.pop_all()
        return self

    def __exit__(self, *raised: object) -> None:
        """End all tasks, and leave the cluster or end the one that was started."""
        self._exits.close()

    def submit(self, task: Task) -> None:
        """Start a task as soon as a worker is free."""
        self._waiting.append(task)
        self._assign()

    def wait(self, timeout_s: float) -> list[tuple[Task, Outcome]]:
        """The tasks that ended since the last call."""
        if time.monotonic() > self._state_at_s:
            self._update()
            self._state_at_s = time.monotonic() + _STATE_EVERY_S
        references = [*self._tasks, *self._starting]
        if not references:
            time.sleep(timeout_s)
            return []
        answered, _ = ray.wait(references, timeout=timeout_s)
        ended = [end for reference in answered if (end := self._ended(reference)) is not None]
        self._assign()
        return ended

    def _assign(self) -> None:
        """Give the waiting tasks to idle workers, and start a worker for each of the others.

        A worker may never start, because its CPU was lost; its task then waits for one that becomes idle.
        """
        while self._waiting and self._idle:
            task, worker = self._waiting.popleft(), self._idle.pop()
            self._tasks[worker.attempt.remote(task)] = task, worker
        while len(self._starting) < len(self._waiting):
            # Ray never starts a worker that asks for more memory than the largest machine has.
            memory_bytes = min(self._memory_bytes, self._largest_bytes)
            new: Any = ray.remote(Worker).options(num_cpus=1, memory=memory_bytes, max_concurrency=2).remote()
            self._starting[new.frames.remote()] = new

    def _ended(self, reference: Any) -> tuple[Task, Outcome] | None:
        """The task that ended, and its outcome; None if a worker has started.

        A worker that died is not used again. If it could not start, the task that waited for it has failed.
        """
        is_new = reference in self._starting
        task, worker = (None, self._starting.pop(reference)) if is_new else self._tasks.pop(reference)
        try:
            outcome = ray.get(reference)
            self._idle.append(worker)
        except RayError as error:
            task = self._waiting.popleft() if is_new and self._waiting else task
            outcome = Outcome("killed", f"the worker of Ray ended: {_line(error)}")
        return (task, outcome) if task is not None else None

    def _update(self) -> None:
        """Ask for the machines and the progress; Ray's own sum of resources counts lost machines for a while."""
        machines = [node["Resources"] for node in ray.nodes() if node["Alive"]]  # type: ignore[no-untyped-call]
        self._largest_bytes = int(max((machine.get("memory", 0) for machine in machines), default=0))
        self.slots = int(sum(machine.get("CPU", 0) for machine in machines))
        keys = {worker.frames.remote(): task.key for task, worker in self._tasks.values()}
        answers = ray.wait(list(keys), num_returns=len(keys), timeout=_STATE_EVERY_S)[0] if keys else []
        found = dict[str, Frames]()
        for answer in answers:
            with suppress(RayError):
                found[keys[answer]] = ray.get(answer)
        self.running = found


@contextmanager
def _joined(address: str, jobs: int, memory_bytes: int) -> Iterator[None]:
    """Join or start the cluster within the context.

    Raises:
        ClusterError: Ray cannot.
    """
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "CRITICAL"}
    with ExitStack() as stack:
        if address == LOCAL:
            options |= {
                "num_cpus": jobs,
                "num_gpus": 0,
                "include_dashboard": False,
                "object_store_memory": _OBJECTS_BYTES,
                "_memory": jobs * memory_bytes,
                "_temp_dir": stack.enter_context(_short_folder()),
            }
        handler = signal.getsignal(signal.SIGTERM)
        stack.callback(ray.shutdown)
        try:
            ray.init(address, **options)
        except Exception as error:  # Ray has no common base class
            raise ClusterError(f"--ray {address}: {_line(error)}") from error
        signal.signal(signal.SIGTERM, handler)  # Ray's own handler prints
        yield


def _short_folder() -> AbstractContextManager[str]:
    usual = tempfile.gettempdir()
    root = usual if len(usual) <= _LONGEST_FOLDER and " " not in usual else "/tmp"
    return tempfile.TemporaryDirectory(prefix="ray-", dir=Path(root), ignore_cleanup_errors=True)


def _line(error: Exception) -> str:
    """The last line of the error, which is that of a traceback."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else type(error).__name__


def _require_listener(address: str) -> None:
    """Check within seconds that a server such as Ray's listens at the address; Ray itself tries for minutes.

    Raises:
        ClusterError: no such server listens at the address, or it is invalid.
    """
    if address in {LOCAL, "auto"}:
        return
    parts = urlsplit(address if "://" in address else f"//{address}")
    with suppress(ValueError):
        host, port = parts.hostname, parts.port or (_CLIENT_PORT if parts.scheme == _CLIENT else None)
        if parts.scheme in {"", _CLIENT} and host and port:
            try:
                connection = socket.create_connection((host, port), _ANSWER_WITHIN_S)
                with connection, connection.makefile("rb") as stream:  # recv may return fewer bytes
                    connection.sendall(_GREETING)
                    answer = stream.read(4)
            except OSError as error:
                raise ClusterError(f"--ray {address}: no cluster at this address: {error}") from None
            # A server with TLS answers a plain greeting with an alert, or not at all.
            if answer[3:4] != _SETTINGS and os.environ.get("RAY_USE_TLS") != "1":
                raise ClusterError(f"--ray {address}: no cluster at this address: another program listens there")
            return
    raise ClusterError(f"--ray {address}: expected local, auto, HOST:PORT or ray://HOST:PORT")
