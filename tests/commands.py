"""How tests start the commands: as processes of their own, through what the console scripts call."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

SCRIPTS = tomllib.loads(Path(__file__).parents[1].joinpath("pyproject.toml").read_text())["project"]["scripts"]
BUFFERINGS = ("buffered", "unbuffered")
"""Of stdout: where it is buffered, what nobody reads is met when it is flushed; else when it is printed."""


def words(command, *arguments):
    """What the console script of a command runs."""
    module, _, function = SCRIPTS[command].partition(":")
    code = f"import sys; from {module} import {function}; sys.exit({function}())"
    return [sys.executable, "-c", code, *map(str, arguments)]


def run(command, *arguments, **options):
    options = {"capture_output": True, "text": True, "timeout": 60} | options
    return subprocess.run(words(command, *arguments), check=False, **options)


def environment(buffering="buffered", **variables):
    """This process's environment with stdout buffered or not, and more variables."""
    return os.environ | variables | ({"PYTHONUNBUFFERED": "1"} if buffering == "unbuffered" else {})


def status(command, state, buffering="buffered"):
    """Exit code of a command whose stdout and stderr are closed, or pipes that nobody reads."""
    options = {"timeout": 60, "env": environment(buffering)}
    if state == "closed":
        return subprocess.run(["sh", "-c", 'exec "$@" >&- 2>&-', "sh", *command], check=False, **options).returncode
    reading, writing = os.pipe()
    os.close(reading)
    try:
        return subprocess.run(command, check=False, stdout=writing, stderr=writing, **options).returncode
    finally:
        os.close(writing)
