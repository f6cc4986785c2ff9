"""The start and end of every command: signals during imports, no reader, full devices, odd names."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from roadperc_stream import api
from roadperc_stream.cli import render, replay
from roadperc_stream.errors import TargetError
from tests.commands import BUFFERINGS, environment, run, run_forked, status, words
from tests.test_sample import SAMPLE

ROOT = Path(__file__).parents[2]
ODD = os.fsdecode(b"bad\xff.mcap")
FULL = Path("/dev/full")


@pytest.mark.promise("Start and end", "Ctrl-C or SIGTERM during the imports gives one line")
@pytest.mark.parametrize(("command", "code"), [("roadperc-report", 1), ("roadperc-compare", 3)])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_during_an_import_is_one_line(tmp_path, command, code, number):
    tmp_path.joinpath("rich.py").write_text(f"import os, time\nos.kill(os.getpid(), {int(number)})\ntime.sleep(20)\n")
    ended = run(command, "in.mcap", "out.mcap", env=environment(PYTHONPATH=str(tmp_path)), cwd=tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (code, "", "error: interrupted\n")


def test_a_signal_that_nohup_ignores_ends_nothing():
    code = (
        "import os, signal; signal.signal(signal.SIGHUP, signal.SIG_IGN); from roadperc_stream.cli.plumbing import run;"
    )
    code += "print(run(lambda: os.kill(os.getpid(), signal.SIGHUP)))"
    ended = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "0\n", "")


def test_the_start_of_a_command_imports_no_library():
    code = "import sys, roadperc_stream.cli.launch; print(*{name.partition('.')[0] for name in sys.modules})"
    bare = [sys.executable, "-S", "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r}); {code}"]
    loaded = subprocess.run(bare, check=True, capture_output=True, text=True).stdout.split()
    assert set(loaded) - {"roadperc_stream", "__main__"} <= sys.stdlib_module_names
    assert not {"typing", "pathlib", "email", "argparse"} & set(loaded)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Two short runs with other settings, and a dump."""
    folder = tmp_path_factory.mktemp("made")
    for main, *arguments in (
        (replay.main, SAMPLE, folder / "run.mcap", "--frames", "3"),
        (replay.main, SAMPLE, folder / "other.mcap", "--frames", "3", "--set", "surface.inlier_m=0.5"),
        (render.main, folder / "dump", "--size", "160x120", "--seconds", "0.1"),
    ):
        assert main([str(argument) for argument in arguments]) == 0
    return folder


WRITING = [
    ("roadperc-replay", [SAMPLE, "OUT/file.mcap", "--frames", "2"]),
    ("roadperc-convert", ["MADE/dump", "OUT/file.mcap"]),
    ("roadperc-compare", ["OUT/file", "MADE/run.metrics.parquet", "--update-reference"]),
    ("roadperc-report", ["MADE/run.mcap", "--html", "OUT/file.html"]),
    ("roadperc-lanes", ["MADE/run.mcap", "--tusimple", "OUT/file.json"]),
    ("roadperc-view", ["MADE/run.mcap", "--foxglove-layout", "OUT/file.json"]),
]


CODES = {"--help": 0, "--version": 0, "--wrong": 2, "none.mcap": 1}
"""Exit codes of the arguments."""
UNREAD = [("closed", "buffered"), *(("unread", buffering) for buffering in BUFFERINGS)]


@pytest.mark.parametrize(("command", "arguments"), WRITING, ids=[command for command, _ in WRITING])
def test_the_work_is_done_without_a_reader(command, arguments, made, tmp_path):
    state = "closed" if command in {"roadperc-replay", "roadperc-report", "roadperc-view"} else "unread"
    given = [re.sub("^MADE", str(made), re.sub("^OUT", str(tmp_path), str(argument))) for argument in arguments]
    assert status(words(command, *given), state) == 0
    assert [path.name for path in tmp_path.glob("file*")]


@pytest.mark.parametrize(("state", "buffering"), UNREAD)
@pytest.mark.parametrize(("argument", "code"), CODES.items())
def test_the_exit_code_without_a_reader(argument, code, state, buffering):
    assert status(words("roadperc-info", argument), state, buffering) == code


def test_a_comparison_has_its_exit_code_without_a_reader(made):
    assert status(words("roadperc-compare", made / "run.mcap", made / "other.mcap", "--exact"), "unread") == 1


@pytest.mark.promise("Start and end", "Output to a full device gives one error line")
@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full on this system")
def test_output_to_a_full_device_is_one_line():
    with FULL.open("w") as device:
        ended = run("roadperc-info", SAMPLE, capture_output=False, stdout=device, stderr=subprocess.PIPE)
    assert (ended.returncode, ended.stderr) == (1, "error: No space left on device\n")


def test_a_live_replay_continues_without_a_reader_of_its_address(tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    command = words("roadperc-replay", SAMPLE, tmp_path / "out.mcap", "--frames", "2", "--live", "--port", "0")
    outputs = {"out.mcap", "out.metrics.parquet", "out.objects.parquet"}
    with subprocess.Popen(command, stdout=writing, stderr=subprocess.PIPE, text=True) as started:
        os.close(writing)
        while started.poll() is None and {path.name for path in tmp_path.iterdir()} != outputs:
            time.sleep(0.01)
        assert started.poll() is None  # it still serves
        started.send_signal(signal.SIGTERM)
        try:
            _, errors = started.communicate(timeout=60)
        finally:
            started.kill()
    assert errors in ("", "error: interrupted\n")  # the signal may arrive before it serves
    assert {path.name for path in tmp_path.iterdir()} == outputs


@pytest.mark.parametrize("command", ["roadperc-info", "roadperc-report"])
@pytest.mark.parametrize("name", ["bad\udcff", "\u00fc"])
def test_a_name_of_another_encoding_is_one_line_at_most(command, name, made, tmp_path):
    for suffix in (".mcap", ".metrics.parquet", ".objects.parquet"):
        (tmp_path / f"{name}{suffix}").write_bytes((made / f"run{suffix}").read_bytes())
    plain = environment(LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0")
    ended = run(command, tmp_path / f"{name}.mcap", env=plain)
    assert "Traceback" not in ended.stderr
    assert (ended.returncode, ended.stderr.count("\n")) in {(0, 0), (1, 1)}
    assert ended.returncode == 0 or re.match(r"error: .*(bad|\\udcc3).*\n", ended.stderr), ended.stderr


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


def test_an_error_of_a_command_names_its_option(made):
    ended = run_forked("roadperc-replay", SAMPLE, made / "run.mcap", "--frames", "1")
    assert ended.stderr.endswith("run.mcap: exists; pass --force to overwrite it\n")
    with pytest.raises(TargetError, match=r"run\.mcap: exists; pass force=True to overwrite it$"):
        api.replay(SAMPLE, made / "run.mcap", max_frames=1)
