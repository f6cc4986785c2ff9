"""How facts are put in words: sizes, counts, lists."""

from collections.abc import Sequence
from typing import Final

_MOST_LISTED: Final = 6
_KILO: Final = 1000


def size(length: int) -> str:
    """Bytes in the unit in which they have up to three digits."""
    value, units = float(length), ["bytes", "kB", "MB", "GB"]
    while value >= _KILO and len(units) > 1:
        value, units = value / _KILO, units[1:]
    return f"{length} bytes" if units[0] == "bytes" else f"{value:.1f} {units[0]}"


def listed(names: Sequence[str], most: int = _MOST_LISTED) -> str:
    """Names by commas; of many the first ones."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def rounded(value: float | None) -> str:
    """Two decimals, or one from 10 on; nothing for None."""
    return "" if value is None else f"{value:z.1f}" if abs(value) >= 10 else f"{value:z.2f}"
