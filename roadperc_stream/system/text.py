"""Lines for a terminal, escaped so that foreign text cannot control it; counts and similar names."""

import difflib
from collections.abc import Iterable
from typing import Final, TextIO

_LONGEST: Final = 10_000
"""Characters of a line; a path has 4096 at most."""


def shown(text: str) -> str:
    r"""A line for the terminal, in which no character moves the cursor, changes colours or turns the reading order.

    Control characters, line separators, direction marks and other characters without a glyph are written
    as ``\x1b``, ``\n`` or ``\u202e``; a line that is too long is cut.
    """
    cut = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}… ({len(text) - _LONGEST} more characters)"
    return cut if cut.isprintable() else "".join(s if s.isprintable() else _escaped(s) for s in cut)


def print_line(line: str, stream: TextIO | None = None) -> None:
    """Print a line, escaped; on stdout by default."""
    print(shown(line), file=stream)


def number(count: int, what: str) -> str:
    """A count with its noun: 1 frame, 2 frames."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def nearest(name: str, known: Iterable[str], likeness: float = 0.6) -> str | None:
    """The known name that is most similar to a name, ignoring case; None if none is similar.

    Args:
        name: as the user wrote it.
        known: the names that exist.
        likeness: least similarity, 0 to 1, as the ratio of ``difflib``.
    """
    folded = {candidate.casefold(): candidate for candidate in known}
    close = difflib.get_close_matches(name.casefold(), folded, n=1, cutoff=likeness)
    return folded[close[0]] if close else None


def _escaped(sign: str) -> str:
    return sign.encode("unicode_escape").decode("ascii")
