"""Runs each case in a forked process, which has the imports already; the system limits its time and memory."""

import contextlib
import json
import os
import resource
import shutil
import signal
import sys
import warnings
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import cv2

from roadperc_stream.cli import launch
from tests.forking import import_all, limit_memory
from tests.fuzz import contents
from tests.fuzz.cases import Case, prepared
from tests.fuzz.judge import FUZZER, Ran, crash_line, crash_of, faults

CPU_S = 10
"""CPU time of a command."""
WALL_S = 120
"""Wall-clock time of a case, if it waits or the machine is busy."""
MOST_GROWTH_BYTES = 2**30 + 2**28
"""A gigabyte, and the memory that libraries reserve for their threads."""
EVERY_AGAIN = 8
"""One replay in EVERY_AGAIN is repeated and must give the same bytes."""


@dataclass
class Verdict:
    """The outcome of a case."""

    command: str
    code: int | None = None
    message: str = ""
    """The last line on stderr."""
    faults: list[str] = field(default_factory=list)
    recipe: dict[str, Any] = field(default_factory=dict)
    line: str = "?"
    """The command line, for a person."""


def import_commands() -> None:
    """Import all modules and make the valid inputs before any process is forked."""
    import_all()
    for make in contents.BASES.values():
        make()


def run(cases: Iterable[Case], jobs: int) -> Iterator[tuple[Case, Verdict]]:
    """Run cases in `jobs` processes and yield each verdict when it is ready."""
    waiting = deque(enumerate(cases))
    running: dict[int, tuple[Case, Path]] = {}
    with TemporaryDirectory(prefix="fuzz-") as scratch:
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    number, case = waiting.popleft()
                    folder = Path(scratch, str(number))
                    folder.mkdir()
                    running[_forked(case, folder)] = case, folder
                pid, status = os.wait()
                _end_group(pid)  # also processes that the command left behind
                case, folder = running.pop(pid)
                yield case, _verdict(folder, os.waitstatus_to_exitcode(status))
                shutil.rmtree(folder)
        finally:
            for pid in running:
                _end_group(pid)


def _end_group(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)


def _verdict(folder: Path, code: int) -> Verdict:
    """The verdict that the process wrote, or one about a process that was killed."""
    with contextlib.suppress(OSError, ValueError):
        return Verdict(**json.loads((folder / "verdict").read_text()))
    late = -code in (signal.SIGXCPU, signal.SIGALRM)
    fault = f"hang: more than {CPU_S} s" if late else f"died: the process ended with {code}"
    if not (folder / "made").exists():
        return Verdict("fuzzer", faults=[f"its own fault: {fault}"])
    words, recipe = json.loads((folder / "made").read_text())
    return Verdict(words[0], faults=[fault], recipe=recipe, line=" ".join(words))


def _forked(case: Case, folder: Path) -> int:
    pid = os.fork()
    if pid:
        with contextlib.suppress(PermissionError):  # the child has done it already
            os.setpgid(pid, pid)
        return pid
    os.setpgid(0, 0)
    try:
        verdict = tried(case, folder)
    except BaseException as error:  # a fault of the fuzzer: report it and continue with the next case
        verdict = Verdict("fuzzer", faults=[f"its own fault: {crash_line(crash_of(error), FUZZER)}"])
    (folder / "verdict").write_text(json.dumps(asdict(verdict)))
    os._exit(0)


def tried(case: Case, folder: Path) -> Verdict:
    """Make a case in a new folder and run its command there. Changes the limits of this process."""
    work = folder / "work"
    work.mkdir()
    os.chdir(work)
    signal.alarm(WALL_S)
    words, recipe = prepared(case, work)
    (folder / "made").write_text(json.dumps([words, recipe]))
    limit_memory(MOST_GROWTH_BYTES)
    refused: list[str] = []
    cv2.redirectError(lambda status, _f, message, *_: refused.append(message) if status == cv2.Error.StsNoMem else None)
    first, found = _judged(words, again=sum(case.name.encode()) % EVERY_AGAIN == 0)
    found += [f"memory: OpenCV: {refused[0]}"] if refused else []
    line = " ".join(["roadperc-" + words[0], *words[1:]])
    return Verdict(words[0], first.code, _last_line(first.err), found, recipe, line)


def _limit_time() -> None:
    """Give a command its CPU time on top of the time that this process has used."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    most_s = int(used.ru_utime + used.ru_stime) + 1 + CPU_S
    resource.setrlimit(resource.RLIMIT_CPU, (most_s, resource.RLIM_INFINITY))


def _judged(words: list[str], *, again: bool) -> tuple[Ran, list[str]]:
    """Run the command, roadperc-info on every log that it wrote, and with `again` the same replay once more."""
    first = _ran(words)
    found = faults(first)
    for name in _logs(first):
        info = _ran(["info", name])
        found += faults(info) or ([f"{name} is damaged: {_last_line(info.err)}"] if info.code else [])
        if again and words[0] == "replay":
            before = Path(name).read_bytes()
            repeated = _ran([*words, "--force"])
            if repeated.code or Path(name).read_bytes() != before:
                found.append("the same replay again gives other bytes")
    return first, found


def _last_line(data: bytes) -> str:
    return next((line for line in reversed(data.decode("utf-8", "replace").splitlines()) if line.strip()), "")


def _logs(ran: Ran) -> list[str]:
    return [name for name in ran.appeared if name.endswith(".mcap") and "/" not in name] if ran.code == 0 else []


def _ran(words: list[str]) -> Ran:
    """Run the function of a command's console script; also captures the output of C libraries."""
    _limit_time()
    there, crash, code = _files(), "", None
    printed = [Path("..", name) for name in ("stdout", "stderr")]
    for number, path in enumerate(printed, 1):
        opened = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
        os.dup2(opened, number)
        os.close(opened)
    sys.stdout, sys.stderr = (open(number, "w", encoding="utf-8", closefd=False) for number in (1, 2))  # noqa: SIM115
    sys.argv = [f"roadperc-{words[0]}", *words[1:]]
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        for unseen in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", unseen)
        try:
            with patch.object(launch, "_is_limited", return_value=False):  # polars' threads do not survive a fork
                code = getattr(launch, words[0])()
        except BaseException as error:  # Rust panics are not an Exception
            crash = crash_of(error)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    return Ran(tuple(words), code, printed[0].read_bytes(), printed[1].read_bytes(), crash, _appeared(there))


def _files() -> set[str]:
    return {str(path) for path in Path().rglob("*") if path.is_symlink() or not path.is_dir()}


def _appeared(there: set[str]) -> tuple[str, ...]:
    return tuple(sorted(_files() - there))
