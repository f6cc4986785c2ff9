"""What a command says of an error, and that telling is not the work."""

import errno
import os
import signal
from contextlib import redirect_stdout

import pytest

from roadperc_stream.cli.plumbing import run
from roadperc_stream.system import process
from roadperc_stream.system.process import optional_output


def raising(error):
    def command():
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOENT, "No such file", "in.mcap"), "in.mcap: No such file"),
        (OSError(errno.EMFILE, "Too many open files"), "Too many open files"),
        (OSError("no number"), "no number"),
        (UnicodeEncodeError("utf-8", "bad\udcff.mcap", 3, 4, "no"), r"'bad\udcff.mcap': expected a name in UTF-8"),
    ],
)
def test_what_the_system_refuses_is_one_line(error, said, capsys):
    assert run(raising(error)) == 1
    assert capsys.readouterr().err == f"error: {said}\n"


def run_unread(command):
    """Exit code of a command whose stdout is a pipe that nobody reads."""
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as stream, redirect_stdout(stream):
        return run(command)


def test_what_is_told_to_nobody_ends_nothing():
    done = []

    def command():
        for number in range(2):
            with optional_output():
                print("told")
            done.append(number)
        raise OSError(errno.ENOSPC, "No space left", "out.mcap")

    assert run_unread(command) == 1
    assert done == [0, 1]


def test_a_command_that_only_prints_ends_early_and_well():
    done = []

    def command():
        print("told", flush=True)
        done.append(0)

    assert run_unread(command) == 0
    assert done == []


def test_a_signal_in_a_class_statement_is_one_line(capsys, monkeypatch):
    """A library may import a module while it works; Python 3.11 puts another error around the exception."""
    monkeypatch.setattr(process, "is_interrupted", False)

    class Signalling:
        def __set_name__(self, owner, name):
            process.interrupt(signal.SIGINT, None)

    assert run(lambda: type("Late", (), {"name": Signalling()})) == 1
    assert capsys.readouterr().err == "error: interrupted\n"
