"""Shared by all commands: the parser, exit codes of errors and signals, and checked numbers."""

import argparse
import gc
import math
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from types import FrameType
from typing import Any, NoReturn

from roadperc_stream.errors import RegressionError, RoadpercError
from roadperc_stream.system import process
from roadperc_stream.system.process import EXIT_DONE, EXIT_ERROR, discard_output, ending_signals, optional_output
from roadperc_stream.system.text import failure, nearest, print_line, shown

_AGAIN_AFTER_S = 0.05
_LOCKING = ("__enter__", "__exit__", "_acquire_restore", "_release_save")
"""Functions of ``threading`` that take or release a lock."""
_FUTURES = "concurrent.futures._base"
"""Its functions hold locks, and wait only in ``threading``."""
_MOST_CHARACTERS = 255
"""Shown on either side of an invalid character: the longest name of a file."""
_COMPLETING = "_ARGCOMPLETE"
"""The variable that a shell sets when it asks for completions."""


class _Parser(argparse.ArgumentParser):
    """A parser that exits normally if its output has no reader, and with an error if the disk is full.

    An unknown option is an error with the most similar known one. Options are not abbreviated, so that a new option
    changes the meaning of no script.
    """

    words: Sequence[str] = ()
    """The arguments of the command."""

    def _print_message(self, message: str, file: Any = None) -> None:
        with optional_output(file or sys.stderr):
            (file or sys.stderr).write(message)

    def error(self, message: str) -> NoReturn:
        """Exit with code 2; the message is escaped, because a shell's pattern may insert any file name.

        argparse complains of missing arguments first, even if an option is misspelled.
        """
        super().error(shown(self._unknown_option() or message))

    def _unknown_option(self) -> str:
        for word in self.words:
            name = word.partition("=")[0]
            if name.startswith("--") and " " not in word and name not in self._option_string_actions:
                near = nearest(name, self._option_string_actions)
                return f"unrecognized arguments: {word}" + (f"; did you mean {near}?" if near else "")
        return ""


def command_parser(name: str, description: str, example: str, usage: str | None = None) -> argparse.ArgumentParser:
    """A parser with ``--version`` that keeps the lines of its texts; its name is the one that the user typed."""
    subcommand = f"roadperc {name}".strip()
    parser = _Parser(
        prog=subcommand if not name or sys.argv[0] == subcommand else f"roadperc-{name}",
        usage=usage,
        description=description,
        epilog=example,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "--version",
        action=_Version,
        nargs=0,
        dest=argparse.SUPPRESS,
        default=argparse.SUPPRESS,
        help="show program's version number and exit",
    )
    return parser


class _Version(argparse.Action):
    """As argparse's action, but finds the version, which takes 30 ms, only when requested."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print the version and exit."""
        from roadperc_stream import __version__

        parser._print_message(f"{parser.prog} {__version__}\n", sys.stdout)
        parser.exit()


def parse(
    parser: argparse.ArgumentParser, argv: Sequence[str] | None, *, intermixed: bool = False
) -> argparse.Namespace:
    """The arguments of a command; if a shell asks for completions, print them and exit.

    ``intermixed`` allows options between files.
    """
    if _COMPLETING in os.environ:
        import argcomplete
        from argcomplete.completers import SuppressCompleter

        silent = SuppressCompleter()  # an argument without a completer gets no files
        argcomplete.autocomplete(parser, always_complete_options=False, default_completer=silent)
    words = list(sys.argv[1:] if argv is None else argv)
    if "--" in words:  # argparse loses it if options stand between files
        at = words.index("--")
        words[at:] = [f"./{name}" if name.startswith("-") and name != "-" else name for name in words[at + 1 :]]
    if isinstance(parser, _Parser):
        parser.words = words
    return parser.parse_intermixed_args(words) if intermixed else parser.parse_args(words)


def part(module: str) -> Any:
    """A module of ``tools`` or ``eval``, which the package may import only by name.

    A command imports the module that does its work before ``run``: a signal must not unwind an import, because the
    import may swallow the exception.
    """
    return import_module(f"roadperc_stream.{module}")


