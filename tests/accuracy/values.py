"""A measured value, and the bound that is required of it."""

from dataclasses import dataclass

DECIMALS = {"%": 1, "cm": 2, "mm": 2, "s": 2, "px": 3, "frames": 0, "": 4, "°": 4}


@dataclass(frozen=True)
class Value:
    """A number in the unit it is shown in, None where nothing can be measured; coverage is a share."""

    number: float | None
    coverage: float | None = None
    detail: str = ""


@dataclass(frozen=True)
class Measured:
    """A line's cells; ``met`` is None where nothing is required, or nothing could be measured."""

    text: str
    coverage: str
    met: bool | None


@dataclass(frozen=True)
class Bound:
    """What a number has to be at most or at least."""

    limit: float | None
    unit: str
    low: bool = False

    @property
    def text(self):
        """In words; empty where only the unit is known."""
        return "" if self.limit is None else f"{'≥' if self.low else '≤'} {self.limit:g} {self.unit}".strip()

    def keeps(self, number):
        """Whether a number keeps it; None where nothing is required."""
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
    """A value against its bound; without a bound it is a percentage."""
    if value.number is None:
        return nothing(value.detail or "no such frame")
    unit = bound.unit if bound else "%"
    detail = f" ({value.detail})" if value.detail else ""
    met = bound.keeps(value.number) if bound else None
    return Measured(f"{value.number:.{DECIMALS[unit]}f} {unit}".strip() + detail, percent(value.coverage), met)


def percent(share):
    """A share in percent; empty where it means nothing."""
    return "" if share is None else f"{100 * share:.1f} %"
