"""Escaped lines for a terminal, counts, whole numbers, exceptions in one line, and similar names."""

import difflib
from collections.abc import Iterable, Sequence
from reprlib import Repr
from typing import Final, TextIO

_LONGEST: Final = 10_000
"""Characters of a line; the longest path has 4096."""
_MOST_DIGITS: Final = 19
"""Digits of a whole number of 64 bits."""
_REPR: Final = Repr()
"""Values as text, whose lists of lists may be the same list many times, as in YAML."""
_REPR.maxlevel = 3
_REPR.maxdict = _REPR.maxlist = _REPR.maxtuple = _REPR.maxset = _REPR.maxfrozenset = 100
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = 1000


def shown(text: str) -> str:
    r"""A line for the terminal without characters that move the cursor, change colours or the reading direction.

    Control characters, line separators, direction marks and other characters without a glyph become ``\x1b``, ``\n`` or
    ``\u202e``. Long lines are cut.
    """
    cut = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}… ({len(text) - _LONGEST} more characters)"
    if cut.isprintable():
        return cut
    return "".join(s if s.isprintable() else s.encode("unicode_escape").decode("ascii") for s in cut)


def print_line(line: str, stream: TextIO | None = None) -> None:
    """Print a line, escaped; on stdout by default."""
    print(shown(line), file=stream)


def listed(names: Sequence[str], most: int = 6) -> str:
    """The first names in one line, and the number of further ones."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def number(count: int, what: str) -> str:
    """A count with its noun: 1 frame, 2 frames."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def whole_number(text: str) -> int | None:
    """A whole number from 0 of at most 64 bits; None for any other text."""
    return int(text) if text.isascii() and text.isdigit() and len(text) <= _MOST_DIGITS else None


def failure(error: BaseException, name: str) -> str:
    """An exception in one line, with the last line that it passed of ``MODULE`` or ``MODULE:NAME``, if any."""
    place, trace = "", error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_globals.get("__name__") == name.partition(":")[0]:
            place = f" ({trace.tb_frame.f_code.co_filename}, line {trace.tb_lineno})"
        trace = trace.tb_next
    try:
        text = str(error)
    except (KeyboardInterrupt, MemoryError):
        raise
    except BaseException as fault:  # code of the user makes the text
        text = f"its text cannot be made ({type(fault).__name__})"
    return " ".join(f"{type(error).__name__}: {text}".split()).removesuffix(":") + place


def nearest(name: str, known: Iterable[str], likeness: float = 0.6) -> str | None:
    """The known name that is most similar to a name, ignoring case; None if none is similar.

    ``likeness`` is the least similarity, 0 to 1, as ``difflib``'s ratio.
    """
    folded = {candidate.casefold(): candidate for candidate in known}
    close = difflib.get_close_matches(name.casefold(), folded, n=1, cutoff=likeness)
    return folded[close[0]] if close else None


def in_brief(value: object, most: int = 200) -> str:
    """A value of any type and size as text of at most ``most`` characters."""
    try:
        text = _REPR.repr(value)
    except (ValueError, RecursionError):  # too many digits or levels for repr
        return f"a {type(value).__name__} too long to show"
    return text if len(text) <= most else f"{text[:most]}..."
