"""The start and end of every command: signals during imports, no reader, full devices, odd names."""

import os
import signal
import subprocess
from importlib import import_module
from pathlib import Path

import pytest

from roadperc_stream import api
from roadperc_stream.cli.launch import COMMANDS
from roadperc_stream.errors import TargetError
from tests.commands import BUFFERINGS, environment, run, run_forked, status, words
from tests.test_sample import SAMPLE

ROOT = Path(__file__).parents[2]
ODD = os.fsdecode(b"bad\xff.mcap")
FULL = Path("/dev/full")


@pytest.mark.parametrize(
    ("command", "code", "number"), [("roadperc-report", 1, signal.SIGINT), ("roadperc-compare", 3, signal.SIGTERM)]
)
def test_a_signal_during_an_import_is_one_line(tmp_path, command, code, number):
    tmp_path.joinpath("rich.py").write_text(f"import os, time\nos.kill(os.getpid(), {int(number)})\ntime.sleep(20)\n")
    ended = run(command, "in.mcap", "out.mcap", env=environment(PYTHONPATH=str(tmp_path)), cwd=tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (code, "", "error: interrupted\n")


@pytest.mark.parametrize(("arguments", "code"), [([SAMPLE], 0), (["none.mcap"], 1)])
@pytest.mark.parametrize(("state", "buffering"), [("closed", "buffered"), *(("unread", kind) for kind in BUFFERINGS)])
def test_the_exit_code_without_a_reader(arguments, code, state, buffering):
    assert status(words("roadperc-info", *arguments), state, buffering) == code


def test_a_replay_is_done_without_a_reader(tmp_path):
    assert status(words("roadperc-replay", SAMPLE, tmp_path / "out.mcap", "--frames", "2"), "unread") == 0
    assert len(list(tmp_path.glob("out.*"))) == 3


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full on this system")
def test_output_to_a_full_device_is_one_line():
    with FULL.open("w") as device:
        ended = run("roadperc-info", SAMPLE, capture_output=False, stdout=device, stderr=subprocess.PIPE)
    assert (ended.returncode, ended.stderr) == (1, "error: No space left on device\n")


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_has_the_command_in_an_example(command, capsys):
    with pytest.raises(SystemExit) as end:
        import_module(f"roadperc_stream.cli.{command}").main(["--help"])
    printed = capsys.readouterr().out
    assert (end.value.code, printed.startswith(f"usage: roadperc-{command} ")) == (0, True)
    assert f"  roadperc-{command} " in printed.partition("--version")[2]


@pytest.mark.parametrize(
    ("arguments", "code", "printed"),
    [
        (["--help"], 0, "\n  replay      replay a log through the perception chain\n"),
        (["replay", "--version"], 0, "roadperc replay "),
        (["--version"], 0, "roadperc "),
        (["repaly", "in.mcap", "--force"], 2, "roadperc: error: no command 'repaly'; did you mean replay?\n"),
        ([], 2, "roadperc: error: the following arguments are required: COMMAND\n"),
        (["replay", "--forc", "in.mcap"], 2, "roadperc replay: error: unrecognized arguments: --forc\n"),
        (["info", "none.mcap"], 1, "error: none.mcap: No such file or directory\n"),
    ],
)
def test_subcommands_have_the_name_that_was_typed(arguments, code, printed):
    ended = run_forked("roadperc", *arguments)
    assert (ended.returncode, printed in ended.stdout + ended.stderr) == (code, True), ended
    assert "roadperc-" not in ended.stderr


def test_an_error_of_a_command_names_its_option(tmp_path):
    (tmp_path / "run.mcap").touch()
    ended = run_forked("roadperc-replay", SAMPLE, tmp_path / "run.mcap", "--frames", "1")
    assert ended.stderr.endswith("run.mcap: exists; pass --force to overwrite it\n")
    with pytest.raises(TargetError, match=r"run\.mcap: exists; pass force=True to overwrite it$"):
        api.replay(SAMPLE, tmp_path / "run.mcap", max_frames=1)
