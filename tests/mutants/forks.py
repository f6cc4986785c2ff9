"""Work in forked processes: each has the libraries imported already, a folder of its own, and leaves nothing behind."""

import contextlib
import importlib
import os
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

Job = TypeVar("Job")

LIBRARIES = (  # slow to import and none of them starts a thread by it
    "pytest", "hypothesis", "numpy", "cv2", "scipy.optimize", "scipy.interpolate", "scipy.ndimage", "scipy.spatial",
    "scipy.stats", "pydantic", "google.protobuf.json_format", "foxglove_schemas_protobuf", "mcap.reader", "mcap.writer",
    "rosbags.typesys", "rich.console", "jinja2", "PIL.Image", "tomli_w", "zstandard",
)  # fmt: skip
LOOK_SECONDS = 0.05
BEAT = "beat"  # the file a worker touches for a sign of life
OUTPUT = "output"  # the file that has what a worker prints


@dataclass(frozen=True)
class Ended(Generic[Job]):
    """A job whose process has ended: with its exit code, or hung where it gave no sign of life for too long."""

    job: Job
    folder: Path
    code: int
    hung: bool


def import_libraries() -> None:
    """Imports what all workers share, so that none has to."""
    for name in LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


def run(
    jobs: Iterable[Job], work: Callable[[Job, Path], int], patience_s: Callable[[Job], float], workers: int
) -> Iterator[Ended[Job]]:
    """Does `work(job, folder)` for each job, `workers` at a time, each in a forked process; yields them as they end.

    A worker that touches `folder / BEAT` less often than every `patience_s(job)` seconds has hung and is killed. The
    folder lasts until the next job is asked for.
    """
    waiting, running = iter(jobs), {}
    try:
        while True:
            while len(running) < workers and (job := next(waiting, None)) is not None:
                folder = Path(tempfile.mkdtemp(prefix="mutant-"))
                running[_start(job, folder, work)] = job, folder
            if not running:
                return
            time.sleep(LOOK_SECONDS)
            for pid, (job, folder) in list(running.items()):
                ended = _look(pid, job, folder, patience_s(job))
                if ended is not None:
                    del running[pid]
                    yield ended
                    shutil.rmtree(folder, ignore_errors=True)
    finally:
        for pid, (_, folder) in running.items():
            _kill(pid)
            os.waitpid(pid, 0)
            shutil.rmtree(folder, ignore_errors=True)


def _start(job: Job, folder: Path, work: Callable[[Job, Path], int]) -> int:
    (folder / BEAT).touch()
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        return pid
    code = 70  # what an exception in `work` ends with
    try:
        os.setsid()
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)  # which shells ignore for what runs in the background
        _divert_output(folder / OUTPUT)
        code = work(job, folder)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _divert_output(file: Path) -> None:
    """Lets stdout and stderr go to a file and nothing come from stdin."""
    output = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for stream, source in ((0, os.open(os.devnull, os.O_RDONLY)), (1, output), (2, output)):
        os.dup2(source, stream)
    sys.stdout, sys.stderr = (os.fdopen(stream, "w", buffering=1, encoding="utf-8", closefd=False) for stream in (1, 2))


def _look(pid: int, job: Job, folder: Path, patience_s: float) -> Ended[Job] | None:
    ended, status = os.waitpid(pid, os.WNOHANG)
    if ended:
        _kill(pid)  # what a test may have left running
        return Ended(job, folder, os.waitstatus_to_exitcode(status), hung=False)
    if time.time() - (folder / BEAT).stat().st_mtime <= patience_s:
        return None
    _kill(pid)
    os.waitpid(pid, 0)
    return Ended(job, folder, -signal.SIGKILL, hung=True)


def _kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)
