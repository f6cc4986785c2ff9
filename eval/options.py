"""Command-line values of the evaluation: choices, rules for fields and metrics, settings to vary."""

import argparse
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final, Literal

from roadperc_stream.errors import RoadpercError

Alignment = Literal["se3", "sim3", "origin", "none"]
"""Alignment of the estimated path to the true one."""
DeltaUnit = Literal["frames", "metres"]
LanePairing = Literal["stamp", "order"]
"""How frames of the true lanes are paired with frames of the run."""
WORST_FRAMES: Final = 3
EVERYTHING = "*"


@dataclass(frozen=True)
class ReportOptions:
    """What a report shows: slices ``by`` columns or SQL expressions, all tables, the ``worst`` frames, and a page."""

    by: Sequence[str] = ()
    full: bool = False
    worst: int = WORST_FRAMES
    html: Path | None = None


@dataclass(frozen=True)
class Amount:
    """A tolerance or an allowance for the names that ``pattern`` matches; with ``relative`` it is a ratio."""

    pattern: str
    value: float
    relative: bool = False


@dataclass(frozen=True)
class Rules:
    """Rules for fields and metrics, by glob; when several amounts match a name, the last one applies.

    A field differs when its absolute difference exceeds its tolerance. A metric may become worse by its allowance,
    in its own unit or as a ratio of the base's mean. ``relevant`` and ``limits`` override the smallest relevant
    effect and the limit of a metric. Times are judged only with ``times``.
    """

    ignored: tuple[str, ...] = ()
    tolerances: tuple[Amount, ...] = ()
    allowances: tuple[Amount, ...] = ()
    times: bool = False
    relevant: Mapping[str, float] = field(default_factory=dict)
    limits: Mapping[str, float] = field(default_factory=dict)

    def ignores(self, name: str) -> bool:
        """Whether a field or metric is left out of the comparison."""
        return any(fnmatchcase(name, pattern) for pattern in self.ignored)

    def tolerance(self, field: str) -> float:
        """Largest absolute difference at which values still agree; 0 by default."""
        found = _last(self.tolerances, field)
        return found.value if found else 0.0

    def allowance(self, metric: str, base_mean: float) -> float:
        """Amount by which a metric may become worse, in its unit; 0 by default."""
        found = _last(self.allowances, metric)
        if found is None:
            return 0.0
        return found.value * abs(base_mean) if found.relative else found.value

    def names(self, metric: str) -> bool:
        """Whether an allowance names this metric, not all metrics."""
        return any(item.pattern != EVERYTHING and fnmatchcase(metric, item.pattern) for item in self.allowances)

    def require_use(self, names: Iterable[str]) -> None:
        """Check that every pattern matches a name, so that a misspelt one is an error.

        Raises:
            RoadpercError: a pattern matches no name.
        """
        known = list(names)
        patterns = [*self.ignored, *(amount.pattern for amount in (*self.tolerances, *self.allowances))]
        idle = [pattern for pattern in patterns if not any(fnmatchcase(name, pattern) for name in known)]
        if idle:
            raise RoadpercError(f"{idle[0]}: matches no field and no metric of these runs; check the spelling")


def tolerance(text: str) -> Amount:
    """Parse ``FIELD=VALUE``."""
    pattern, separator, number = text.rpartition("=")
    if not separator or not pattern:
        raise argparse.ArgumentTypeError(f"{text}: expected FIELD=VALUE, such as lane_left_offset_m=0.001")
    return Amount(pattern, _positive(text, number))


def allowance(text: str) -> Amount:
    """Parse ``METRIC=VALUE``, ``METRIC=N%`` or ``N%``."""
    pattern, _, number = text.rpartition("=")
    if number.endswith("%"):
        return Amount(pattern or EVERYTHING, _positive(text, number[:-1]) / 100, relative=True)
    if not pattern:
        raise argparse.ArgumentTypeError(f"{text}: expected METRIC=VALUE, METRIC=N% or N%")
    return Amount(pattern, _positive(text, number))


def _positive(text: str, number: str) -> float:
    try:
        value = float(number)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: {number!r} is not a number") from error
    if not math.isfinite(value) or value < 0:
        raise argparse.ArgumentTypeError(f"{text}: expected a number of 0 or more")
    return value


def _last(amounts: Sequence[Amount], name: str) -> Amount | None:
    return next((item for item in reversed(amounts) if fnmatchcase(name, item.pattern)), None)


@dataclass(frozen=True)
class Varied:
    """A setting and its values, as typed."""

    key: str
    texts: tuple[str, ...]


def varied(text: str) -> Varied:
    """Parse an argument such as ``lanes.fit_strip_m=0.2,0.3,0.5``.

    Raises:
        ArgumentTypeError: it has another form, or gives a value twice.
    """
    key, _, values = text.partition("=")
    texts = tuple(value.strip() for value in values.split(","))
    if not key.strip() or not all(texts):
        raise argparse.ArgumentTypeError(f"{text}: expected KEY=VALUE,VALUE,... such as lanes.fit_strip_m=0.2,0.3,0.5")
    if len({number_or_text(value) for value in texts}) < len(texts):
        raise argparse.ArgumentTypeError(f"{text}: contains a value twice")
    return Varied(key.strip(), texts)


def number_or_text(text: str) -> float | str:
    """The typed value, as a number if possible: 2 equals 2.0."""
    try:
        return float(text)
    except ValueError:
        return text
