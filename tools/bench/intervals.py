"""How sure a comparison is: the interval of a ratio from runs of two versions in turn.

The ratios of the rounds, as logarithms, scatter around one that is sought; what disturbs the machine makes a few of
them large. Hodges and Lehmann's estimate is the median of the means of all pairs of them (Walsh averages), and the
interval lies between two of those means, by the distribution of Wilcoxon's signed ranks: exact, whatever the scatter
looks like, as long as it is symmetric. Source: Hollander, Wolfe and Chicken, Nonparametric Statistical Methods, 3.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

Verdict = Literal["slower", "faster", "no difference shown"]


@dataclass(frozen=True)
class Ratio:
    """New over base: the estimate, and the interval that holds it with the confidence asked for."""

    middle: float
    low: float
    high: float

    def verdict(self, share: float) -> "Verdict":
        """Slower where that is sure to be more than a share, faster where it is sure at all."""
        if self.low > 1 + share:
            return "slower"
        return "faster" if self.high < 1 else "no difference shown"


def ratio_of(base: Sequence[float], new: Sequence[float], confidence: float) -> Ratio:
    """The ratio of two versions' times.

    Args:
        base: positive, one a round.
        new: of the same rounds.
        confidence: such as 0.99; where too few rounds can give it, the interval is unbounded.
    """
    logs = np.log(np.asarray(new, float) / np.asarray(base, float))
    first, second = np.triu_indices(len(logs))
    averages = np.sort((logs[first] + logs[second]) / 2)
    outside = _outside(len(logs), confidence)
    if outside is None:
        return Ratio(float(np.exp(np.median(averages))), 0.0, np.inf)
    low, middle, high = np.exp([averages[outside], np.median(averages), averages[-1 - outside]]).tolist()
    return Ratio(low=low, middle=middle, high=high)


def _outside(count: int, confidence: float) -> int | None:
    """How many of the sorted averages lie beyond either end of the interval; None where all of them are too few."""
    below = np.cumsum(signed_rank_probabilities(count))
    allowed = (1 - confidence) / 2
    outside = int(np.searchsorted(below, allowed, side="right"))
    return outside - 1 if outside else None


def signed_rank_probabilities(count: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Probability of each sum of ranks, 0 to n (n + 1) / 2, where each of 1 to n counts or not with equal chance."""
    ways = np.ones(1)
    for rank in range(1, count + 1):
        ways = np.pad(ways, (0, rank)) + np.pad(ways, (rank, 0))
    return ways / 2.0**count
