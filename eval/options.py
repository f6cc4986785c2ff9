"""Options of the evaluation: choices, and rules for fields and metrics."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final, Literal

from roadperc_stream.errors import RoadpercError
from roadperc_stream.system.time import NS_PER_S

Alignment = Literal["se3", "sim3", "origin", "none"]
"""Alignment of the estimated path to the true one."""
DeltaUnit = Literal["frames", "metres"]
LanePairing = Literal["stamp", "order"]
"""How frames of the true lanes are paired with frames of the run."""
WORST_FRAMES: Final = 3
APART_NS: Final = NS_PER_S
"""Worst frames that are nearer in time show the same moment."""
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


def _last(amounts: Sequence[Amount], name: str) -> Amount | None:
    return next((item for item in reversed(amounts) if fnmatchcase(name, item.pattern)), None)


def number_or_text(text: str) -> float | str:
    """The typed value, as a number if possible: 2 equals 2.0."""
    try:
        return float(text)
    except ValueError:
        return text
