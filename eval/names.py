"""Names and numbers as a report writes them."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from rich.console import Console

from .quantities import Quantity

_NUMBERS_COLUMNS: Final = 65
"""Characters that the widest row of numbers needs next to a run's name."""
_CUT: Final = "…"


def name_columns(console: Console) -> int:
    """Characters a run's name may have."""
    return console.width - _NUMBERS_COLUMNS


def short_names(names: Sequence[str], columns: int) -> dict[str, str]:
    """What each name is called where only so many characters fit: itself, or its two ends.

    Where two would be called the same, a number in front tells them apart.
    """
    cut = {name: _cut(name, columns) for name in names}
    shared = Counter(cut.values())
    return {
        name: short if shared[short] == 1 else _numbered(name, number, columns)
        for number, (name, short) in enumerate(cut.items(), 1)
    }


def legend(names: Mapping[str, str]) -> Iterator[str]:
    """A line on each name that had to be cut."""
    yield from (f"{short}: {name}" for name, short in names.items() if short != name)


def listed(names: Sequence[str], most: int = 6) -> str:
    """Names in a line: the first of many, and how many more there are."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def _cut(name: str, columns: int) -> str:
    if len(name) <= columns:
        return name
    front = (columns - len(_CUT)) // 2
    return f"{name[:front]}{_CUT}{name[len(name) - (columns - len(_CUT) - front) :]}"


def _numbered(name: str, number: int, columns: int) -> str:
    prefix = f"{number} "
    return f"{prefix}{_cut(name, columns - len(prefix))}"


def rounded(value: float, quantity: Quantity) -> str:
    """A value with the quantity's digits and never a negative zero."""
    return f"{value:z.{quantity.decimals}f}"


def percent(share: float) -> str:
    """A share from 0 to 1 in percent."""
    return f"{100 * share:.1f}"
