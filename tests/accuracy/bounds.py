"""Measured values, and the bounds that they are judged by."""

from dataclasses import dataclass, field
from math import inf

DECIMALS = {"%": 1, "cm": 2, "mm": 2, "s": 2, "px": 3, "frames": 0, "": 4, "°": 4}


@dataclass(frozen=True)
class Value:
    """A number in its displayed unit, None if it cannot be measured; coverage is a share."""

    number: float | None
    coverage: float | None = None
    detail: str = ""


@dataclass(frozen=True)
class Measured:
    """The cells of a line; ``met`` is None without a bound or a measured value."""

    text: str
    coverage: str
    met: bool | None
    used: float | None = field(default=None, compare=False)
    """The value, or what is missing to 100 %, as a share of its limit; None without a limit."""


@dataclass(frozen=True)
class Bound:
    """An upper or, with ``low``, a lower bound; without a limit the value is reported only."""

    limit: float | None
    unit: str
    low: bool = False

    @property
    def text(self):
        """The bound as text; empty without a limit."""
        return "" if self.limit is None else f"{'≥' if self.low else '≤'} {self.limit:g} {self.unit}".strip()

    def judge(self, value):
        """The value as text, and whether it keeps the bound."""
        if value.number is None:
            return nothing(value.detail or "no such frame")
        text = f"{value.number:.{DECIMALS[self.unit]}f} {self.unit}".strip()
        text += f" ({value.detail})" if value.detail else ""
        if self.limit is None:
            return Measured(text, percent(value.coverage), None)
        met = value.number >= self.limit if self.low else value.number <= self.limit
        best = 0 if not self.low else 100 if self.unit == "%" else 1
        used = share_of(abs(value.number - best), abs(self.limit - best))
        return Measured(text, percent(value.coverage), met, used)


def at_most(limit, unit="%"):
    """An upper bound."""
    return Bound(limit, unit)


def at_least(limit, unit="%"):
    """A lower bound."""
    return Bound(limit, unit, low=True)


def nothing(why):
    """A figure that could not be measured."""
    return Measured(f"not measured: {why}", "", None)


def share_of(value, limit):
    """A value as a share of its limit, infinite above a limit of 0."""
    return value / limit if limit else inf if value else 0.0


def percent(share):
    """A share in percent; empty for None."""
    return "" if share is None else f"{100 * share:.1f} %"
