"""Logs through standard input and named pipes: stored once, then like any file."""

import os
import resource
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from threading import Thread

import pytest

from roadperc_stream import log
from roadperc_stream.cli.info import main as info
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.cli.view import main as view
from roadperc_stream.config import ReplayConfig
from roadperc_stream.errors import LogError
from roadperc_stream.system.time import TimeRange
from tests.arranged import ARRANGEMENTS, arranged, plain
from tests.commands import run, words
from tests.replaying import replay
from tests.test_sample import SAMPLE


def fed(path, data):
    """A named pipe that a thread writes to."""
    os.mkfifo(path)
    Thread(target=_write, args=(path, data), daemon=True).start()
    return path


def _write(path, data):
    with suppress(BrokenPipeError):  # the reader may stop early
        path.write_bytes(data)


@pytest.mark.parametrize("options", [{}, ARRANGEMENTS["no chunks, no summary"]], ids=["indexed", "no index"])
def test_a_named_pipe_is_read_like_a_file(tmp_path, options):
    source = arranged(SAMPLE, tmp_path / "a.mcap", **options)
    (piped,) = log.received([fed(tmp_path / "pipe", source.read_bytes())])
    expected, summary = log.summarise(source), log.summarise(piped)
    assert plain(log.read(summary)) == plain(log.read(expected))
    assert (summary.path, summary.metadata) == (tmp_path / "pipe", expected.metadata)
    salvage = log.Salvage(piped)
    assert plain(salvage.messages()) == plain(log.Salvage(source).messages())
    assert salvage.whole


def test_a_pipe_gives_the_results_of_the_file(tmp_path):
    part = TimeRange(frames=1)
    replay(SAMPLE, tmp_path / "out.mcap", ReplayConfig(), time_range=part)
    pipe = fed(tmp_path / "pipe", SAMPLE.read_bytes())
    replay(pipe, tmp_path / "piped.mcap", ReplayConfig(), time_range=part)
    with SAMPLE.open("rb") as stream:
        ended = run("roadperc-replay", "-", tmp_path / "input.mcap", "--frames", "1", stdin=stream)
    assert ended.returncode == 0, ended.stderr
    results = {(tmp_path / f"{name}.mcap").read_bytes() for name in ("out", "piped", "input")}
    assert len(results) == 1


def with_input(monkeypatch, stream, main, *arguments):
    """Exit code of a command's main function that reads standard input."""
    with stream:
        monkeypatch.setattr(sys, "stdin", stream)
        return main(["-", *map(str, arguments)])


@pytest.fixture
def through(monkeypatch, tmp_path_factory):
    """Runs a command's main function with data in a pipe as standard input; returns its exit code."""

    def run_main(main, data, *arguments):
        pipe = fed(tmp_path_factory.mktemp("input") / "pipe", data)
        return with_input(monkeypatch, pipe.open("rb"), main, *arguments)

    return run_main


def test_info_and_view_read_standard_input(tmp_path, through, capsys):
    data = SAMPLE.read_bytes()
    assert through(info, data) == 0
    assert capsys.readouterr().out.startswith("-: whole, an input")
    layouts = [tmp_path / "piped.json", tmp_path / "file.json"]
    assert through(view, data, "--foxglove-layout", layouts[0]) == 0
    assert view([str(SAMPLE), "--foxglove-layout", str(layouts[1])]) == 0
    assert layouts[0].read_bytes() == layouts[1].read_bytes()


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (SAMPLE.read_bytes()[:1_000_000], "-: damaged at byte 919765: cut off"),
        (b"", "-: empty file, expected an MCAP log"),
        (b"nothing of the kind, but long enough", "-: not an MCAP log"),
    ],
)
def test_a_pipe_without_a_whole_log_gives_one_line(tmp_path, through, data, fault, capsys):
    assert through(replay_main, data, tmp_path / "out.mcap") == 1
    error = capsys.readouterr().err
    assert error.startswith(f"error: {fault}")
    assert "roadperc-info" not in error
    assert list(tmp_path.iterdir()) == []


def test_a_terminal_is_refused(tmp_path, monkeypatch, capsys):
    controller, terminal = os.openpty()
    assert with_input(monkeypatch, os.fdopen(terminal), replay_main, tmp_path / "out.mcap") == 1
    os.close(controller)
    assert capsys.readouterr().err.startswith("error: -: standard input is a terminal")


def test_closed_standard_input_is_refused(monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(LogError, match="-: standard input is closed"):
        log.received([Path("-")])
    with pytest.raises(LogError, match="-: is given twice"):
        log.received([Path("-"), Path("-")])


def test_a_full_disk_while_storing_a_pipe_gives_one_line(tmp_path):
    def limited():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))

    command = words("roadperc-replay", "-", tmp_path / "out.mcap")
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    options = {"capture_output": True, "timeout": 60, "env": environment, "preexec_fn": limited}
    ended = subprocess.run(command, input=SAMPLE.read_bytes(), check=False, **options)
    assert ended.returncode == 1
    assert ended.stderr.decode().startswith(f"error: -: cannot be stored in {tmp_path}: File too large; TMPDIR names")
    assert ended.stderr.count(b"\n") == 1
    assert list(tmp_path.iterdir()) == []
