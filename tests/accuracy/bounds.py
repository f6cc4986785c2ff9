"""Measured values, and the bounds that they are judged by."""

from dataclasses import dataclass

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
        met = None if self.limit is None else value.number >= self.limit if self.low else value.number <= self.limit
        return Measured(text, percent(value.coverage), met)


def at_most(limit, unit="%"):
    """An upper bound."""
    return Bound(limit, unit)


def at_least(limit, unit="%"):
    """A lower bound."""
    return Bound(limit, unit, low=True)


def nothing(why):
    """A figure that could not be measured."""
    return Measured(f"not measured: {why}", "", None)


def percent(share):
    """A share in percent; empty for None."""
    return "" if share is None else f"{100 * share:.1f} %"
