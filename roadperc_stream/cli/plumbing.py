"""What every command shares: errors and signals to exit codes, telling, progress on a terminal, checked numbers."""

import argparse
import math
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from roadperc_stream.cli.launch import ending_signals
from roadperc_stream.core.progress import no_progress
from roadperc_stream.errors import RoadpercError

EXIT_DONE, EXIT_ERROR = 0, 1
_MOST_CHARACTERS = 255
"""To either side of the one that a text must not have: a file's name is no longer."""


def run(command: Callable[[], None]) -> int:
    """Run a command; what the project states, and what the system refuses, is one line on stderr and exit code 1.

    A signal that ends the program unwinds it like Ctrl-C, so that nothing half written stays behind.
    """
    try:
        with _signals_unwind():
            command()
            sys.stdout.flush()
    except RoadpercError as error:
        return _say(str(error))
    except KeyboardInterrupt:
        return _say("interrupted")
    except BrokenPipeError:  # the reader has seen enough, as with | head
        _lead_nowhere(sys.stdout)
        return EXIT_DONE
    except OSError as error:
        return _say(": ".join(str(part) for part in (error.filename, error.strerror or error) if part))
    except UnicodeEncodeError as error:
        return _say(_unspeakable(error))
    return EXIT_DONE


def _say(text: str) -> int:
    with telling(sys.stderr):
        print("error:", " ".join(text.split("\n")), file=sys.stderr)
    return EXIT_ERROR


def _unspeakable(error: UnicodeEncodeError) -> str:
    """A text that a library cannot take, such as a file's name; of a long one what surrounds the character."""
    text = error.object[max(error.start - _MOST_CHARACTERS, 0) : error.end + _MOST_CHARACTERS]
    return f"{text!r}: expected a name in {error.encoding.upper()}"


@contextmanager
def telling(stream: TextIO | None = None) -> Iterator[None]:
    """Around what is printed while there is work left: where nobody reads it any more, the work goes on.

    Args:
        stream: what is printed to, stdout where none is named.
    """
    stream = stream or sys.stdout
    try:
        yield
        stream.flush()
    except BrokenPipeError:
        _lead_nowhere(stream)


def _lead_nowhere(stream: TextIO) -> None:
    """What is still buffered for a stream that nobody reads, and all that follows, goes nowhere."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, stream.fileno())
    os.close(null)


@contextmanager
def _signals_unwind() -> Iterator[None]:
    before = {number: signal.signal(number, _interrupt) for number in ending_signals()} if _in_main_thread() else {}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


@contextmanager
def frame_progress(what: str, enabled: bool) -> Iterator[Callable[[int, int], None]]:
    """A progress bar over frames on a terminal, nothing where the output is piped."""
    console = Console(stderr=True)
    if not (enabled and console.is_terminal):
        yield no_progress
        return
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TextColumn("frames"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        console.show_cursor(True)  # a program that ends at once does not give it back
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def whole_number(text: str) -> int:
    """An argument of 1 or more."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text}: expected 1 or more")
    return number


def seconds(text: str) -> float:
    """An argument in seconds: finite, and no more than a century."""
    value = float(text)
    if not math.isfinite(value) or abs(value) > 3.2e9:
        raise argparse.ArgumentTypeError(f"{text}: expected seconds")
    return value
