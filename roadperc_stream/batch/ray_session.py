"""The process that connects to Ray: ``python -m roadperc_stream.batch.ray_session FILE_DESCRIPTOR``.

It reads tasks from the pipe, and writes outcomes and the size of the cluster to it. When the pipe closes, this process
leaves the cluster, or ends the Ray that it has started.
"""

import logging
import re
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, Final

import ray
from ray.exceptions import NodeDiedError, OutOfMemoryError, RayError, RayTaskError, WorkerCrashedError

from roadperc_stream.batch import cluster
from roadperc_stream.batch.backend import Frames
from roadperc_stream.batch.task import Outcome, Task
from roadperc_stream.errors import ClusterError

_OBJECTS_BYTES: Final = 100_000_000
"""Ray's object store, of the smallest size: outcomes are small and bypass it."""
_STATE_EVERY_S: Final = 1.0
_CHECK_WITHIN_S: Final = 75.0
"""Ray starts its first worker in this time: 10 s on a quiet machine, more than 30 s on a busy one."""
_LONGEST_FOLDER: Final = 36
"""Characters of a folder below which Ray's sockets have names short enough for the system."""
_COLOURS: Final = re.compile(r"\x1b\[\d+m")


def main() -> None:
    """Serve the batch at the other end of the pipe until the pipe closes."""
    connection = Connection(int(sys.argv[1]))
    request: cluster.ClusterRequest = connection.recv()
    try:
        with _joined(request):
            _Session(connection, request).serve()
    except Exception as error:  # Ray has no common base class; the batch prints the line
        with suppress(OSError):
            connection.send(_line(error))


@contextmanager
def _joined(request: cluster.ClusterRequest) -> Iterator[None]:
    """Join or start the cluster within the context.

    Raises:
        ClusterError: the workers have another version than the batch.
    """
    is_local = request.address == cluster.LOCAL
    started: AbstractContextManager[dict[str, Any]] = _local(request) if is_local else nullcontext({})
    with started as options:
        ray.init(request.address, log_to_driver=False, logging_level=logging.CRITICAL, **options)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)  # Ray's own handler prints
        try:
            check = ray.remote(cluster.version_on_node).options(num_cpus=0)
            if ray.get(check.remote(), timeout=_CHECK_WITHIN_S) != request.version:
                raise ClusterError(
                    "its machines have another version of roadperc_stream than this one; install the same version"
                )
            yield
        finally:
            ray.shutdown()


@contextmanager
def _local(request: cluster.ClusterRequest) -> Iterator[dict[str, Any]]:
    """The options for a Ray on this machine that reserves no more than a batch without Ray uses."""
    usual = tempfile.gettempdir()
    root = usual if len(usual) <= _LONGEST_FOLDER and " " not in usual else "/tmp"
    with tempfile.TemporaryDirectory(prefix="ray-", dir=root, ignore_cleanup_errors=True) as folder:
        yield {
            "num_cpus": request.jobs,
            "num_gpus": 0,
            "include_dashboard": False,
            "object_store_memory": _OBJECTS_BYTES,
            "_memory": request.jobs * request.memory_bytes,
            "_temp_dir": folder,
        }


class _Session:
    """Runs the tasks of a batch on a cluster."""

    def __init__(self, connection: Connection, request: cluster.ClusterRequest) -> None:
        self._connection, self._request = connection, request
        self._sending = threading.Lock()
        self._tasks: dict[str, Any] = {}
        # Ray restarts the count on another machine if its machine is lost.
        self._count: Any = ray.remote(cluster.FrameCount).options(num_cpus=0, max_restarts=-1).remote()
        self._attempt = ray.remote(cluster.attempt_on_node)
        self._largest_bytes = 0

    def serve(self) -> None:
        """Run tasks until the batch closes the pipe; then end the running tasks."""
        self._send_state()
        threading.Thread(target=self._keep_sending, daemon=True).start()
        with suppress(EOFError, OSError):
            while True:
                self._submit(self._connection.recv())
        for reference in list(self._tasks.values()):
            with suppress(Exception):
                ray.cancel(reference, force=True)

    def _submit(self, task: Task) -> None:
        """Start a task with at most the memory of the largest machine; Ray never starts a task that asks for more."""
        memory_bytes = min(self._request.memory_bytes, self._largest_bytes)
        name = f"replay {task.log.stem}"  # in the dashboard, and the title of the worker's process
        call = self._attempt.options(name=name, num_cpus=1, memory=memory_bytes, max_retries=0)
        reference = call.remote(task, self._count)
        self._tasks[task.key] = reference
        reference.future().add_done_callback(partial(self._ended, task.key))

    def _ended(self, key: str, future: "Future[Outcome]") -> None:
        self._tasks.pop(key, None)
        error = future.exception()
        self._send(cluster.TaskEnd(key, future.result() if error is None else Outcome("killed", _line(error))))

    def _keep_sending(self) -> None:
        while not threading.Event().wait(_STATE_EVERY_S):
            with suppress(RayError, OSError):
                self._send_state()

    def _send_state(self) -> None:
        """Send CPUs and progress; Ray's own sum of resources counts lost machines for a while."""
        nodes: list[dict[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call]
        machines = [node["Resources"] for node in nodes if node["Alive"]]
        self._largest_bytes = int(max((machine.get("memory", 0) for machine in machines), default=0))
        self._send(cluster.ClusterState(int(sum(machine.get("CPU", 0) for machine in machines)), self._running()))

    def _running(self) -> dict[str, Frames]:
        with suppress(RayError):
            frames: dict[str, Frames] = ray.get(self._count.all.remote(), timeout=_STATE_EVERY_S)
            return frames
        return {}

    def _send(self, message: cluster.SessionMessage) -> None:
        with self._sending, suppress(OSError):
            self._connection.send(message)


def _line(error: BaseException) -> str:
    """The error in a line: the last line of a traceback."""
    lines = [line.strip() for line in _COLOURS.sub("", str(error)).strip().splitlines()] or [type(error).__name__]
    match error:
        case RayTaskError():
            return f"the task failed on its machine: {lines[-1]}"
        case NodeDiedError():
            return "the machine of the task left the cluster"
        case WorkerCrashedError():
            return "the worker of the task died"
        case OutOfMemoryError():
            return "the machine of the task ran out of memory"
    return lines[-1] if any(line.endswith("(most recent call last):") for line in lines) else " ".join(lines)


if __name__ == "__main__":
    main()
