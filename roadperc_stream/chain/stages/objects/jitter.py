"""How much an object's distances jitter from frame to frame.

The deviation of a distance says how far off it may be; most of that lasts (the quantile's bias, the object's shape) and
does not disturb its rate. What does is estimated from the distances themselves, by how far each lies from the line
through its neighbours: the residuals of local linear fits (T. Gasser, L. Sroka and C. Jennen-Steinmetz, Residual
variance and residual pattern in nonlinear regression, Biometrika 73, 1986).
"""

from dataclasses import dataclass
from math import exp, sqrt

from roadperc_stream.chain.stages.objects.rate_filter import RateFilter
from roadperc_stream.core.time import NS_PER_S

_MEMORY_S = 1.0
_BELIEVED = 2.0
"""How many residuals the deviation of the first distance weighs."""
_LEAST_STD_M = 0.01
_HUBER = 2.0
"""Standard deviations from which on an innovation counts for less and less."""
_STEADIEST, _WILDEST = 0.25, 10.0
"""Mean squared innovations, in their variances, beyond which the variance of a rate is not scaled."""


@dataclass(frozen=True)
class Jitter:
    """Variance in square metres, how many residuals it stands for, and the last distances with their stamps.

    ``innovation`` is the mean of the filter's squared innovations, in units of the variance that it expects of them.
    """

    variance: float
    weight: float
    last_ns: int
    last_m: float
    earlier_ns: int | None = None
    earlier_m: float = 0.0
    innovation: float = 1.0

    @classmethod
    def of_first(cls, stamp_ns: int, distance_m: float, std_m: float) -> "Jitter":
        """Of one distance."""
        return cls(std_m**2, _BELIEVED, stamp_ns, distance_m)

    def after(self, stamp_ns: int, filtered: RateFilter, distance_m: float, std_m: float) -> "Jitter":
        """After one more distance, later than those before, off by ``std_m`` at most; ``filtered`` predicted it."""
        if self.earlier_ns is None:
            return Jitter(self.variance, self.weight, stamp_ns, distance_m, self.last_ns, self.last_m, self.innovation)
        share = (self.last_ns - self.earlier_ns) / (stamp_ns - self.earlier_ns)
        residual = self.last_m - self.earlier_m * (1 - share) - distance_m * share
        square = min(residual**2 / (1 + share**2 + (1 - share) ** 2), std_m**2)
        weight = self.weight * exp((self.last_ns - stamp_ns) / NS_PER_S / _MEMORY_S)
        variance = (self.variance * weight + square) / (weight + 1)
        surprise = filtered.surprise(distance_m, max(sqrt(variance), _LEAST_STD_M))
        innovation = (self.innovation * weight + surprise) / (weight + 1)
        return Jitter(variance, weight + 1, stamp_ns, distance_m, self.last_ns, self.last_m, innovation)

    @property
    def rate_var_scale(self) -> float:
        """By which the filter's variance of the rate is multiplied to be that of this object.

        The filter allows for motions that may come, such as a car that brakes; most objects move more steadily, and
        some do worse. Its innovations tell them apart: covariance matching (R. Mehra, Approaches to adaptive
        filtering, IEEE Transactions on Automatic Control 17, 1972).
        """
        return min(max(self.innovation, _STEADIEST), _WILDEST)

    def std_m(self, filtered: RateFilter, distance_m: float, std_m: float) -> float:
        """With which the filter takes a distance: more for one that is far off, at most what its deviation says.

        Source: P. Huber, Robust estimation of a location parameter, 1964: its influence is bounded.
        """
        variance = max(self.variance, _LEAST_STD_M**2)
        off = (distance_m - filtered.value) ** 2 / _HUBER**2 - filtered.value_var
        return min(sqrt(max(variance, off)), max(std_m, _LEAST_STD_M))
