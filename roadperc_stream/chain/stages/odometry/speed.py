"""The speed of the car: what the last known one lets the next one be.

A car brakes and accelerates with at most 12 m/s2. Two speeds averaged over two spans of time, one after the other,
differ by at most that times the time between the middles of the spans. The limits widen with the time since the last
known speed, so a wrong one does not exclude the right one for long.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

_MOST_MPS2: Final = 12.0
"""Greatest acceleration and deceleration of a car: three standard deviations."""
_SIGMAS: Final = 3.0


@dataclass(frozen=True)
class KnownSpeed:
    """The last speed that images have shown, with its variance; ``stamp_ns`` is the middle of its span of time.

    Without ``metric`` it is in units of the first step per second.
    """

    mps: float
    variance: float
    stamp_ns: int
    metric: bool = True

    def variance_after(self, seconds: float) -> float:
        """Variance of the speed after a time."""
        return self.variance + (_MOST_MPS2 / _SIGMAS * seconds) ** 2

    def limits_mps(self, seconds: float, variance: float) -> tuple[float, float]:
        """Least and greatest speed after a time; ``variance`` is that of the speed which is compared with them."""
        reach_mps = _MOST_MPS2 * seconds + _SIGMAS * float(np.sqrt(self.variance + variance))
        return max(self.mps - reach_mps, 0.0), self.mps + reach_mps
