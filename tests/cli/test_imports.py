"""Imports of each command: nothing heavy for help and wrong usage, and only what its work needs."""

import os
import subprocess
import sys

import pytest

from roadperc_stream.cli.launch import COMMANDS
from tests.commands import SCRIPTS
from tests.test_sample import SAMPLE

HEAVY = {"PIL", "cv2", "foxglove", "google", "jinja2", "mcap", "numpy", "plotly", "polars", "pyarrow", "pydantic"}
HEAVY |= {"rerun", "rich", "rosbags", "scipy", "zstandard"}
CODE = """\
import sys
from roadperc_stream.cli import launch
try:
    code = getattr(launch, {command!r})()
except SystemExit as ended:
    code = ended.code
print("modules:", *sys.modules)
sys.exit(code)
"""


def loaded(command, *arguments, exit_code=0):
    """The modules that a command has imported at its end."""
    words = [sys.executable, "-c", CODE.format(command=command), *map(str, arguments)]
    plain = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    ended = subprocess.run(words, check=False, capture_output=True, text=True, timeout=120, env=plain)
    assert ended.returncode == exit_code, ended.stderr
    _, _, modules = ended.stdout.rpartition("modules:")
    return set(modules.split())


def packages(modules):
    return {name.partition(".")[0] for name in modules}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A replay of three frames by the command, and its modules."""
    target = tmp_path_factory.mktemp("imports") / "run.mcap"
    return target, loaded("replay", SAMPLE, target, "--frames", "3", "--quiet")


def test_every_script_is_a_command_of_its_name():
    assert {name.removeprefix("roadperc-"): target for name, target in SCRIPTS.items()} == {
        name: f"roadperc_stream.cli.launch:{name}" for name in (*COMMANDS, "roadperc")
    }


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["--no-such-option"]], ids=str)
def test_help_and_wrong_usage_import_nothing_heavy(arguments):
    code = f"""\
import sys
from importlib import import_module
for command in {(*COMMANDS, "subcommands")}:
    try:
        import_module("roadperc_stream.cli." + command).main({arguments})
    except SystemExit:
        pass
    print("modules of", command + ":", *sys.modules)
"""
    ended = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=120)
    lines = [line for line in ended.stdout.splitlines() if line.startswith("modules of ")]
    assert len(lines) == len(COMMANDS) + 1
    for line in lines:  # with the modules of the commands before it
        found = packages(line.split(": ")[1].split())
        assert not found & (HEAVY | {"argcomplete"}), line.split(": ")[0]


def test_a_replay_needs_no_data_frames_charts_or_viewers(made):
    _, modules = made
    assert "cv2" in modules
    assert not packages(modules) & {"polars", "plotly", "rerun", "foxglove", "jinja2", "scipy"}
    assert "pyarrow.compute" not in modules


def test_a_report_draws_only_for_a_page(made, tmp_path):
    usual = packages(loaded("report", made[0]))
    assert not usual & {"cv2", "plotly", "rerun", "foxglove", "jinja2", "rosbags", "scipy"}
    assert {"cv2", "plotly"} <= packages(loaded("report", made[0], "--html", tmp_path / "page.html"))
