"""Where each command starts: a light module, so that a signal finds its handler before the libraries are imported."""

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

from roadperc_stream.system.process import EXIT_ERROR, discard_output, ending_signals

_MOST_HIDDEN_BYTES = 1 << 20
"""Further writes to file 2 fail: a log must not fill the memory with what libraries say of its images."""
_STATED = 64
"""Added to the exit code of a child process that said what there was to say."""
_LIMITED = "not enough memory under the limit that ulimit sets"
_PR_SET_PDEATHSIG = 1  # of Linux's prctl: the child process ends with its parent


def _launch(command: str) -> int:
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # no look at all that is installed: 30 ms
    gc.disable()  # imports make no garbage, and searching it takes a tenth of their time: ``plumbing.run`` goes on
    _open_closed_streams()
    for number in ending_signals():
        signal.signal(number, _end)
        atexit.register(signal.signal, number, signal.SIG_IGN)  # else Python restores the default, which ends it by -15
    _keep_stderr_from_libraries()
    _print_any_name()
    code = _watched(command) if _is_limited() else _ended(command)
    for number in ending_signals():
        signal.signal(number, lambda *_: os._exit(code))
    return code


def _ended(command: str) -> int:
    """Run a command; the exit code."""
    try:
        code = int(import_module(f"roadperc_stream.cli.{command}").main())
    except SystemExit as end:  # argparse, after the help, the version or a usage error
        code = end.code if isinstance(end.code, int) else EXIT_ERROR
    except MemoryError:
        code = _refused("not enough memory")
    except OSError as error:  # such as no space for the help
        code = _refused(str(error) if error.filename else error.strerror or str(error))
    return _flushed(code)


def _is_limited() -> bool:
    """Whether ``ulimit -v`` or ``ulimit -d`` may refuse memory to the libraries."""
    from resource import RLIM_INFINITY, RLIMIT_AS, RLIMIT_DATA, getrlimit

    return any(getrlimit(which)[0] != RLIM_INFINITY for which in (RLIMIT_AS, RLIMIT_DATA))


def _watched(command: str) -> int:
    """Run a command in a child process: libraries that get no memory crash, or exit without a word."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # no memory for threads that a replay does not use
    if not (child := os.fork()):
        os._exit(_STATED + _ended_under_limit(command))  # the libraries may crash at their end too
    for number in ending_signals():
        signal.signal(number, lambda number, _: os.kill(child, number))
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return code - _STATED if code >= _STATED else _refused(f"{_LIMITED}: the process ended with {code}")


def _ended_under_limit(command: str) -> int:
    for number in ending_signals():
        signal.signal(number, partial(_end, code=_STATED + EXIT_ERROR))
    faulthandler.disable()  # the one line comes from the parent
    signal.signal(signal.SIGABRT, signal.SIG_DFL)
    warnings.simplefilter("ignore")
    warnings.filterwarnings("default", category=UserWarning, module=r"roadperc_stream\.")  # what is for the user
    os.setpgid(0, 0)  # a terminal signals the parent alone, which passes it on once
    try:
        with suppress(AttributeError, OSError):  # Linux only
            import_module("ctypes").CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        return _ended(command)
    except BaseException as error:
        return _refused(f"{_LIMITED}: {repr(error)[-300:]}")


def _flushed(code: int) -> int:
    """The exit code, once buffered text is written; the interpreter would print a traceback where that fails."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            discard_output(stream)
            if not isinstance(error, BrokenPipeError):  # else the reader has seen enough, as with | head
                code = code or _refused(error.strerror or str(error))
    return code


def _refused(why: str) -> int:
    with suppress(OSError):
        os.write(sys.stderr.fileno(), f"error: {' '.join(why.split())}\n".encode(errors="backslashreplace"))
    return EXIT_ERROR


def _open_closed_streams() -> None:
    """What the shell has closed (``>&-``) goes nowhere: else the next file that is opened would take its number."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
            setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115


def _keep_stderr_from_libraries() -> None:
    """Hide what libpng, libjpeg and others write to file 2 by themselves; stderr goes on elsewhere.

    They write of every image that is damaged, and no setting of theirs stops it. What is wrong, and with which
    message, is said by the command. Threads do not disturb each other: nothing is switched to and fro. After an abort
    faulthandler's dump goes to stderr, and then what was hidden: it has the reason.
    """
    faulthandler.disable()  # -X faulthandler: its handlers must come before those of the hidden output
    if sys.stderr.fileno() == 2:
        sys.stderr.flush()
        own, encoding = os.dup(2), sys.stderr.encoding
        hidden = _hidden_file(own)  # which needs it open after the interpreter's end
        sys.stderr = open(own, "w", 1, encoding, "backslashreplace", closefd=False)  # noqa: SIM115
        os.dup2(hidden, 2)
        os.close(hidden)
    faulthandler.enable(sys.stderr)


def _hidden_file(stderr: int) -> int:
    """A file in memory that stderr shows if the process aborts, or the null device if the system has none."""
    try:
        import_module("roadperc_stream.system.fatal_output").show_when_aborted(stderr)
        file = os.memfd_create("stderr", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(file, _MOST_HIDDEN_BYTES)
        fcntl.fcntl(file, fcntl.F_ADD_SEALS, fcntl.F_SEAL_GROW)
    except (AttributeError, ImportError, OSError):  # not on macOS, without a C compiler, or in a sandbox
        return os.open(os.devnull, os.O_WRONLY)
    return file


def _print_any_name() -> None:
    r"""A name that the terminal's encoding lacks is printed as ``\udcff``, on stdout as Python does on stderr."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _end(_number: int, _frame: FrameType | None, code: int = EXIT_ERROR) -> None:
    """End at once: outside ``plumbing.run`` nothing is half written, and what is being imported may swallow errors."""
    with suppress(OSError):
        os.write(sys.stderr.fileno(), b"error: interrupted\n")
    os._exit(code)


COMMANDS = ("batch", "compare", "convert", "info", "lanes", "render", "replay", "report", "sweep", "trajectory", "view")
"""Each is a module beside this one, and the console script ``roadperc-...`` of that name."""


def __getattr__(name: str) -> partial[int]:
    if name in COMMANDS:
        return partial(_launch, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
