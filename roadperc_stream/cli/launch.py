"""The start of every command: a module without libraries, which installs the signal handlers before their import."""

import atexit
import faulthandler
import fcntl
import gc
import os
import signal
import sys
import warnings
from contextlib import suppress
from functools import partial
from importlib import import_module
from io import TextIOWrapper
from types import FrameType

from roadperc_stream.system.process import EXIT_ERROR, EXIT_UNDECIDED, discard_output, ending_signals

_MOST_HIDDEN_BYTES = 1 << 20
"""Further writes to file 2 fail, so that messages of libraries on broken images do not fill the memory."""
_STATED = 64
"""Added to the exit code of a child process that printed its error."""
_UNLINKED = 127
"""Exit code of a process whose dynamic linker found no memory; its message is suppressed."""
_LIMITED = "not enough memory under the limit that ulimit sets"
_PR_SET_PDEATHSIG = 1  # of Linux's prctl: the child process ends with its parent


def _launch(command: str) -> int:
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # saves 30 ms
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # unused threads busy-wait: 0.1 s of CPU
    os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # Arrow reuses freed memory: 7 MB less
    gc.disable()  # imports make no garbage; saves a tenth of their time. ``plumbing.run`` enables it
    _open_closed_streams()
    for number in ending_signals():
        signal.signal(number, partial(_end, code=_error_code(command)))
        atexit.register(signal.signal, number, signal.SIG_IGN)  # otherwise Python restores the default: exit code -15
    _keep_stderr_from_libraries()
    if isinstance(sys.stdout, TextIOWrapper):  # characters that the encoding lacks become \udcff, as on stderr
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        code = _watched(command) if _is_limited() else _ended(command)
    except BaseException as error:  # a fault of the program
        import_module("roadperc_stream.system.text").print_trace(error)
        code = _error_code(command)
    for number in ending_signals():
        signal.signal(number, lambda *_: os._exit(code))
    if code and _has_other_threads():
        os._exit(code)  # the interpreter would wait for a thread that may never end
    return code


def _has_other_threads() -> bool:
    """Whether threads of the pipeline or of code of the user still run."""
    import threading

    others = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    return any(not thread.daemon or thread.name.startswith("roadperc_") for thread in others)


def _ended(command: str) -> int:
    """Run a command and return its exit code."""
    try:
        code = int(import_module(f"roadperc_stream.cli.{command}").main())
    except SystemExit as end:  # argparse, after the help, the version or a usage error
        code = end.code if isinstance(end.code, int) else _error_code(command)
    except MemoryError:
        code = _refused("not enough memory", command)
    except OSError as error:  # such as no space for the help
        code = _refused(str(error) if error.filename else error.strerror or str(error), command)
    return _flushed(code, command)


def _is_limited() -> bool:
    """Whether ``ulimit -v`` or ``ulimit -d`` limits the memory."""
    from resource import RLIM_INFINITY, RLIMIT_AS, RLIMIT_DATA, getrlimit

    return any(getrlimit(which)[0] != RLIM_INFINITY for which in (RLIMIT_AS, RLIMIT_DATA))


def _watched(command: str) -> int:
    """Run a command in a child process, because libraries without memory crash or exit silently."""
    if not (child := os.fork()):
        os._exit(_STATED + _ended_under_limit(command))  # the libraries may also crash while they exit
    for number in ending_signals():
        signal.signal(number, lambda number, _: os.kill(child, number))
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    is_stated = code >= _STATED and code != _UNLINKED
    return code - _STATED if is_stated else _refused(f"{_LIMITED}: the process ended with {code}", command)


