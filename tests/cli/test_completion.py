"""Completion: what a shell is answered, through argcomplete's own protocol and by the shells themselves."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from roadperc_stream.schemas.roles import ROLES
from roadperc_stream.tools.scene.options import SCENES
from tests.commands import run_forked
from tests.config.test_settings import all_settings

SEPARATOR = "\v"
BIN = Path(sys.executable).parent
TIMEOUT_S = 120


@pytest.fixture
def folder(tmp_path):
    """One file of every kind, a folder, and what nobody looks for."""
    names = "a.mcap b.mcap a.metrics.parquet a.objects.parquet a.toml a.json a.html a.rrd a.mp4 notes.txt"
    for name in names.split():
        (tmp_path / name).touch()
    (tmp_path / "drive" / "rgb").mkdir(parents=True)
    (tmp_path / "drive" / "depth").mkdir()
    (tmp_path / "drive" / "inside.mcap").touch()
    return tmp_path


def answered(line, folder):
    """What could stand at the end of a line, as a shell without word breaks is told."""
    answer = folder / "answer"
    asked = {"COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE": "1", "_ARGCOMPLETE_SHELL": "fish"}
    asked |= {"_ARGCOMPLETE_SUPPRESS_SPACE": "1", "_ARGCOMPLETE_STDOUT_FILENAME": str(answer)}
    ended = run_forked(line.split()[0], cwd=folder, variables=asked)
    assert ended.returncode == 0, ended.stderr
    said = answer.read_text()
    answer.unlink()
    return [item for item in said.split(SEPARATOR) if item]


@pytest.mark.parametrize("command", ["batch", "find", "replay", "view"])
def test_a_command_completes_its_options(command, folder):
    found = answered(f"roadperc-{command} --", folder)
    assert {"--help", "--version"} <= set(found)
    assert all(option.startswith("--") for option in found)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("roadperc rep", ["replay", "report"]),
        ("roadperc replay a.mcap b", ["b.mcap"]),
        ("roadperc-convert ", ["drive/"]),
        ("roadperc-replay ", ["a.mcap", "b.mcap", "drive/"]),
        ("roadperc-replay drive/", ["drive/depth/", "drive/inside.mcap", "drive/rgb/"]),
        ("roadperc-replay --config ", ["a.toml", "drive/"]),
        ("roadperc-report ", ["a.mcap", "a.metrics.parquet", "b.mcap", "drive/"]),
        ("roadperc-lanes a.mcap --truth ", ["a.json", "drive/", "notes.txt"]),
        ("roadperc-render drive --scene ", list(SCENES)),
        ("roadperc-convert drive b.mcap --role im", ["image="]),
        ("roadperc-replay --topic ", [f"{role}=" for role in ROLES]),
        ("roadperc-replay --set lanes.ho", None),
        ("roadperc-replay --set lanes.model=", ["lanes.model=line", "lanes.model=curve"]),
        ("roadperc-sweep --vary odometry.features=klt,", ["odometry.features=klt,orb", "odometry.features=klt,sift"]),
    ],
)
def test_files_of_the_right_endings_and_names_from_the_projects_own_tables(line, expected, folder):
    if expected is None:  # every key that begins so
        typed = line.rpartition(" ")[2]
        expected = [f"{key}=" for key in all_settings() if key.startswith(typed)]
        assert expected
    assert sorted(answered(line, folder)) == sorted(expected)


SCRIPT = """
eval "$(register-python-argcomplete roadperc-{replay,render})"
COMP_LINE=$1 COMP_POINT=${#1} COMP_TYPE=9
_python_argcomplete "${1%% *}"
printf '%s\\n' "${COMPREPLY[@]}"
"""
"""The line of docs/completion.md, and a question."""


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("roadperc-render drive --scene to", "town"),
        ("roadperc-replay --set lanes.mod", "lanes.model="),
        ("roadperc-replay b", "b.mcap"),
        ("roadperc-replay --set lanes.model=c", "curve"),  # bash breaks words at "="
    ],
)
def test_bash_itself(line, expected, folder):
    if not shutil.which("bash") or not (BIN / "roadperc-replay").exists():
        pytest.skip("no bash, or the commands are not installed beside this Python")
    path = os.environ | {"PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
    words = ["bash", "-c", SCRIPT, "bash", line]
    ended = subprocess.run(words, check=False, capture_output=True, text=True, cwd=folder, env=path, timeout=TIMEOUT_S)
    assert ended.stdout.split() == [expected]
