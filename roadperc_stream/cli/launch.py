"""Where each command starts: a light module, so that a signal finds its handler before the libraries are imported."""

import gc
import os
import signal
import sys
from contextlib import suppress
from functools import partial
from importlib import import_module
from io import TextIOWrapper
from types import FrameType

from roadperc_stream.core.process import EXIT_ERROR, discard_output, ending_signals


def _launch(command: str) -> int:
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # no look at all that is installed: 30 ms
    gc.disable()  # imports make no garbage, and searching it takes a tenth of their time: ``plumbing.run`` goes on
    _open_closed_streams()
    _keep_stderr_from_libraries()
    _print_any_name()
    for number in ending_signals():
        signal.signal(number, _end)
    try:
        code = int(import_module(f"roadperc_stream.cli.{command}").main())
    except SystemExit as end:  # argparse, after the help, the version or a usage error
        code = end.code if isinstance(end.code, int) else EXIT_ERROR
    return _flushed(code)


def _flushed(code: int) -> int:
    """The exit code, once buffered text is written; the interpreter would print a traceback where that fails."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:  # the reader has seen enough, as with | head
            discard_output(stream)
        except OSError as error:
            discard_output(stream)
            code = code or _refused(error)
    return code


def _refused(error: OSError) -> int:
    with suppress(OSError):
        os.write(sys.stderr.fileno(), f"error: {error.strerror or error}\n".encode())
    return EXIT_ERROR


def _open_closed_streams() -> None:
    """What the shell has closed (``>&-``) goes nowhere: else the next file that is opened would take its number."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115


def _keep_stderr_from_libraries() -> None:
    """What libpng, libjpeg and others write to file 2 by themselves goes nowhere; stderr goes on elsewhere.

    They write of every image that is damaged, and no setting of theirs stops it. What is wrong, and with which
    message, is said by the command. Threads do not disturb each other: nothing is switched to and fro.
    """
    if sys.stderr.fileno() != 2:
        return
    sys.stderr.flush()
    own = open(os.dup(2), "w", buffering=1, encoding=sys.stderr.encoding, errors="backslashreplace")  # noqa: PTH123, SIM115
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    os.close(null)
    sys.stderr = own


def _print_any_name() -> None:
    r"""A name that the terminal's encoding lacks is printed as ``\udcff``, on stdout as Python does on stderr."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _end(_number: int, _frame: FrameType | None) -> None:
    """End at once: outside ``plumbing.run`` nothing is half written, and what is being imported may swallow errors."""
    with suppress(OSError):
        os.write(sys.stderr.fileno(), b"error: interrupted\n")
    os._exit(EXIT_ERROR)


COMMANDS = ("batch", "compare", "convert", "info", "lanes", "render", "replay", "report", "sweep", "trajectory", "view")
"""Each is a module beside this one, and the console script ``roadperc-...`` of that name."""

batch = partial(_launch, "batch")
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
