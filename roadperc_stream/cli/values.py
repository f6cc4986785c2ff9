"""Types of arguments: checked numbers and sizes."""

import argparse
import math
import re
from collections.abc import Callable
from typing import Any, Final


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


_CENTURY_S: Final = 3.2e9
ABOVE_0: Final = 1e-9
"""The lowest number above 0: a nanosecond."""
whole_number = number(1, math.inf, "a whole number of 1 or more", int)
seed = number(0, 2**63 - 1, "a whole number of 0 or more", int)
seconds = number(-_CENTURY_S, _CENTURY_S, "seconds")
positive_seconds = number(ABOVE_0, _CENTURY_S, "more than 0 seconds")


def image_size(text: str) -> tuple[int, int]:
    """Columns and rows of an argument such as 1280x720."""
    found = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text, re.IGNORECASE)
    if not found:
        raise argparse.ArgumentTypeError(f"{text!r}: expected columns and rows, such as 1280x720")
    return int(found[1]), int(found[2])
