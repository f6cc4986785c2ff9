"""What a comparison finds: findings on the statistics of a metric, verdicts on metrics, groups of verdicts."""

from dataclasses import dataclass
from typing import Literal

from .bootstrap import Interval
from .metrics import Metric
from .pairing import RunPair

Mark = Literal["worse", "unchanged", "better"]
Statistic = Literal["mean", "p95", "spread", "worst log", "worst frame", "beyond limit"]


@dataclass(frozen=True)
class Place:
    """The frame in which the new run is worse by most: its number in the new run's table, and both values."""

    pair: RunPair
    frame: int
    stamp_ns: int
    base: float
    new: float


@dataclass(frozen=True)
class MarkedStatistic:
    """A statistic of a metric in both runs, and its mark.

    ``interval`` is that of the difference, if the statistic has one. ``log`` is the name of the pair that the statistic
    describes, empty if it describes all.
    """

    metric: Metric
    statistic: Statistic
    base: float
    new: float
    interval: Interval | None
    mark: Mark
    place: Place | None = None
    log: str = ""


@dataclass(frozen=True)
class Verdict:
    """The means of a metric over the common ``frames``, the interval of their difference, and the mark.

    The mark is worse if a finding is worse. A mean that changes by less than ``relevant`` is unchanged. ``judged`` is
    false for times that are not requested.
    """

    metric: Metric
    frames: int
    base: float
    new: float
    interval: Interval
    mark: Mark
    judged: bool
    findings: tuple[MarkedStatistic, ...] = ()
    place: Place | None = None
    relevant: float = 0.0

    @property
    def difference(self) -> float:
        """New minus base."""
        return self.new - self.base

    @property
    def weight(self) -> float:
        """Largest effect of the findings that have the verdict's mark, as a multiple of the relevant effect."""
        effects = [abs(found.new - found.base) for found in self.findings if found.mark == self.mark]
        return max(effects, default=0.0) / (self.relevant or 1.0)

    @property
    def worst(self) -> MarkedStatistic | None:
        """The finding with the largest effect among those that are worse."""
        worse = [found for found in self.findings if found.mark == "worse"]
        return max(worse, key=lambda found: abs(found.new - found.base), default=None)


@dataclass(frozen=True)
class CauseGroup:
    """Verdicts with one mark that restate one cause, the one with the largest effect first."""

    name: str
    verdicts: tuple[Verdict, ...]
