"""What every command shares: its parser's frame, errors and signals to exit codes, checked numbers."""

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
from roadperc_stream.system.process import EXIT_DONE, EXIT_ERROR, discard_output, ending_signals, optional_output
from roadperc_stream.system.text import print_line, shown

_AGAIN_AFTER_S = 0.05
_MOST_CHARACTERS = 255
"""To either side of the one that a text must not have: a file's name is no longer."""
_COMPLETING = "_ARGCOMPLETE"
"""Set by a shell that asks for completions."""


class _Parser(argparse.ArgumentParser):
    """What it prints may go unread; argparse itself ends with an error then, or passes over a full disk."""

    def _print_message(self, message: str, file: Any = None) -> None:
        with optional_output(file or sys.stderr):
            (file or sys.stderr).write(message)

    def error(self, message: str) -> NoReturn:
        """End with exit code 2; a shell's pattern may have put any file's name into the message."""
        super().error(shown(message))


def command_parser(name: str, description: str, example: str, usage: str | None = None) -> argparse.ArgumentParser:
    """A parser whose texts keep their lines, with ``--version``."""
    parser = _Parser(
        prog=f"roadperc-{name}",
        usage=usage,
        description=description,
        epilog=example,
        formatter_class=argparse.RawDescriptionHelpFormatter,
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
    """As argparse's own, but the version is looked up only where somebody asks for it: that takes 30 ms."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print it and end."""
        from roadperc_stream import __version__

        parser._print_message(f"{parser.prog} {__version__}\n", sys.stdout)
        parser.exit()


def parse(
    parser: argparse.ArgumentParser, argv: Sequence[str] | None, *, intermixed: bool = False
) -> argparse.Namespace:
    """The arguments of a command; a shell that completes its line gets what could come next instead, and the end.

    Args:
        parser: of the command.
        argv: what is parsed; None for the command line.
        intermixed: options may stand among files.
    """
    if _COMPLETING in os.environ:
        import argcomplete
        from argcomplete.completers import SuppressCompleter

        silent = SuppressCompleter()  # an argument without a completer gets no files
        argcomplete.autocomplete(parser, always_complete_options=False, default_completer=silent)
    given = list(sys.argv[1:] if argv is None else argv)
    if "--" in given:  # argparse loses it among files that stand between options
        at = given.index("--")
        given[at:] = [f"./{name}" if name.startswith("-") and name != "-" else name for name in given[at + 1 :]]
    return parser.parse_intermixed_args(given) if intermixed else parser.parse_args(given)


def part(module: str) -> Any:
    """A module of ``tools`` or ``eval``, which the package knows by name alone.

    A command reaches for those with names and numbers while it builds its parser, and for the one that does its work
    before ``run``: a signal that comes in the middle of an import must not unwind it, for it may swallow the error.
    """
    return import_module(f"roadperc_stream.{module}")


def run(command: Callable[[], None]) -> int:
    """Run a command; what the project states, and what the system refuses, is one line on stderr and exit code 1.

    A signal that ends the program unwinds it like Ctrl-C, so that nothing half written stays behind.
    """
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
    logging = import_module("logging")  # 4 ms that a wrong usage does not wait for
    logging.setLogRecordFactory(part("cli.log_records").ShownRecord)
    warnings.showwarning = _note
    try:
        with _signals_unwind():
            command()
            sys.stdout.flush()
    except RoadpercError as error:
        return _fail(str(error), "" if isinstance(error, RegressionError) else "error: ")
    except (KeyboardInterrupt, MemoryError) as error:
        return _fail("not enough memory" if isinstance(error, MemoryError) else str(error) or "interrupted")
    except BrokenPipeError:  # the reader has seen enough, as with | head
        discard_output(sys.stdout)
        return EXIT_DONE
    except OSError as error:
        return _fail(": ".join(str(word) for word in (error.filename, error.strerror or error) if word))
    except UnicodeEncodeError as error:
        return _fail(_unencodable(error))
    return EXIT_DONE


def _note(message: Warning | str, *_: object, **__: object) -> None:
    """Show a warning of the package or of a library as a line on stderr, without the place in its code."""
    with optional_output(sys.stderr):
        print_line(f"note: {' '.join(str(message).splitlines())}", sys.stderr)


def _fail(text: str, prefix: str = "error: ") -> int:
    with optional_output(sys.stderr):
        print_line(f"{prefix}{' '.join(text.splitlines())}", sys.stderr)
    return EXIT_ERROR


def _unencodable(error: UnicodeEncodeError) -> str:
    """A text that a library cannot take, such as a file's name; of a long one what surrounds the character."""
    text = error.object[max(error.start - _MOST_CHARACTERS, 0) : error.end + _MOST_CHARACTERS]
    return f"{text!r}: expected a name in {error.encoding.upper()}"


@contextmanager
def _signals_unwind() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, _interrupt) for number in (*ending_signals(), signal.SIGALRM)}
    hook, sys.unraisablehook = sys.unraisablehook, _interrupt_again
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _interrupt_again(ignored: "sys.UnraisableHookArgs") -> None:
    """A signal that comes while Python deletes an object is dropped there, so it is sent once more."""
    if ignored.exc_type is KeyboardInterrupt:
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_AFTER_S)
    else:
        sys.__unraisablehook__(ignored)


def number(least: float, most: float, expected: str, kind: type[float] = float) -> Callable[[str], Any]:
    """The type of an argument that is a number of a kind between two limits; others are wrong usage.

    Args:
        least: the lowest number.
        most: the highest number.
        expected: what a message says of them.
        kind: int or float.
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
"""The least of numbers above 0: a nanosecond."""
whole_number = number(1, math.inf, "a whole number of 1 or more", int)
seconds = number(-_CENTURY_S, _CENTURY_S, "seconds")
positive_seconds = number(ABOVE_0, _CENTURY_S, "more than 0 seconds")


def image_size(text: str) -> tuple[int, int]:
    """An argument such as 1280x720: columns and rows."""
    found = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text, re.IGNORECASE)
    if not found:
        raise argparse.ArgumentTypeError(f"{text!r}: expected columns and rows such as 1280x720")
    return int(found[1]), int(found[2])
