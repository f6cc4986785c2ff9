"""What a command says of an error, and that telling is not the work."""

import errno
import os
import signal
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import redirect_stdout
from threading import Event

import pytest

from roadperc_stream.cli.plumbing import run
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


def test_of_a_long_text_what_is_around_the_character_is_shown(capsys):
    text = "a" * 9000 + "here\udcff" + "b" * 9000
    assert run(raising(UnicodeEncodeError("ascii", text, 9004, 9005, "no"))) == 1
    said = capsys.readouterr().err
    assert r"here\udcff" in said
    assert len(said) < 700


class Deleted:
    """Python ignores what is raised while it deletes this."""

    def __init__(self, happens):
        self.happens = happens

    def __del__(self):
        self.happens()


@pytest.fixture(params=[signal.SIGINT, signal.SIGTERM])
def number(request):
    """A signal that is not ignored, as a shell has it for what runs in the background."""
    before = signal.signal(request.param, signal.SIG_DFL)
    yield request.param
    signal.signal(request.param, before)


def test_a_signal_while_an_object_is_deleted_still_ends_the_command(number, capsys):
    def command():
        Deleted(lambda: os.kill(os.getpid(), number))
        time.sleep(10)
        pytest.fail("the signal was lost")

    assert run(command) == 1
    assert capsys.readouterr().err == "error: interrupted\n"


@pytest.mark.promise("Start and end", "A signal while a command waits for a thread ends the command")
def test_signals_leave_no_lock_locked(capsys):
    """A thread that needs the lock would otherwise wait forever."""
    future, event, signals = Future(), Event(), 500

    def command():
        signal.setitimer(signal.ITIMER_REAL, next(delays_s))
        while not future.done():
            wait([future], 1e-6)
            event.wait(1e-6)

    delays_s = (1e-6 * n for n in range(1, signals + 1))
    assert [run(command) for _ in range(signals)] == [1] * signals
    assert capsys.readouterr().err == "error: interrupted\n" * signals
    with ThreadPoolExecutor(1) as other:
        assert other.submit(future._condition.acquire, timeout=0).result()
        assert other.submit(event._cond.acquire, timeout=0).result()


def test_other_errors_while_an_object_is_deleted_are_reported_and_end_nothing(capsys):
    def command():
        Deleted(lambda: 1 // 0)

    assert run(command) == 0
    assert "ZeroDivisionError" in capsys.readouterr().err


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


def test_a_signal_in_a_class_statement_is_one_line(capsys):
    """A library may import a module while it works; Python 3.11 puts another error around the exception."""

    class Signalling:
        def __set_name__(self, owner, name):
            os.kill(os.getpid(), signal.SIGINT)

    assert run(lambda: type("Late", (), {"name": Signalling()})) == 1
    assert capsys.readouterr().err == "error: interrupted\n"
