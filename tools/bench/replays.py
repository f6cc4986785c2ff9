"""Measure programs from outside, in particular replays with this version or another one."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Final

import numpy as np

from roadperc_stream.api import read_metrics
from roadperc_stream.errors import ProgramError

from .inputs import WARM_UP, BenchLog

_NO_PART: Final = frozenset({"sync_skew_ms", "wall_ms"})
"""Columns in milliseconds that are not part of a frame's total."""
_STARTER: Final = """
import json, os, sys, time
null = os.open(os.devnull, os.O_RDWR)
actions = [(os.POSIX_SPAWN_DUP2, null, 0), (os.POSIX_SPAWN_DUP2, null, 1)]
started = time.perf_counter()
child = os.posix_spawnp(sys.argv[1], sys.argv[1:], os.environ, file_actions=actions)
_, status, used = os.wait4(child, 0)
wall_s = time.perf_counter() - started
print(json.dumps((os.waitstatus_to_exitcode(status), wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss)))
"""
"""A small program that starts the measured one, because peak memory includes that of the starting process."""
_KIB: Final = 1 if sys.platform == "darwin" else 1024


@dataclass(frozen=True)
class Cost:
    """Wall time, CPU time of all cores, and peak memory."""

    wall_s: float
    cpu_s: float
    peak_mb: float


def cost_of(name: str, command: Sequence[str]) -> Cost:
    """Run a program without its stdout and measure it.

    Raises:
        ProgramError: the program fails; the message contains ``name``.
    """
    starter_command = [sys.executable, "-I", "-S", "-c", _STARTER, *command]
    started = subprocess.run(starter_command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, check=False)
    if started.returncode:
        raise ProgramError(f"{name} could not be started")
    code, wall_s, cpu_s, peak = json.loads(started.stdout)
    if code:
        raise ProgramError(f"{name} ended with exit code {code}")
    return Cost(wall_s, cpu_s, peak * _KIB / 1e6)


def replay_command(*arguments: str | Path, package: Path | None = None) -> list[str]:
    """Return the command of a replay with this package or a folder's package; ``-P`` ignores the working directory."""
    found = "" if package is None else f"sys.path.insert(0, {str(package)!r}); "
    code = f"import sys; {found}from roadperc_stream.cli.launch import replay; sys.exit(replay())"
    return [sys.executable, "-P", "-c", code, *map(str, arguments)]


def replay_cost(name: str, log: BenchLog, out: Path, threads: int, package: Path | None = None) -> dict[str, float]:
    """Replay a log; return ``cpu`` and ``wall`` per frame without the start, peak memory, first frame and parts.

    The start is the time of a separate replay of the first ``WARM_UP`` frames. ``package`` is the folder of another
    version.

    Raises:
        ProgramError: a replay fails; the message contains ``name``.
    """
    options, short = ("--threads", str(threads), "--force", "--quiet"), out.with_suffix(".short.mcap")
    paths = ((log.first_frame, short), (log.warm_up, short), (log.path, out))
    first, warm_up, whole = (cost_of(name, replay_command(*pair, *options, package=package)) for pair in paths)
    start = {"first frame/cpu": first.cpu_s * 1000, "first frame/wall": first.wall_s * 1000}
    return a_frame(warm_up, whole, log.frames) | start | parts(out)


def a_frame(warm_up: Cost, whole: Cost, frames: int) -> dict[str, float]:
    """Return time per frame and peak memory, from the cost of a replay and of its start."""
    return {
        "cpu": (whole.cpu_s - warm_up.cpu_s) / (frames - WARM_UP) * 1000,
        "wall": (whole.wall_s - warm_up.wall_s) / (frames - WARM_UP) * 1000,
        "peak_mb": whole.peak_mb,
    }


def parts(out: Path) -> dict[str, float]:
    """Return means of the time columns after the start, their sum over the total, and the spread of objects."""
    rows = read_metrics(out)[WARM_UP:]
    columns = [name for name in rows.columns if name.endswith("_ms") and name not in _NO_PART]
    found = {name.removesuffix("_ms"): rows[name].drop_nulls().to_numpy() for name in columns}
    means = {name: float(values.mean()) for name, values in found.items() if len(values)}
    objects_ms = found["objects"]
    return {f"part/{name}": value for name, value in means.items()} | {
        "parts over total": sum(value for name, value in means.items() if name != "total") / means["total"],
        "objects p95 over median": float(np.quantile(objects_ms, 0.95) / np.median(objects_ms)),
    }


def start_cost(name: str, command: Sequence[str]) -> dict[str, float]:
    """Return the time of a short program in ms, medians of three runs."""
    costs = [cost_of(name, command) for _ in range(3)]
    return {"cpu": median(cost.cpu_s for cost in costs) * 1000, "wall": median(cost.wall_s for cost in costs) * 1000}


_REPOSITORY: Final = Path(__file__).resolve().parents[2]


@contextmanager
def installed(commit: str) -> Iterator[Path]:
    """Yield a temporary folder with a commit's package and its compiled kernels; libraries are those in use.

    Raises:
        ProgramError: the commit does not exist or cannot be installed.
    """
    revision = _output(
        "git", "-C", str(_REPOSITORY), "rev-parse", "--verify", "--quiet", f"{commit}^{{commit}}"
    ).strip()
    with tempfile.TemporaryDirectory(prefix="roadperc-bench-") as folder:
        pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-deps")
        _output(*pip, "--target", folder, f"git+file://{_REPOSITORY}@{revision}")
        yield Path(folder)


def _output(*command: str) -> str:
    """Return the stdout of a program.

    Raises:
        ProgramError: the program fails; the message has its last line.
    """
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise ProgramError(f"{' '.join(command)} ended with exit code {done.returncode}: {last}")
    return done.stdout
