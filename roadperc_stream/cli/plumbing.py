"""Shared by all commands: the parser, exit codes of errors and signals, and checked numbers."""

import argparse
import gc
import math
import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from roadperc_stream.cli.launch import COMPLETING
from roadperc_stream.errors import RegressionError, RoadpercError
from roadperc_stream.system import process
from roadperc_stream.system.process import EXIT_DONE, EXIT_ERROR, discard_output, optional_output
from roadperc_stream.system.text import print_line, shown


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Exit with code 2; the message is escaped, because a shell's pattern may insert any file name."""
        super().error(shown(message))


def command_parser(name: str, description: str, example: str, usage: str | None = None) -> argparse.ArgumentParser:
    """A parser with ``--version`` that keeps the lines of its texts; its name is the one that the user typed.

    Options are not abbreviated, so that a new option changes the meaning of no script.
    """
    subcommand, version = f"roadperc {name}".strip(), ""
    if "--version" in sys.argv:  # finding it takes 30 ms
        from roadperc_stream import __version__ as version
    parser = _Parser(
        prog=subcommand if not name or sys.argv[0] == subcommand else f"roadperc-{name}",
        usage=usage,
        description=description,
        epilog=example,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {version}")
    return parser


def parse(
    parser: argparse.ArgumentParser, argv: Sequence[str] | None, *, intermixed: bool = False
) -> argparse.Namespace:
    """The arguments of a command; if a shell asks for completions, print them and exit.

    ``intermixed`` allows options between files.
    """
    if COMPLETING in os.environ:
        import argcomplete
        from argcomplete.completers import SuppressCompleter

        silent = SuppressCompleter()  # an argument without a completer gets no files
        argcomplete.autocomplete(parser, always_complete_options=False, default_completer=silent)
    return parser.parse_intermixed_args(argv) if intermixed else parser.parse_args(argv)


def run(command: Callable[[], None], error_code: int = EXIT_ERROR) -> int:
    """Run a command; an error of the project or the system is one line on stderr and exit code ``error_code``.

    A ``RegressionError`` is a result: one line and exit code 1. A signal that ends the program raises an exception as
    Ctrl-C does, so that partial files are removed.
    """
    gc.freeze()
    gc.enable()
    warnings.showwarning = _note
    import logging  # takes 4 ms, not needed for wrong usage

    from roadperc_stream.cli.log_records import ShownRecord

    logging.setLogRecordFactory(ShownRecord)
    try:
        command()
        print(end="", flush=True)
    except BrokenPipeError:  # a reader such as head may close the pipe
        discard_output(sys.stdout)
    except RegressionError as error:
        _say(str(error))
        return EXIT_ERROR
    except (RoadpercError, KeyboardInterrupt, MemoryError, OSError, UnicodeEncodeError) as error:
        _say(f"error: {_words_of(error)}")
        return error_code
    except Exception:
        if not process.is_interrupted:
            raise
        _say("error: interrupted")
        return error_code
    return EXIT_DONE


def _words_of(error: BaseException) -> str:
    match error:
        case OSError():
            return ": ".join(str(word) for word in (error.filename, error.strerror or error) if word)
        case UnicodeEncodeError():  # a library cannot encode a text, such as a file name
            return f"{error.object!r}: expected a name in {error.encoding.upper()}"
        case MemoryError():
            return "not enough memory"
    return str(error) or "interrupted"


def _note(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning without its place in the code."""
    _say(f"note: {message}")


def _say(text: str) -> None:
    """Print one line on stderr."""
    with optional_output(sys.stderr):
        print_line(" ".join(text.splitlines()), sys.stderr)


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
