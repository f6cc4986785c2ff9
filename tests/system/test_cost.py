"""What a program takes that runs as a child."""

import signal
import sys
import time

import pytest

from roadperc_stream.errors import ProgramError
from roadperc_stream.system.cost import cost_of


def test_memory_and_time_are_those_of_the_program_and_its_text_is_dropped(capfd):
    small = cost_of("small", [sys.executable, "-c", "pass"])
    large = cost_of("large", [sys.executable, "-c", "print(len(b'x' * 200_000_000)); sum(range(3_000_000))"])
    assert large.peak_mb > small.peak_mb + 190
    assert large.cpu_s > 0
    assert large.wall_s > 0
    assert capfd.readouterr().out == ""


def test_a_program_that_fails_is_named():
    with pytest.raises(ProgramError, match="the third ended with exit code 3"):
        cost_of("the third", [sys.executable, "-c", "raise SystemExit(3)"])


def test_a_program_that_does_not_exist_is_named(capfd):
    with pytest.raises(ProgramError, match="the missing one could not be started"):
        cost_of("the missing one", ["/no/such/program"])


def test_memory_of_this_process_is_not_that_of_the_child():
    here = b"x" * 300_000_000
    assert cost_of("small", [sys.executable, "-S", "-c", "pass"]).peak_mb < 60 < len(here)


PROGRAM = """
import pathlib, signal, sys, time
folder = pathlib.Path(sys.argv[1])
def end(*_):
    (folder / "ended").touch()
    sys.exit()
signal.signal(signal.SIGTERM, end)
(folder / "started").touch()
time.sleep(600)
"""


def test_who_interrupts_it_ends_the_program(tmp_path):
    def interrupt_once_it_runs(*_):
        if (tmp_path / "started").exists():
            raise KeyboardInterrupt
        signal.setitimer(signal.ITIMER_REAL, 0.1)

    before = signal.signal(signal.SIGALRM, interrupt_once_it_runs)
    signal.setitimer(signal.ITIMER_REAL, 0.1)
    try:
        with pytest.raises(KeyboardInterrupt):
            cost_of("long", [sys.executable, "-c", PROGRAM, str(tmp_path)])
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert appears(tmp_path / "ended")


def appears(path):
    for _ in range(300):
        if path.exists():
            return True
        time.sleep(0.1)
    return False
