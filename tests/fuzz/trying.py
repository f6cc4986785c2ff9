"""A case tried: its commands run, in this process or as processes of their own, and what they did judged.

The logs that are written have a second reader, MCAP's own TypeScript one where Node has it: it is looked for as
``mcap-validate/validate.mjs`` in the folder ``tools`` beside the recordings.
"""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

from roadperc_stream.cli import launch
from tests import commands
from tests.conftest import DEFAULT_DATA
from tests.fuzz import bounds
from tests.fuzz.cases import Case, prepared
from tests.fuzz.judge import Ran, crash_of, faults, kind_of_message

SECONDS = 10.0
"""Of the processor, for a command."""
STARTING_S = 5.0
"""Of it, until a process has imported its libraries."""
WAITING_S = 120.0
"""Of the day, for a command that does nothing, or on a machine that does all else."""
EVERY_AGAIN = 8
"""Of so many replays one is repeated: it must give the same bytes."""
Runner = Callable[[list[str], Path], Ran]


@dataclass
class Verdict:
    """What came of a case."""

    command: str
    codes: list[int | None]
    message: str
    """What stderr said, without the names and numbers of the case."""
    faults: list[str]
    recipe: dict[str, Any]
    line: str
    """The command line, for a person."""
    grown_bytes: int = 0
    seconds: float = 0.0
    wrote: list[str] = field(default_factory=list)


def without_answer(command: str, fault: str) -> Verdict:
    """Of a case that came to no end."""
    return Verdict(command, [None], "", [fault], {}, "?")


def tried(case: Case, started: Callable[[], None], limit_bytes: int | None = None) -> Verdict:
    """Run a case in a folder of its own.

    Args:
        case: the case.
        started: called before each command.
        limit_bytes: of address space, for commands as processes of their own; None runs them in this one.
    """
    run: Runner = in_process if limit_bytes is None else partial(as_process, limit_bytes=limit_bytes)
    with TemporaryDirectory(prefix="fuzz-") as name, contextlib.chdir(name):
        folder = Path(name)
        words, recipe = prepared(case, folder)
        bounds.watch_opencv()
        before = bounds.memory()["VmRSS"]
        bounds.forget_peak()
        began = time.monotonic()
        runs = list(_runs(words, folder, run, started, sum(case.name.encode()) % EVERY_AGAIN == 0))
        found = [fault for _, faults_found in runs for fault in faults_found]
        found += bounds.refused()
        if limit_bytes is not None:
            found += [fault for name in _logs(runs[0][0]) for fault in damages(folder / name)]
        first = runs[0][0]
        return Verdict(
            words[0], [ran.code for ran, _ in runs], kind_of_message(_last_line(first.err)), found, recipe,
            " ".join(["roadperc-" + words[0], *words[1:]]), max(bounds.memory()["VmHWM"] - before, 0),
            time.monotonic() - began, list(first.appeared),
        )  # fmt: skip


def _last_line(data: bytes) -> str:
    return next((line for line in reversed(data.decode("utf-8", "replace").splitlines()) if line.strip()), "")


def _runs(
    words: list[str], folder: Path, run: Runner, started: Callable[[], None], again: bool
) -> Iterator[tuple[Ran, list[str]]]:
    """The command, then roadperc-info on every log it wrote, then a replay once more."""
    started()
    ran = run(words, folder)
    yield ran, faults(ran)
    for name in _logs(ran):
        started()
        told = run(["info", name], folder)
        reason = kind_of_message(_last_line(told.err))
        yield told, faults(told) or ([f"{name} is not whole: {reason}"] if told.code else [])
    if again and words[0] == "replay" and ran.code == 0 and _logs(ran):
        started()
        (name,) = _logs(ran)
        first = (folder / name).read_bytes()
        repeated = run([*words, "--force"], folder)
        same = repeated.code == 0 and (folder / name).read_bytes() == first
        yield repeated, [] if same else ["the same replay again gives other bytes"]


def _logs(ran: Ran) -> list[str]:
    return [name for name in ran.appeared if name.endswith(".mcap") and "/" not in name] if ran.code == 0 else []


def in_process(words: list[str], folder: Path) -> Ran:
    """Run a command by what its console script calls; what its C libraries print is caught as well."""
    there = _files(folder)
    crash, code = "", None
    with _diverted() as printed:
        try:
            sys.argv = [f"roadperc-{words[0]}", *words[1:]]
            with patch.object(launch, "_is_limited", return_value=False):  # a fork would have none of polars' threads
                code = getattr(launch, words[0])()
        except BaseException as error:  # also what Rust throws, which is no Exception
            crash = crash_of(error)
    out, err = printed
    return Ran(tuple(words), code, bytes(out), bytes(err), crash, _appeared(there, folder))


