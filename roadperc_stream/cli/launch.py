"""Where each command starts: a light module, so that a signal finds its handler before the libraries are imported."""

import os
import signal
import sys
from contextlib import suppress
from functools import partial
from importlib import import_module
from io import TextIOWrapper
from types import FrameType

from roadperc_stream.core.process import ending_signals


def _launch(command: str) -> int:
    _open_closed_streams()
    _print_any_name()
    for number in ending_signals():
        signal.signal(number, _end)
    return int(import_module(f"roadperc_stream.cli.{command}").main())


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
    """End at once: outside ``plumbing.run`` nothing is half written, and what is being imported may swallow errors."""
    with suppress(OSError):
        os.write(2, b"error: interrupted\n")
    os._exit(1)


COMMANDS = ("compare", "convert", "info", "lanes", "render", "replay", "report", "sweep", "trajectory", "view")
"""Each is a module beside this one, and the console script ``roadperc-...`` of that name."""

compare = partial(_launch, "compare")
convert = partial(_launch, "convert")
info = partial(_launch, "info")
lanes = partial(_launch, "lanes")
render = partial(_launch, "render")
replay = partial(_launch, "replay")
report = partial(_launch, "report")
sweep = partial(_launch, "sweep")
trajectory = partial(_launch, "trajectory")
view = partial(_launch, "view")
