"""Signals that end a process, output without a reader, and freed memory. Imports no library."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from typing import IO, Final, Self, TextIO

_STDERR: Final = 2
"""File descriptor of stderr."""


def ending_signals() -> list[int]:
    """The signals that end a command, except ignored ones, as under nohup."""
    ending = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    return [number for number in ending if signal.getsignal(number) != signal.SIG_IGN]


class _Signals:
    """Signals that this process received."""

    ended = False


def interrupt(_number: int, _frame: object) -> None:
    """End the command as Ctrl-C does."""
    _Signals.ended = True
    raise KeyboardInterrupt


def interrupted() -> bool:
    """Whether ``interrupt`` was called: a library may raise an error of its own instead of KeyboardInterrupt."""
    return _Signals.ended


@contextmanager
def optional_output(stream: TextIO | None = None) -> Iterator[None]:
    """Continue if the output of the block has no reader, or stderr has no space; ``stream`` is stdout by default."""
    stream = stream or sys.stdout
    try:
        yield
        stream.flush()
    except OSError as error:
        if not (isinstance(error, BrokenPipeError) or stream is sys.stderr):
            raise
        discard_output(stream)


def discard_output(stream: IO[str]) -> None:
    """Discard the buffered and all later output of a stream without a reader."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, stream.fileno())
    os.close(null)


@contextmanager
def without_native_messages() -> Iterator[None]:
    """Discard what libraries write to the process's stderr without an option to silence it; short blocks only."""
    try:
        kept = os.dup(_STDERR)
    except OSError:  # it is closed
        yield
        return
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, _STDERR)
    os.close(null)
    try:
        yield
    finally:
        os.dup2(kept, _STDERR)
        os.close(kept)


class PipeOutput(TextIOWrapper):
    """Text output that goes on without a reader, as after ``head``: the rest is discarded."""

    @classmethod
    def of(cls, stream: TextIOWrapper) -> Self:
        r"""The output of a stream; characters that its encoding lacks become ``\udcff``, as on stderr."""
        stream.flush()
        buffer = open(stream.fileno(), "wb", closefd=False)  # noqa: SIM115
        lines = stream.line_buffering or stream.write_through
        return cls(buffer, stream.encoding, "backslashreplace", line_buffering=lines)

    def write(self, text: str) -> int:
        """Write or discard a text."""
        try:
            return super().write(text)
        except BrokenPipeError:
            discard_output(self)
            return len(text)

    def flush(self) -> None:
        """Write or discard the buffered text."""
        try:
            super().flush()
        except BrokenPipeError:
            discard_output(self)


_TRIM_THRESHOLD: Final = -1
_MMAP_THRESHOLD: Final = -3
"""Parameters of glibc's ``mallopt``, from malloc.h."""
_LARGEST_KEPT: Final = 32 << 20
"""Arrays up to this many bytes use kept memory; the largest value that glibc accepts."""
_KEPT: Final = 256 << 20
"""Free bytes at the end of the heap that glibc does not return to the system."""


def keep_freed_memory() -> None:
    """Make the C library keep freed memory for the arrays of the next frame; for a process that replays and ends.

    Every frame needs the same few hundred arrays. By default glibc returns the pages of large arrays to the system and
    requests them again: thousands per frame, which the system must clear. The peak memory does not change. Other C
    libraries have no such setting; the function then does nothing.
    """
    import ctypes  # only replays need it

    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST_KEPT)
        mallopt(_TRIM_THRESHOLD, _KEPT)
