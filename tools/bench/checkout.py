"""Another commit of this project, installed beside this one with the same libraries."""

import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from roadperc_stream.errors import ProgramError

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
