"""Measured values and required bounds."""

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
    """An upper or a lower bound."""

    limit: float | None
    unit: str
    low: bool = False

    @property
    def text(self):
        """The bound as text; empty without a limit."""
        return "" if self.limit is None else f"{'≥' if self.low else '≤'} {self.limit:g} {self.unit}".strip()

    def keeps(self, number):
        """True if a number keeps the bound; None without a limit."""
        if self.limit is None:
            return None
        return number >= self.limit if self.low else number <= self.limit


def at_most(limit, unit):
    """An upper bound."""
    return Bound(limit, unit)


def at_least(limit, unit):
    """A lower bound."""
    return Bound(limit, unit, low=True)


def nothing(why):
    """A figure that could not be measured."""
    return Measured(f"not measured: {why}", "", None)


def judged(bound, value):
    """Compare a value with its bound; without a bound it is a percentage."""
    if value.number is None:
        return nothing(value.detail or "no such frame")
    unit = bound.unit if bound else "%"
    detail = f" ({value.detail})" if value.detail else ""
    met = bound.keeps(value.number) if bound else None
    return Measured(f"{value.number:.{DECIMALS[unit]}f} {unit}".strip() + detail, percent(value.coverage), met)


def percent(share):
    """A share in percent; empty for None."""
    return "" if share is None else f"{100 * share:.1f} %"
