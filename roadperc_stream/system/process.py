"""Signals that end a process, and output without a reader. Imports no library."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

TYPE_CHECKING = False  # importing typing would double the start time of a command
if TYPE_CHECKING:
    from typing import IO, TextIO


EXIT_DONE, EXIT_ERROR = 0, 1
EXIT_UNDECIDED = 3
"""Of an error in a command whose exit code 1 is a result."""


def ending_signals() -> list[int]:
    """The signals that end a command, except ignored ones, as under nohup."""
    ending = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    return [number for number in ending if signal.getsignal(number) != signal.SIG_IGN]


@contextmanager
def optional_output(stream: "TextIO | None" = None) -> Iterator[None]:
    """Continue if the output of the block has no reader, or stderr has no space; ``stream`` is stdout by default."""
    stream = stream or sys.stdout
    try:
        yield
        stream.flush()
    except OSError as error:
        if not (isinstance(error, BrokenPipeError) or stream is sys.stderr):
            raise
        discard_output(stream)


def discard_output(stream: "IO[str]") -> None:
    """Discard the buffered and all later output of a stream without a reader."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, stream.fileno())
    os.close(null)
