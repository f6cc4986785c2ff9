"""Where each command starts: a light module, so that a signal finds its handler before the libraries are imported."""

import os
import signal
import sys
from contextlib import suppress
from functools import partial
from importlib import import_module
from io import TextIOWrapper
from types import FrameType

EXIT_DONE, EXIT_ERROR = 0, 1


def ending_signals() -> list[int]:
    """The signals that end a command; not those it was started to ignore, as under nohup."""
    return [
        number
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) != signal.SIG_IGN
    ]


def _launch(module: str, main: str = "main") -> int:
    _open_closed_streams()
    _print_any_name()
    for number in ending_signals():
        signal.signal(number, _end)
    try:
        code = int(getattr(import_module(f"roadperc_stream.{module}"), main)())
    except SystemExit as end:  # argparse, after the help, the version or a usage error
        code = end.code if isinstance(end.code, int) else EXIT_ERROR
    return _flushed(code)


def _flushed(code: int) -> int:
    """The exit code, once buffered text is written; the interpreter would print a traceback where that fails."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:  # the reader has seen enough, as with | head
            discard(stream.fileno())
        except OSError as error:
            discard(stream.fileno())
            code = code or _refused(error)
    return code


def _refused(error: OSError) -> int:
    with suppress(OSError):
        os.write(2, f"error: {error.strerror or error}\n".encode())
    return EXIT_ERROR


def discard(descriptor: int) -> None:
    """Send what is still buffered for a stream that takes no more, and all that follows, to the null device."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, descriptor)
    os.close(null)


def _open_closed_streams() -> None:
    """What the shell has closed (``>&-``) goes nowhere: else the next file that is opened would take its number."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115


def _print_any_name() -> None:
    r"""A name that the terminal's encoding lacks is printed as ``\udcff``, on stdout as Python does on stderr."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _end(_number: int, _frame: FrameType | None) -> None:
    """End at once: outside ``command.run`` nothing is half written, and what is being imported may swallow errors."""
    with suppress(OSError):
        os.write(2, b"error: interrupted\n")
    os._exit(EXIT_ERROR)


compare = partial(_launch, "eval.compare")
convert = partial(_launch, "tools.carla_to_mcap")
info = partial(_launch, "info.command")
lanes = partial(_launch, "eval.lanes")
render = partial(_launch, "tools.render_scene")
replay = partial(_launch, "cli", "replay_main")
report = partial(_launch, "eval.report")
sweep = partial(_launch, "eval.sweep")
trajectory = partial(_launch, "eval.trajectory")
view = partial(_launch, "view.command")
