"""Options on fields and metrics by glob: ignored, tolerated, allowed."""

import argparse
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from roadperc_stream.errors import RoadpercError

EVERYTHING = "*"


@dataclass(frozen=True)
class Amount:
    """A number for the fields or metrics that ``pattern`` matches; ``relative`` says it is a share."""

    pattern: str
    value: float
    relative: bool = False


@dataclass(frozen=True)
class Rules:
    """Globs over names; of several amounts that match, the last one given holds.

    ``tolerances`` are absolute differences between fields that count as none; ``allowances`` how much worse a metric
    may become, in its own unit or as a share of the reference's mean.
    """

    ignored: tuple[str, ...] = ()
    tolerances: tuple[Amount, ...] = ()
    allowances: tuple[Amount, ...] = ()

    def ignores(self, name: str) -> bool:
        """Whether a field or metric is left out."""
        return any(fnmatchcase(name, pattern) for pattern in self.ignored)

    def tolerance(self, field: str) -> float:
        """Absolute difference that counts as none, 0 by default."""
        found = _last(self.tolerances, field)
        return found.value if found else 0.0

    def allowance(self, metric: str, reference_mean: float) -> float:
        """How much worse a metric may become, in its unit; 0 by default."""
        found = _last(self.allowances, metric)
        if found is None:
            return 0.0
        return found.value * abs(reference_mean) if found.relative else found.value

    def names(self, metric: str) -> bool:
        """Whether an allowance is given to this metric, not just to everything."""
        return any(item.pattern != EVERYTHING and fnmatchcase(metric, item.pattern) for item in self.allowances)

    def require_use(self, names: Iterable[str]) -> None:
        """Check that every pattern matches some name: a misspelt one would silently do nothing.

        Raises:
            RoadpercError: one matches none; the message says which.
        """
        known = list(names)
        patterns = [*self.ignored, *(amount.pattern for amount in (*self.tolerances, *self.allowances))]
        idle = [pattern for pattern in patterns if not any(fnmatchcase(name, pattern) for name in known)]
        if idle:
            raise RoadpercError(f"{idle[0]}: matches no field and no metric of these runs")


def tolerance(text: str) -> Amount:
    """``FIELD=VALUE`` as an argument."""
    pattern, separator, number = text.rpartition("=")
    if not separator or not pattern:
        raise argparse.ArgumentTypeError(f"{text}: expected FIELD=VALUE, such as lane_left_offset_m=0.001")
    return Amount(pattern, _positive(text, number))


def allowance(text: str) -> Amount:
    """``METRIC=VALUE``, ``METRIC=N%`` or ``N%`` as an argument."""
    pattern, _, number = text.rpartition("=")
    if number.endswith("%"):
        return Amount(pattern or EVERYTHING, _positive(text, number[:-1]) / 100, relative=True)
    if not pattern:
        raise argparse.ArgumentTypeError(f"{text}: expected METRIC=VALUE, METRIC=N% or N%: metrics differ in unit")
    return Amount(pattern, _positive(text, number))


def _positive(text: str, number: str) -> float:
    try:
        value = float(number)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: {number!r} is not a number") from error
    if not math.isfinite(value) or value < 0:
        raise argparse.ArgumentTypeError(f"{text}: expected 0 or more")
    return value


def _last(amounts: Sequence[Amount], name: str) -> Amount | None:
    return next((item for item in reversed(amounts) if fnmatchcase(name, item.pattern)), None)