def run(command: Callable[[], None], error_code: int = EXIT_ERROR) -> int:
    """Run a command; an error of the project or the system is one line on stderr and exit code ``error_code``.

    A ``RegressionError`` is a result: one line and exit code 1.

    A signal that ends the program raises an exception as Ctrl-C does, so that partial files are removed.
    """
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
    logging = import_module("logging")  # takes 4 ms, not needed for wrong usage
    logging.setLogRecordFactory(part("cli.log_records").ShownRecord)
    warnings.showwarning = _note
    try:
        with _signals_unwind():
            command()
            sys.stdout.flush()
    except RoadpercError as error:
        is_result = isinstance(error, RegressionError)
        return _fail(str(error), *((EXIT_ERROR, "") if is_result else (error_code,)))
    except (KeyboardInterrupt, MemoryError) as error:
        return _fail("not enough memory" if isinstance(error, MemoryError) else str(error) or "interrupted", error_code)
    except BrokenPipeError:  # a reader such as head may close the pipe
        discard_output(sys.stdout)
        return EXIT_DONE
    except OSError as error:
        return _fail(": ".join(str(word) for word in (error.filename, error.strerror or error) if word), error_code)
    except UnicodeEncodeError as error:  # a library cannot encode a text, such as a file name
        text = error.object[max(error.start - _MOST_CHARACTERS, 0) : error.end + _MOST_CHARACTERS]
        return _fail(f"{text!r}: expected a name in {error.encoding.upper()}", error_code)
    return EXIT_DONE


def _note(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning as one line on stderr, without its place in the code."""
    with optional_output(sys.stderr):
        print_line(f"note: {' '.join(str(message).splitlines())}", sys.stderr)


def _fail(text: str, code: int, prefix: str = "error: ") -> int:
    with optional_output(sys.stderr):
        print_line(f"{prefix}{' '.join(text.splitlines())}", sys.stderr)
    return code


@contextmanager
def _signals_unwind() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, _interrupt) for number in (*ending_signals(), signal.SIGALRM)}
    hooks = sys.unraisablehook, threading.excepthook
    sys.unraisablehook, threading.excepthook = _interrupt_again, _note_of_thread
    try:
        yield
    except RoadpercError:
        raise
    except Exception:
        # A late import may wrap the interruption, and a wait that it ends may release its lock twice.
        if process.is_interrupted:
            raise KeyboardInterrupt from None
        raise
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        sys.unraisablehook, threading.excepthook = hooks
        process.is_interrupted = False
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(_number: int, frame: FrameType | None) -> None:
    """Raise what Ctrl-C raises, but a moment later where a lock is taken or released.

    Otherwise the lock could stay locked, and a thread that needs it would never end.
    """
    process.is_interrupted = True
    if frame and (frame.f_code.co_name in _LOCKING or frame.f_globals.get("__name__") == _FUTURES):
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_AFTER_S)
    else:
        raise KeyboardInterrupt


def _interrupt_again(ignored: "sys.UnraisableHookArgs") -> None:
    """Send a signal again that Python dropped while it deleted an object."""
    if ignored.exc_type is KeyboardInterrupt:
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_AFTER_S)
    elif ignored.exc_value is not None:
        _note(f"exception ignored: {failure(ignored.exc_value, '')}")


def _note_of_thread(ended: threading.ExceptHookArgs) -> None:
    if ended.exc_value is not None:
        _note(f"exception in a thread: {failure(ended.exc_value, '')}")


def number(least: float, most: float, expected: str, kind: type[float] = float) -> Callable[[str], Any]:
    """The type of an argument that is a number between two limits.

    Errors describe the valid numbers as ``expected``; ``kind`` is int or float.
    """

    def parsed(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"{text!r}: expected {expected}")
        return value

    return parsed


_CENTURY_S = 3.2e9
ABOVE_0 = 1e-9
"""The lowest number above 0: a nanosecond."""
whole_number = number(1, math.inf, "a whole number of 1 or more", int)
seconds = number(-_CENTURY_S, _CENTURY_S, "seconds")
positive_seconds = number(ABOVE_0, _CENTURY_S, "more than 0 seconds")


def image_size(text: str) -> tuple[int, int]:
    """Columns and rows of an argument such as 1280x720."""
    found = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text, re.IGNORECASE)
    if not found:
        raise argparse.ArgumentTypeError(f"{text!r}: expected columns and rows, such as 1280x720")
    return int(found[1]), int(found[2])