def _ended_under_limit(command: str) -> int:
    for number in ending_signals():
        signal.signal(number, partial(_end, code=_STATED + _error_code(command)))
    faulthandler.disable()  # the one line comes from the parent
    signal.signal(signal.SIGABRT, signal.SIG_DFL)
    warnings.simplefilter("ignore")
    warnings.filterwarnings("default", category=UserWarning, module=r"roadperc_stream\.")  # warnings for the user
    os.setpgid(0, 0)  # a terminal signals only the parent, which passes the signal on once
    try:
        with suppress(AttributeError, OSError):  # Linux only
            import_module("ctypes").CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        return _ended(command)
    except BaseException as error:
        return _refused(f"{_LIMITED}: {repr(error)[-300:]}", command)


def _flushed(code: int, command: str) -> int:
    """The exit code after flushing the streams; the interpreter would print a traceback if that fails."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            discard_output(stream)
            if not isinstance(error, BrokenPipeError):  # a reader such as head may close the pipe
                code = code or _refused(error.strerror or str(error), command)
    return code


def _error_code(command: str) -> int:
    """The exit code of an error; 1 is a result of the commands that judge."""
    return EXIT_UNDECIDED if command in {"bisect", "check", "compare"} else EXIT_ERROR


def _refused(why: str, command: str) -> int:
    with suppress(OSError):
        os.write(sys.stderr.fileno(), f"error: {' '.join(why.split())}\n".encode(errors="backslashreplace"))
    return _error_code(command)


def _open_closed_streams() -> None:
    """Redirect streams closed by the shell (``>&-``) to the null device; else the next open file gets the number."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115


def _keep_stderr_from_libraries() -> None:
    """Hide the output of libpng, libjpeg and others to file 2; stderr gets another file number.

    They write about every damaged image, and have no setting to stop it. The command itself reports the message. File 2
    stays redirected, so threads do not disturb each other. After an abort stderr shows faulthandler's dump, and then
    the hidden output, which has the reason.
    """
    faulthandler.disable()  # of -X faulthandler: its handlers must run before those of the hidden output
    if sys.stderr.fileno() == 2:
        sys.stderr.flush()
        own, encoding = os.dup(2), sys.stderr.encoding
        hidden = _hidden_file(own)  # stays open after the interpreter's end
        sys.stderr = open(own, "w", 1, encoding, "backslashreplace", closefd=False)  # noqa: SIM115
        os.dup2(hidden, 2)
        os.close(hidden)
    faulthandler.enable(sys.stderr)


def _hidden_file(stderr: int) -> int:
    """A file in memory, which is printed if the process aborts; the null device if the system has no such files."""
    try:
        import_module("roadperc_stream.system.fatal_output").show_when_aborted(stderr)
        file = os.memfd_create("stderr", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(file, _MOST_HIDDEN_BYTES)
        fcntl.fcntl(file, fcntl.F_ADD_SEALS, fcntl.F_SEAL_GROW)
    except (AttributeError, ImportError, OSError):  # not on macOS, without a C compiler, or in a sandbox
        return os.open(os.devnull, os.O_WRONLY)
    return file


def _end(_number: int, _frame: FrameType | None, code: int) -> None:
    """Exit at once: outside ``plumbing.run`` no file is open, and an import in progress may swallow exceptions."""
    with suppress(OSError):
        os.write(sys.stderr.fileno(), b"error: interrupted\n")
    os._exit(code)


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
_COMPLETING = "_ARGCOMPLETE"
"""Position of the command among a line's words, from 1; a shell sets it when it asks for completions."""


def roadperc() -> int:
    """Start the subcommand of ``roadperc``; without one, the parser that lists them."""
    if _COMPLETING in os.environ:
        complete = os.environ.get("COMP_LINE", "")[: int(os.environ.get("COMP_POINT", "0"))].rpartition(" ")[0].split()
        command = complete[1] if len(complete) > 1 else ""
    else:
        command = sys.argv[1] if len(sys.argv) > 1 else ""
    if command not in COMMANDS:
        return _launch("subcommands")
    if _COMPLETING in os.environ:
        os.environ[_COMPLETING] = "2"
    sys.argv[:2] = [f"roadperc {command}"]
    return _launch(command)


def __getattr__(name: str) -> partial[int]:
    if name in COMMANDS:
        return partial(_launch, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
