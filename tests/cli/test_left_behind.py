"""Partial files and folders of a killed command are removed by the next run of the same command."""

import signal

import cv2
import numpy as np
import pytest

from roadperc_stream.cli.replay import main as replay_main
from tests import logs
from tests.analytic import Road
from tests.commands import run_forked
from tests.tools.networks.onnx_files import SAME

NEVER = 0
COMMANDS = {
    "replay": "in.mcap out.mcap --frames 2",
    "infer": "shots out.mcap --fov 60 --height 1.5 --network net.toml",
    "find": "run.metrics.parquet frame>1 --clips clips",
    "sweep": "in.mcap --vary lanes.hold_s=1,2 --out sweep --frames 2",
    "view": "run.mcap --save run.rrd",
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    source = logs.write(folder / "in.mcap", logs.items(3, Road(width=160, height=120)))
    assert replay_main([str(source), str(folder / "run.mcap"), "--quiet"]) == 0
    return [(path.name, path.read_bytes()) for path in folder.iterdir()]


def ended(folder, command, kill_before, *options):
    """Exit code and stderr of a command that is killed before a number of file operations."""
    done = run_forked("tests.resume.killed", kill_before, 0, command, *COMMANDS[command].split(), *options, cwd=folder)
    return done.returncode, done.stderr


@pytest.mark.parametrize(("command", "kill_before"), [*((name, 1) for name in COMMANDS), ("find", 2)])
def test_partial_files_of_a_killed_command_are_removed(run, tmp_path, command, kill_before):
    for name, data in run:
        (tmp_path / name).write_bytes(data)
    (tmp_path / "net.onnx").write_bytes(SAME)
    output = '[output]\ndecoder = "semantic"\nclasses = { 1 = "road" }'
    (tmp_path / "net.toml").write_text(f'file = "net.onnx"\n[input]\nsize = [16, 8]\n{output}')
    (tmp_path / "shots").mkdir()
    cv2.imwrite(str(tmp_path / "shots" / "1.png"), np.zeros((80, 160, 3), np.uint8))
    code, error = ended(tmp_path, command, kill_before)
    assert code == -signal.SIGKILL, error
    assert list(tmp_path.rglob(".*.partial*"))
    code, error = ended(tmp_path, command, NEVER, "--force")
    assert code == 0, error
    assert not list(tmp_path.rglob(".*.partial*"))
