"""The speed of the car: what the last known one lets the next one be.

A car brakes and accelerates with at most 12 m/s2. Two speeds averaged over two spans of time, one after the other,
differ by at most that times the time between the middles of the spans. The limits widen with the time since the last
known speed, so a wrong one does not exclude the right one for long.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from roadperc_stream.system.time import NS_PER_S

_MOST_MPS2: Final = 12.0
"""Greatest acceleration and deceleration of a car: three standard deviations."""
_SIGMAS: Final = 3.0
_DRIFT_MPS2: Final = 1.0
"""Growth of the standard deviation of a speed by points with the time since the last measured one."""


@dataclass(frozen=True)
class KnownSpeed:
    """The last speed that images have shown, with its variance; ``stamp_ns`` is the middle of its span of time.

    It is in metres per second; without ``metric``, in units of the first step per second. ``measured_ns`` is the stamp
    of the last speed that did not come from points alone.
    """

    per_s: float
    variance: float
    stamp_ns: int
    metric: bool
    measured_ns: int

    def by_points(self, per_s: float, variance: float, stamp_ns: int) -> "KnownSpeed":
        """A later speed that only points of earlier frames show: its deviation grows, as their scale may be wrong."""
        drift_per_s = _DRIFT_MPS2 * (stamp_ns - self.measured_ns) / NS_PER_S
        return replace(self, per_s=per_s, variance=variance + drift_per_s**2, stamp_ns=stamp_ns)

    def variance_after(self, seconds: float) -> float:
        """Variance of the speed after a time."""
        return self.variance + (_MOST_MPS2 / _SIGMAS * seconds) ** 2

    def limits_mps(self, seconds: float, variance: float) -> tuple[float, float]:
        """Least and greatest speed after a time; ``variance`` is that of the speed which is compared with them."""
        reach_mps = _MOST_MPS2 * seconds + _SIGMAS * float(np.sqrt(self.variance + variance))
        return max(self.per_s - reach_mps, 0.0), self.per_s + reach_mps
