"""One attempt at a log, in a separate process with limits on time and memory.

Both back ends call ``attempt``. A log that crashes, hangs or fills the memory ends only its own process. The process is
forked from one that has imported the modules of a replay, so it starts within hundredths of a second.
"""

import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
import traceback
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from time import monotonic
from typing import Final
from uuid import uuid4

import psutil

from roadperc_stream.batch.task import Outcome, Task, this_worker
from roadperc_stream.batch.worker import scratch_of, work
from roadperc_stream.errors import RoadpercError, TargetError
from roadperc_stream.system.progress import Progress, at_most_every, no_progress

OUTPUT: Final = "log"
"""The folder of a dataset for the output of the workers."""
_CHECK_EVERY_S: Final = 0.1
_PROGRESS_EVERY_S: Final = 0.2
_CONTEXT: Final = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload(["roadperc_stream.batch.worker"])
_starting: Final = threading.Lock()


def attempt(task: Task, stop: threading.Event | None = None, on_progress: Progress = no_progress) -> Outcome:
    """Replay a log into the dataset; a crash of the process also gives an outcome.

    ``stop`` ends the process when set; ``on_progress`` is called during the replay.

    Returns:
        The outcome of ``work``, or ``timeout``, ``memory`` or ``killed``.
    """
    started = monotonic()
    try:
        outcome = _attempt(task, stop or threading.Event(), on_progress)
    except TargetError as error:
        outcome = Outcome("unreachable", str(error))
    except OSError as error:
        outcome = Outcome("unreachable", f"{error.filename or scratch_of(task)}: {error.strerror or error}")
    return replace(outcome, seconds=outcome.seconds or monotonic() - started, worker=outcome.worker or this_worker())


def _attempt(task: Task, stop: threading.Event, on_progress: Progress) -> Outcome:
    if task.job.out.is_local and not Path(task.job.out.address).is_dir():
        error = "no such folder on this machine; mount it here, or use an address"
        return Outcome("unreachable", f"{task.job.out.address}: {error}")
    scratch = scratch_of(task)
    printed = scratch.with_name(f"{scratch.name}.{uuid4().hex}.log")
    printed.parent.mkdir(parents=True, exist_ok=True)
    receiver, sender = _CONTEXT.Pipe(duplex=False)
    process = _CONTEXT.Process(target=_run, args=(task, printed, sender), daemon=True)
    with _starting:
        process.start()
    sender.close()
    try:
        outcome = _watched(task, process, receiver, stop, on_progress)
    finally:
        process.kill()
        process.join()
        receiver.close()
    hint = _keep_printed(task, printed)
    return outcome or Outcome("killed", f"its process ended by {_end_of(process.exitcode)}{hint}")


def _watched(
    task: Task, process: ForkServerProcess, receiver: Connection, stop: threading.Event, on_progress: Progress
) -> Outcome | None:
    """The outcome that a process sends, or the reason to kill it; None if it ended without an outcome."""
    job, started = task.job, monotonic()
    while not stop.is_set():
        wait([receiver, process.sentinel], _CHECK_EVERY_S)
        while receiver.poll():
            try:
                message = receiver.recv()
            except (EOFError, OSError):
                process.join()
                return None
            if isinstance(message, Outcome):
                return message
            on_progress(*message)
        if job.timeout_s is not None and monotonic() - started > job.timeout_s:
            return Outcome("timeout", f"took more than the {job.timeout_s:g} s of --timeout")
        if (used := _memory_bytes(process)) > job.memory_bytes:
            limit, found = (f"{size / 1e6:.0f} MB" for size in (job.memory_bytes, used))
            error = f"used {found}, more than the {limit} of --memory"
            return Outcome("memory", error, peak_memory_mb=used / 1e6)
    return Outcome("killed", "the batch was stopped")


def _memory_bytes(process: ForkServerProcess) -> int:
    with suppress(psutil.Error):
        return int(psutil.Process(process.pid).memory_info().rss)
    return 0


def _end_of(code: int | None) -> str:
    with suppress(ValueError):
        return signal.Signals(-(code or 0)).name
    return f"exit code {code}"


def _keep_printed(task: Task, printed: Path) -> str:
    """Put the output of the process, if any, into the dataset; returns the hint where it is."""
    hint = ""
    with suppress(OSError, RoadpercError):
        if printed.stat().st_size:
            name = f"{OUTPUT}/{task.log.stem}-{task.key}.txt"
            task.job.out.at(name).put(printed)
            hint = f"; see {name}"
        for leftover in printed.parent.glob(f"{task.key}.*.log"):  # also of attempts whose batch was killed
            leftover.unlink(missing_ok=True)
    return hint


def _run(task: Task, printed: Path, sender: Connection) -> None:
    """Run in the new process: send the progress and finally the outcome."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to all processes; the batch ends this one
    _print_to(printed)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        outcome = work(task, at_most_every(_PROGRESS_EVERY_S, lambda done, expected: sender.send((done, expected))))
    except Exception as error:  # only this log fails
        traceback.print_exc()
        text = f"{type(error).__name__}: {error}; {OUTPUT}/ has the traceback"
        outcome = Outcome("killed", " ".join(text.splitlines()), worker=this_worker())
    sender.send(outcome)


def _end_with_parent() -> None:
    """End this process when its parent has ended, for example with a node of a cluster."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _print_to(path: Path) -> None:
    """Redirect the output of this process, its libraries and a crash to a file."""
    with path.open("wb") as file:
        for number in (1, 2):
            os.dup2(file.fileno(), number)
    sys.stdout = open(1, "w", buffering=1, encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", buffering=1, encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
    faulthandler.enable(sys.stderr)
