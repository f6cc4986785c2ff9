"""Cases shared out to worker processes that are bounded in time and memory; one that a case kills is replaced."""

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.fuzz.judge import ROOT
from tests.fuzz.trying import SECONDS, WAITING_S, Verdict, without_answer

WARM_UP_S = 180.0
ENDING_S = 10.0
CASES_OF_A_WORKER = 500
"""Then it is replaced: a recording of Rerun's SDK leaves two threads in its process, which wake up again and again."""


@dataclass(frozen=True)
class Order:
    """A case to try: in the worker, or as processes of its own."""

    case: str
    whole: bool = False


class Worker:
    """A process that tries cases, and the one it is at."""

    def __init__(self) -> None:
        # One arena: each of glibc's takes 64 MB of address space, which is what is limited.
        environment = os.environ | {"MALLOC_ARENA_MAX": "1", "PYTHONPATH": str(ROOT)}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.worker"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env=environment, start_new_session=True,
        )  # fmt: skip
        self.order: Order | None = None
        self.tried = 0
        self.is_making = False
        """Whether the case is still being made: what happens then is no fault of a command."""
        self._buffer = b""
        self.begin(WARM_UP_S, WARM_UP_S)

    def begin(self, cpu_s: float = SECONDS, wall_s: float = WAITING_S) -> None:
        """Something begins that may take so long."""
        self._last_cpu_s, self._last_wall_s = self._cpu_s() + cpu_s, time.monotonic() + wall_s

    def is_late(self) -> bool:
        """Whether it takes longer; time of the processor, for others may use the machine, or far longer of the day."""
        return self._cpu_s() > self._last_cpu_s or time.monotonic() > self._last_wall_s

    def _cpu_s(self) -> float:
        fields = Path(f"/proc/{self.process.pid}/stat").read_text("ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def fileno(self) -> int:
        """What becomes readable when it answers."""
        assert self.process.stdout
        return self.process.stdout.fileno()

    def give(self, order: Order) -> None:
        """Let it try a case."""
        assert self.process.stdin
        self.order, self.is_making = order, True
        self.begin()
        self.process.stdin.write(json.dumps({"case": order.case, "whole": order.whole}).encode() + b"\n")
        self.process.stdin.flush()

    def answers(self) -> Iterator[dict[str, Any] | None]:
        """What it has said; None where it has ended."""
        data = os.read(self.fileno(), 1 << 20)
        if not data:
            self.process.wait(ENDING_S)
            yield None
            return
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        for line in lines:
            yield json.loads(line)

    def end(self) -> int:
        """Kill it and all it has started; its exit code."""
        with contextlib.suppress(ProcessLookupError):  # what it has started lives on where it has ended
            os.killpg(self.process.pid, signal.SIGKILL)
        for stream in (self.process.stdin, self.process.stdout):
            if stream:
                stream.close()
        return self.process.wait()


def run(orders: Iterable[Order], jobs: int) -> Iterator[tuple[Order, Verdict]]:
    """Try cases in so many processes; the verdicts come as they are found.

    Raises:
        RuntimeError: a worker does not even start.
    """
    waiting = deque(orders)
    workers: list[Worker] = []
    with selectors.DefaultSelector() as selector:
        try:
            for _ in range(min(jobs, len(waiting))):
                _start(workers, selector)
            while workers:
                for key, _ in selector.select(timeout=0.5):
                    yield from _heard(key.fileobj, waiting, workers, selector)  # type: ignore[arg-type]
                for worker in [worker for worker in workers if worker.is_late()]:
                    yield from _hung(worker, waiting, workers, selector)
        finally:
            for worker in workers:
                worker.end()


def _start(workers: list[Worker], selector: selectors.BaseSelector) -> None:
    worker = Worker()
    workers.append(worker)
    selector.register(worker, selectors.EVENT_READ)


def _stop(worker: Worker, workers: list[Worker], selector: selectors.BaseSelector) -> int:
    selector.unregister(worker)
    workers.remove(worker)
    return worker.end()


def _heard(
    worker: Worker, waiting: deque[Order], workers: list[Worker], selector: selectors.BaseSelector
) -> Iterator[tuple[Order, Verdict]]:
    for answer in worker.answers():
        if answer is None:
            yield from _died(worker, waiting, workers, selector)
            return
        if "beat" in answer and worker.order:
            worker.is_making = False
            worker.begin()
            continue
        if "verdict" in answer and worker.order:
            worker.tried += 1
            yield worker.order, Verdict(**answer["verdict"])
        worker.order = None
        if not waiting or worker.tried == CASES_OF_A_WORKER:
            _stop(worker, workers, selector)
            if waiting:
                _start(workers, selector)
            return
        worker.give(waiting.popleft())


def _died(
    worker: Worker, waiting: deque[Order], workers: list[Worker], selector: selectors.BaseSelector
) -> Iterator[tuple[Order, Verdict]]:
    code, order = _stop(worker, workers, selector), worker.order
    if order is None:
        raise RuntimeError(f"a worker ended with {code} before its first case")
    if waiting:
        _start(workers, selector)
    yield order, _without_answer(worker, f"died: the process ended with {code}")


def _hung(
    worker: Worker, waiting: deque[Order], workers: list[Worker], selector: selectors.BaseSelector
) -> Iterator[tuple[Order, Verdict]]:
    order = worker.order
    _stop(worker, workers, selector)
    if order is None:
        raise RuntimeError(f"a worker was not ready after {WARM_UP_S:.0f} s")
    if waiting:
        _start(workers, selector)
    yield order, _without_answer(worker, f"hang: more than {SECONDS:.0f} s")


def _without_answer(worker: Worker, fault: str) -> Verdict:
    return without_answer("fuzzer", f"its own fault: {fault}") if worker.is_making else without_answer("?", fault)
