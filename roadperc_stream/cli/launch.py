"""The start of every command, and its exit code. Imports no library that reads the environment set here."""

import gc
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from functools import partial
from importlib import import_module
from io import TextIOWrapper

from roadperc_stream.errors import RegressionError, RoadpercError
from roadperc_stream.system.process import (
    PipeOutput,
    discard_output,
    ending_signals,
    interrupt,
    interrupted,
    optional_output,
)
from roadperc_stream.system.text import print_line

COMMANDS = {
    "batch": "replay many logs, one per core or on a cluster",
    "bisect": "find the shortest excerpt for which a criterion fails",
    "check": "check runs against limits: passed or failed",
    "compare": "compare runs with a base: worse, better or unchanged",
    "convert": "convert folders of frames, such as CARLA dumps, to a log",
    "degrade": "write a log with corruptions of known severity",
    "find": "find events in many logs by a condition in SQL",
    "infer": "write the segmentation and detections that networks compute",
    "info": "show a log's channels, rates, roles and damage",
    "lanes": "write or score lanes in the formats of TuSimple and CULane",
    "render": "render a scene with exact truth",
    "replay": "replay a log through the perception chain",
    "report": "show the coverage, errors and latency of runs",
    "sweep": "replay a log once per combination of settings",
    "trajectory": "score trajectories; write TUM and KITTI files",
    "view": "open a log in Rerun or Foxglove, or write a video",
}
"""Each is a module of this package, the subcommand ``roadperc ...`` and the console script ``roadperc-...``."""
COMPLETING = "_ARGCOMPLETE"
"""The variable that a shell sets when it asks for completions: the position of the command among the line's words."""
EXIT_DONE, EXIT_ERROR = 0, 1
EXIT_UNDECIDED = 3
"""Of an error in a command whose exit code 1 is a result."""
CONTRACT = "info --contract"
_NEW_OBJECTS = 20_000
"""New objects before a search for cycles. Frames leave hardly any; the default, 700, takes 1 % of their time."""
_JUDGING = ("bisect", "check", "compare", CONTRACT)
"""Commands whose exit code 1 is a result."""


def _error_code(name: str) -> int:
    """The exit code of an error in a command."""
    return EXIT_UNDECIDED if name in _JUDGING else EXIT_ERROR


def run(command: Callable[[], int | None], name: str = "") -> int:
    """Run a command, and return its exit code; ``name`` is needed if exit code 1 is one of its results.

    An error of the project or the system is one line on stderr and exit code 1, or 3 if 1 is a result. So is a signal,
    which raises KeyboardInterrupt so that partial files are removed. A ``RegressionError`` is a result: one line and
    exit code 1. Output without a reader, as after ``head``, is no error.
    """
    gc.freeze()
    gc.set_threshold(_NEW_OBJECTS)
    gc.enable()
    warnings.showwarning = _print_warning
    code = EXIT_DONE
    try:
        with optional_output():
            code = _code_of(command)
    except RegressionError as error:
        _print_error(str(error))
        _discard_unwritable()
        return EXIT_ERROR
    except (RoadpercError, KeyboardInterrupt, MemoryError, OSError, UnicodeEncodeError) as error:
        _print_error(f"error: {_text_of(error)}")
        _discard_unwritable()
        return _error_code(name)
    return code


def _code_of(command: Callable[[], int | None]) -> int:
    try:
        code: object = command()
    except SystemExit as end:  # argparse, after the help, the version or a usage error
        code = end.code
    except Exception as error:
        if interrupted():  # pydantic raises its own error if a signal comes while it serialises settings
            raise KeyboardInterrupt from error
        raise
    return code if isinstance(code, int) else EXIT_DONE


def _text_of(error: BaseException) -> str:
    match error:
        case OSError():
            return ": ".join(str(word) for word in (error.filename, error.strerror or error) if word)
        case UnicodeEncodeError():  # a library cannot encode a text, such as a file name
            return f"{error.object!r}: expected a name in {error.encoding.upper()}"
        case MemoryError():
            return "not enough memory"
    return str(error) or "interrupted"


def _print_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning without its place in the code."""
    _print_error(f"note: {message}")


def _print_error(text: str) -> None:
    with optional_output(sys.stderr):
        print_line(" ".join(text.splitlines()), sys.stderr)


def _discard_unwritable() -> None:
    """Discard output that stdout does not take: the interpreter would fail when it flushes again."""
    try:
        sys.stdout.flush()
    except OSError:
        discard_output(sys.stdout)


def _launch(command: str) -> int:
    """Import and run a command; a fault of the program prints its traceback."""
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # saves 30 ms
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # unused threads busy-wait: 0.1 s of CPU
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # Arrow reuses freed memory: 7 MB less
    for number in ending_signals():
        signal.signal(number, interrupt)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the shell, as with ``>&-``
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout = PipeOutput.of(sys.stdout)
    try:
        code = run(partial(_imported, command), command)  # also an error of the imports, before the command calls it
    except Exception:
        sys.excepthook(*sys.exc_info())
        code = _error_code(command)
    if code and any(not thread.daemon for thread in threading.enumerate()[1:]):
        os._exit(code)  # the interpreter would wait for a thread of a library that may never end
    return code


def _imported(command: str) -> int:
    gc.disable()  # imports make no garbage; saves a tenth of their time. ``run`` in the command enables it
    code: int = import_module(f"roadperc_stream.cli.{command}").main()
    return code


def roadperc() -> int:
    """Start the subcommand of ``roadperc``; without one, the parser that lists them."""
    words = sys.argv[1:]
    if COMPLETING in os.environ:
        words = os.environ.get("COMP_LINE", "")[: int(os.environ.get("COMP_POINT", "0"))].rpartition(" ")[0].split()[1:]
    command = words[0] if words else ""
    if command not in COMMANDS:
        return _launch("subcommands")
    if COMPLETING in os.environ:
        os.environ[COMPLETING] = "2"
    sys.argv[:2] = [f"roadperc {command}"]
    return _launch(command)


def __getattr__(name: str) -> partial[int]:
    if name in COMMANDS:
        return partial(_launch, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
