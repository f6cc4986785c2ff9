"""What each command imports: nothing heavy for its help or for wrong usage, and only what it uses for its work."""

import os
import subprocess
import sys

import pytest

from roadperc_stream.cli.launch import COMMANDS
from tests.cli.test_launch import SCRIPTS
from tests.test_sample import SAMPLE

HEAVY = {"PIL", "cv2", "foxglove", "google", "jinja2", "mcap", "numpy", "plotly", "polars", "pyarrow", "pydantic"}
HEAVY |= {"rerun", "rich", "rosbags", "scipy", "zstandard"}
WRONG = ["--no-such-option"]
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
    """The top-level packages that a command has imported by its end."""
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
    """A replay of three frames, made by the command, and the modules that it took."""
    target = tmp_path_factory.mktemp("imports") / "run.mcap"
    return target, loaded("replay", SAMPLE, target, "--frames", "3", "--quiet")


def test_every_script_is_a_command_of_its_name():
    assert {name.removeprefix("roadperc-"): target for name, target in SCRIPTS.items()} == {
        name: f"roadperc_stream.cli.launch:{name}" for name in COMMANDS
    }


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(("arguments", "exit_code"), [(["--help"], 0), (["--version"], 0), (WRONG, 2)])
def test_help_and_wrong_usage_import_nothing_heavy(command, arguments, exit_code):
    found = packages(loaded(command, *arguments, exit_code=exit_code))
    assert not found & HEAVY
    assert "argcomplete" not in found


def test_a_replay_needs_no_data_frames_charts_or_viewers(made):
    _, modules = made
    assert "cv2" in modules
    assert not packages(modules) & {"polars", "plotly", "rerun", "foxglove", "jinja2"}


def test_info_decodes_no_image(made, tmp_path):
    for log in (SAMPLE, made[0]):
        assert not packages(loaded("info", log)) & {"cv2", "polars", "plotly", "rerun", "foxglove"}


def test_a_report_draws_nothing_unless_a_page_is_asked_for(made, tmp_path):
    assert not packages(loaded("report", made[0])) & {"cv2", "plotly", "rerun", "foxglove", "jinja2"}
    assert {"cv2", "plotly"} <= packages(loaded("report", made[0], "--html", tmp_path / "page.html"))


@pytest.mark.parametrize(
    ("command", "suffix", "runs"), [("trajectory", ".mcap", 1), ("compare", ".metrics.parquet", 2)]
)
def test_runs_are_judged_without_the_chain(made, command, suffix, runs):
    modules = loaded(command, *[made[0].with_suffix(suffix)] * runs)
    assert not packages(modules) & {"cv2", "plotly", "rerun", "foxglove"}
    assert "roadperc_stream.chain.step" not in modules


def test_a_layout_needs_no_rerun(made, tmp_path):
    assert "rerun" not in packages(loaded("view", made[0], "--foxglove-layout", tmp_path / "layout.json"))


def test_settings_are_listed_without_images():
    assert not packages(loaded("replay", "--list-settings")) & {"cv2", "polars", "plotly", "rerun", "foxglove", "mcap"}
