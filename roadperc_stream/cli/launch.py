"""Where each command starts: a light module, so that a signal finds its handler before the libraries are imported."""

import os
import signal
import sys
from contextlib import suppress
from functools import partial
from importlib import import_module
from io import TextIOWrapper
from types import FrameType


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
    return int(getattr(import_module(f"roadperc_stream.{module}"), main)())


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
    os._exit(1)


compare = partial(_launch, "eval.compare")
convert = partial(_launch, "tools.carla_to_mcap")
info = partial(_launch, "cli.info")
lanes = partial(_launch, "eval.lanes")
render = partial(_launch, "tools.render_scene")
replay = partial(_launch, "cli.replay", "replay_main")
report = partial(_launch, "eval.report")
sweep = partial(_launch, "eval.sweep")
trajectory = partial(_launch, "eval.trajectory")
view = partial(_launch, "cli.view")
