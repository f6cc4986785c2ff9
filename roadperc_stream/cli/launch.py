"""The start of every command: its environment and its exit code. Imports no library before both are set."""

import gc
import os
import signal
import sys
import threading
from functools import partial
from importlib import import_module
from io import TextIOWrapper

from roadperc_stream.system.process import EXIT_ERROR, EXIT_UNDECIDED, discard_output, ending_signals, interrupt

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
JUDGING = ("bisect", "check", "compare")
"""Commands whose exit code 1 is a result."""
COMPLETING = "_ARGCOMPLETE"
"""The variable that a shell sets when it asks for completions: the position of the command among the line's words."""


def _launch(command: str) -> int:
    """Run a command and return its exit code; a fault of the program prints its traceback."""
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # saves 30 ms
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # unused threads busy-wait: 0.1 s of CPU
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # Arrow reuses freed memory: 7 MB less
    gc.disable()  # imports make no garbage; saves a tenth of their time. ``plumbing.run`` enables it
    for number in ending_signals():
        signal.signal(number, interrupt)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the shell, as with ``>&-``
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    if isinstance(sys.stdout, TextIOWrapper):  # characters that the encoding lacks become \udcff, as on stderr
        sys.stdout.reconfigure(errors="backslashreplace")
    error_code = EXIT_UNDECIDED if command in JUDGING else EXIT_ERROR
    try:
        code = int(import_module(f"roadperc_stream.cli.{command}").main())
    except SystemExit as end:  # argparse, after the help, the version or a usage error
        code = end.code if isinstance(end.code, int) else error_code
    except KeyboardInterrupt:  # during the imports
        print("error: interrupted", file=sys.stderr)
        code = error_code
    except Exception as error:
        import_module("roadperc_stream.system.text").print_trace(error)
        code = error_code
    code = _flushed(code)
    if code and any(not thread.daemon for thread in threading.enumerate()[1:]):
        os._exit(code)  # the interpreter would wait for a thread of a library that may never end
    return code


def _flushed(code: int) -> int:
    """The exit code after flushing the streams; the interpreter would print a traceback if that fails."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            discard_output(stream)
            if not isinstance(error, BrokenPipeError):  # a reader such as head may close the pipe
                code = code or EXIT_ERROR
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