@contextlib.contextmanager
def _diverted() -> Iterator[tuple[bytearray, bytearray]]:
    """Lets stdout and stderr go to files, on the level of the system, and gives what they hold at the end."""
    printed = bytearray(), bytearray()
    names = [f"{os.getpid()}.{number}" for number in (1, 2)]
    with TemporaryDirectory(prefix="fuzz-printed-") as folder, warnings.catch_warnings():
        warnings.simplefilter("always")
        for unseen in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", unseen)
        kept = [os.dup(number) for number in (1, 2)]
        streams = sys.stdout, sys.stderr
        try:
            for number, name in zip((1, 2), names, strict=True):
                opened = os.open(Path(folder, name), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
                os.dup2(opened, number)
                os.close(opened)
            sys.stdout, sys.stderr = (os.fdopen(number, "w", encoding="utf-8", closefd=False) for number in (1, 2))
            yield printed
        finally:
            for stream in (sys.stdout, sys.stderr):
                with contextlib.suppress(OSError, ValueError):
                    stream.flush()
            sys.stdout, sys.stderr = streams
            for number, before in zip((1, 2), kept, strict=True):
                os.dup2(before, number)
                os.close(before)
            for target, name in zip(printed, names, strict=True):
                target.extend(Path(folder, name).read_bytes())


def as_process(words: list[str], folder: Path, limit_bytes: int) -> Ran:
    """Run a command as a user does, without this environment, and within the limits."""
    there = _files(folder)
    variables = {name: os.environ[name] for name in ("HOME", "PATH") if name in os.environ}
    done = subprocess.run(
        commands.words(f"roadperc-{words[0]}", *words[1:]), cwd=folder, capture_output=True, check=False,
        env=variables | {"PYTHONPATH": os.pathsep.join(sys.path), "MALLOC_ARENA_MAX": "2"},
        preexec_fn=partial(bounds.limit_process, limit_bytes, int(SECONDS + STARTING_S)),
    )  # fmt: skip
    return Ran(tuple(words), done.returncode, done.stdout, done.stderr, "", _appeared(there, folder))


def _files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()}


def _appeared(there: set[str], folder: Path) -> tuple[str, ...]:
    return tuple(sorted(_files(folder) - there))


WARMING = (
    "replay in.mcap out.mcap", "info out.mcap", "view out.mcap --save out.rrd", "view out.mcap --video out.mp4",
    "view out.mcap --foxglove-layout out.json", "report out.mcap --html out.html", "compare out.mcap out.mcap",
    "trajectory out.mcap", "lanes out.mcap --tusimple lanes.json", "sweep in.mcap --vary seed=1,2 --jobs 1",
    "convert dump dump.mcap",
)  # fmt: skip


def warm_up(source: bytes, write_dump: Callable[[Path], None]) -> None:
    """Import what the commands import, so that no case pays for it in time or memory.

    Raises:
        RuntimeError: a command fails without any fault in its input.
    """
    with TemporaryDirectory(prefix="fuzz-") as name, contextlib.chdir(name):
        Path("in.mcap").write_bytes(source)
        write_dump(Path("dump"))
        for line in WARMING:
            ran = in_process(line.split(), Path(name))
            if ran.code and ran.words[0] != "trajectory":  # in pictures this small odometry finds nothing
                raise RuntimeError(f"{line}: {ran.err.decode()}")


PATIENCE_S = 60


@cache
def program() -> Path | None:
    """The validator; None where it, its libraries or Node are missing."""
    data = Path(os.environ.get("ROADPERC_DATA", DEFAULT_DATA))
    path = data.parent / "tools" / "mcap-validate" / "validate.mjs"
    there = shutil.which("node") and path.is_file() and (path.parent / "node_modules").is_dir()
    return path if there else None


def damages(log: Path) -> list[str]:
    """What the validator finds wrong with a log; what stands in the input's messages, which are copied, is not."""
    path = program()
    if path is None:
        return []
    done = subprocess.run(
        ["node", path, "--json", log], capture_output=True, check=False, timeout=PATIENCE_S,
        preexec_fn=bounds.lift_limit,  # Node alone takes ten gigabytes of address space
    )  # fmt: skip
    try:
        found = json.loads(done.stdout)
    except ValueError:
        return [f"validator: {kind_of_message(done.stderr.decode('utf-8', 'replace'))}"]
    copied = tuple(c["topic"] for c in found.get("channels", ()) if not c["topic"].startswith("/perception/"))
    return [f"validator: {kind_of_message(text)}" for text in found["problems"] if not text.startswith(copied)]
