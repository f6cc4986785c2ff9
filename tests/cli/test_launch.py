"""The start and end of every command: errors, signals, output without a reader, full devices, names."""

import errno
import os
import signal
import subprocess
import sys
from contextlib import redirect_stdout
from importlib import import_module
from pathlib import Path

import pytest

from roadperc_stream import api
from roadperc_stream.cli.launch import COMMANDS, run
from roadperc_stream.errors import TargetError
from roadperc_stream.system.process import optional_output
from tests.commands import environment, run_forked, words
from tests.commands import run as run_command
from tests.test_sample import SAMPLE

FULL = Path("/dev/full")


def raising(error):
    def command():
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOENT, "No such file", "in.mcap"), "in.mcap: No such file"),
        (OSError("no number"), "no number"),
        (MemoryError(), "not enough memory"),
        (KeyboardInterrupt(), "interrupted"),
        (UnicodeEncodeError("utf-8", "bad\udcff.mcap", 3, 4, "no"), r"'bad\udcff.mcap': expected a name in UTF-8"),
    ],
)
def test_an_error_is_one_line(error, said, capsys):
    assert run(raising(error)) == 1
    assert capsys.readouterr().err == f"error: {said}\n"


@pytest.mark.parametrize(("error", "code"), [(None, 0), (OSError(errno.ENOSPC, "No space left", "out.mcap"), 1)])
def test_output_without_a_reader_is_not_the_work(error, code):
    done = []

    def command():
        for number in range(2):
            with optional_output():
                print("told")
            done.append(number)
        print("the last line")
        if error:
            raise error

    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as stream, redirect_stdout(stream):
        assert run(command) == code
    assert done == [0, 1]


def test_the_help_is_cut_by_its_reader():
    ended = subprocess.run(["sh", "-c", '"$@" | head -1', "sh", *words("roadperc-replay", "--help")],
                           check=False, capture_output=True, text=True, timeout=60)  # fmt: skip
    assert (ended.stdout.count("\n"), ended.stderr) == (1, "")


@pytest.mark.parametrize(
    ("command", "code", "number"), [("roadperc-report", 1, signal.SIGINT), ("roadperc-compare", 3, signal.SIGTERM)]
)
def test_a_signal_during_an_import_is_one_line(tmp_path, command, code, number):
    tmp_path.joinpath("rich.py").write_text(f"import os, time\nos.kill(os.getpid(), {int(number)})\ntime.sleep(20)\n")
    ended = run_command(command, "in.mcap", "out.mcap", env=environment(PYTHONPATH=str(tmp_path)), cwd=tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (code, "", "error: interrupted\n")


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full on this system")
def test_output_to_a_full_device_is_one_line():
    with FULL.open("w") as device:
        ended = run_command("roadperc-info", SAMPLE, capture_output=False, stdout=device, stderr=subprocess.PIPE)
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
        (["repaly", "in.mcap", "--force"], 2, "roadperc: error: no command 'repaly'; commands: batch, "),
        ([], 2, "roadperc: error: expected a command; commands: batch, "),
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


@pytest.mark.parametrize("buffering", ["", "1"], ids=["buffered", "unbuffered"])
def test_a_result_without_a_reader_keeps_its_exit_code(tmp_path, buffering):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(SAMPLE.read_bytes()[:100_000])
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as closed:
        options = {"env": environment(PYTHONUNBUFFERED=buffering), "capture_output": False, "stderr": subprocess.PIPE}
        piped = run_command("roadperc-info", cut, stdout=closed, **options)
        kept = run_command("roadperc-info", cut, stdout=subprocess.PIPE, **options)
    assert (piped.returncode, piped.stderr) == (kept.returncode, kept.stderr)
    assert kept.returncode == 1


def test_an_interrupt_inside_a_library_is_one_line():
    """Pydantic raises an error of its own, without the interrupt, if a signal comes while it serialises settings."""
    code = """
import os, signal, sys, types
from roadperc_stream.cli import launch

def main():
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:
        pass
    raise ValueError("of a library")

sys.modules["roadperc_stream.cli.info"] = types.SimpleNamespace(main=main)
sys.exit(launch.info())
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (1, "error: interrupted\n")
