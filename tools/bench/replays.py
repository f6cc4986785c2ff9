"""What a replay takes, from outside: the command in a process of its own, here or in another installation."""

import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream.api import read_metrics
from roadperc_stream.errors import ProgramError
from roadperc_stream.system.cost import Cost, cost_of

from .figures import BenchJob
from .inputs import WARM_UP, BenchLog

_COMMAND: Final = "import sys; from roadperc_stream.cli.launch import replay; sys.exit(replay())"
_THREADS: Final = "--threads"
_NO_PART: Final = frozenset({"sync_skew_ms", "wall_ms"})
"""Columns in milliseconds that are no share of a frame's total."""


@dataclass(frozen=True)
class Installation:
    """A version of the package: the interpreter that finds it, and whether its replay can be told its threads."""

    python: Path
    takes_threads: bool

    @classmethod
    def of(cls, python: Path) -> "Installation":
        """The one that an interpreter finds.

        Raises:
            ProgramError: it finds none that runs.
        """
        said = subprocess.run([*_words(python), "--help"], capture_output=True, text=True, check=False)
        if said.returncode:
            raise ProgramError(f"{python}: roadperc-replay --help ended with exit code {said.returncode}")
        return cls(python, _THREADS in said.stdout)

    def replay(self, *arguments: str | Path) -> list[str]:
        """The words of a replay."""
        return [*_words(self.python), *map(str, arguments)]

    def threads(self, count: int) -> Sequence[str]:
        """The arguments that ask for so many threads; none where there is always one."""
        return (_THREADS, str(count)) if self.takes_threads else ()


def _words(python: Path) -> list[str]:
    """``-P`` keeps the folder it is started in from standing in for what is installed."""
    return [str(python), "-P", "-c", _COMMAND]


def replay_job(name: str, installation: Installation, log: BenchLog, out: Path, threads: int) -> BenchJob:
    """The job of replaying a log: ``cpu`` and ``wall`` a frame without the start, peak memory, the first frame, parts.

    The start is what the log's first ``WARM_UP`` frames alone take, in a run of their own.

    Args:
        name: the job's.
        installation: which version.
        log: what is replayed.
        out: the log that is written, and kept.
        threads: how many are asked for.
    """
    options = (*installation.threads(threads), "--force", "--quiet")

    def run() -> dict[str, float]:
        short = out.with_suffix(".short.mcap")
        paths = ((log.first_frame, short), (log.warm_up, short), (log.path, out))
        first, warm_up, whole = (cost_of(name, installation.replay(*pair, *options)) for pair in paths)
        return a_frame(warm_up, whole, log.frames) | _first_frame(first) | parts(out)

    return BenchJob(name, run)


def a_frame(warm_up: Cost, whole: Cost, frames: int) -> dict[str, float]:
    """Quantities of a frame of a replay by what it takes, and what its first frames alone take."""
    return {
        "cpu": (whole.cpu_s - warm_up.cpu_s) / (frames - WARM_UP) * 1000,
        "wall": (whole.wall_s - warm_up.wall_s) / (frames - WARM_UP) * 1000,
        "peak_mb": whole.peak_mb,
    }


def _first_frame(cost: Cost) -> dict[str, float]:
    return {"first frame/cpu": cost.cpu_s * 1000, "first frame/wall": cost.wall_s * 1000}


def parts(out: Path) -> dict[str, float]:
    """Means of the time columns behind the first frames, their sum over the total, and the spread of objects' times."""
    rows = read_metrics(out)[WARM_UP:]
    columns = [name for name in rows.columns if name.endswith("_ms") and name not in _NO_PART]
    found = {name.removesuffix("_ms"): rows[name].drop_nulls().to_numpy() for name in columns}
    means = {name: float(values.mean()) for name, values in found.items() if len(values)}
    objects_ms = found["objects"]
    return {f"part/{name}": value for name, value in means.items()} | {
        "parts over total": sum(value for name, value in means.items() if name != "total") / means["total"],
        "objects p95 over median": float(np.quantile(objects_ms, 0.95) / np.median(objects_ms)),
    }


def start_jobs(installation: Installation) -> list[BenchJob]:
    """The jobs of starting Python with numpy and OpenCV, and of a replay's ``--help``."""
    bare = [str(installation.python), "-P", "-c", "import numpy, cv2"]
    return [_start_job("import numpy, cv2", bare), _start_job("--help", installation.replay("--help"))]


def _start_job(name: str, command: list[str]) -> BenchJob:
    def run() -> dict[str, float]:
        costs = [cost_of(name, command) for _ in range(3)]
        return {
            "cpu": float(np.median([cost.cpu_s for cost in costs]) * 1000),
            "wall": float(np.median([cost.wall_s for cost in costs]) * 1000),
        }

    return BenchJob(name, run)


_REPOSITORY: Final = Path(__file__).resolve().parents[2]
_PROJECT: Final = "roadperc_stream"
_LIBRARIES: Final = "libraries.pth"


@contextmanager
def installed(commit: str) -> Iterator[Path]:
    """The interpreter of an environment in which a commit is installed, with what it has to build; removed in the end.

    Its libraries are those of this environment: what differs is this project alone. One that this environment lacks is
    installed as the commit asks for it.

    Args:
        commit: anything that git takes for one.

    Raises:
        ProgramError: there is no such commit, or it cannot be installed.
    """
    named = _output("git", "-C", str(_REPOSITORY), "rev-parse", "--verify", "--quiet", f"{commit}^{{commit}}")
    with tempfile.TemporaryDirectory(prefix="roadperc-bench-") as folder:
        tree, environment = Path(folder) / "tree", Path(folder) / "environment"
        _output("git", "-C", str(_REPOSITORY), "worktree", "add", "--detach", "--quiet", str(tree), named.strip())
        try:
            yield _environment(environment, tree)
        finally:
            _output("git", "-C", str(_REPOSITORY), "worktree", "remove", "--force", str(tree))


def _environment(environment: Path, tree: Path) -> Path:
    """The interpreter of a new environment that finds this one's libraries behind its own package."""
    _output(sys.executable, "-m", "venv", "--without-pip", str(environment))
    python = environment / "bin" / "python"
    own = Path(_output(str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())
    libraries = dict.fromkeys(sysconfig.get_path(kind) for kind in ("purelib", "platlib"))
    own.joinpath(_LIBRARIES).write_text("".join(f"{folder}\n" for folder in libraries))
    pip = [sys.executable, "-m", "pip", "--python", str(python), "--disable-pip-version-check", "install", "--quiet"]
    _output(*pip, "--no-deps", "--ignore-installed", str(tree))
    _output(*pip, _PROJECT)  # which is there already: what it lacks is not
    return python


def _output(*command: str) -> str:
    """What a program prints.

    Raises:
        ProgramError: it fails, with its last line.
    """
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ProgramError(f"{_shown(command)} ended with exit code {done.returncode}: {_last_line(done.stderr)}")
    return done.stdout


def _shown(command: Sequence[str]) -> str:
    return " ".join(command)


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else "it says nothing"
