"""How tests start the commands: as processes of their own, through what the console scripts call."""

import atexit
import json
import os
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]


def words(command, *arguments):
    """What the console script of a command runs."""
    module, _, function = SCRIPTS[command].partition(":")
    code = f"import sys; from {module} import {function}; sys.exit({function}())"
    return [sys.executable, "-c", code, *map(str, arguments)]


def run(command, *arguments, **options):
    """A command in a new interpreter: for tests of its start."""
    options = {"capture_output": True, "text": True, "timeout": 60} | options
    return subprocess.run(words(command, *arguments), check=False, **options)


def run_forked(command, *arguments, cwd=".", variables=(), memory_bytes=None, file_bytes=None):
    """A command in a process forked from one with all imports done, which saves up to a second.

    ``variables`` are added to the environment. The system limits new memory and the size of files.
    """
    with TemporaryDirectory() as folder:
        asked = {"command": command, "arguments": [*map(str, arguments)], "cwd": str(Path(cwd).resolve())}
        asked |= {"folder": folder, "variables": os.environ | dict(variables)}
        asked |= {"memory_bytes": memory_bytes, "file_bytes": file_bytes}
        server = _server(os.getpid())
        server.stdin.write(json.dumps(asked) + "\n")
        server.stdin.flush()
        code = int(server.stdout.readline())
        printed = [Path(folder, name).read_bytes().decode() for name in ("stdout", "stderr")]
    return subprocess.CompletedProcess([command, *arguments], code, *printed)


@cache
def _server(_pid):
    server = subprocess.Popen(
        [sys.executable, "-m", "tests.forking"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
    )
    atexit.register(server.kill)
    return server


def environment(**variables):
    """This process's environment, and more variables."""
    return os.environ | variables
