"""The Kalman filter of a distance and its rate, the jitter of the distances, and the effect of the car's own motion.

The rate is a random walk (continuous white noise acceleration: Bar-Shalom, Li and Kirubarajan 2001,
section 6.2.2), so that one step of 0.2 s equals two of 0.1 s. Plain floats are faster than 2x2 matrices.

Most of a distance's error is constant over time (the quantile's bias, the object's shape) and does not disturb its
rate. The jitter is the part that changes from frame to frame. It is estimated from the deviation of each distance from
the line through its neighbours: the residuals of local linear fits (T. Gasser, L. Sroka and C. Jennen-Steinmetz,
Residual variance and residual pattern in nonlinear regression, Biometrika 73, 1986).

Innovations of one sign show that the rate is wrong: the object brakes, the track passed to another one, or the first
distances were wrong. The mean of a right filter's innovations is 0. If it is not, the rate is less certain than the
filter computes, and far from 0 the filter forgets (H. Sorenson and J. Sacks, Recursive fading memory filtering,
Information Sciences 3, 1971).

The car's own motion is known from odometry and is a known input of the filter (Bar-Shalom, Li and Kirubarajan 2001,
section 5.2.1). The filter does not have to estimate that the car brakes, turns or passes an object.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign, exp, hypot, sqrt

from roadperc_stream.model.changed import changed
from roadperc_stream.system.time import NS_PER_S

_MEMORY_S = 1.0
_FIRST_WEIGHT = 2.0
"""Weight of the first distance's deviation, in residuals."""
_LEAST_STD = 0.01
_HUBER = 2.0
"""Standard deviations beyond which the weight of an innovation decreases (Huber's constant)."""
_MOST_LEAN = 3.0
"""Largest innovation that counts fully in their mean, in standard deviations: one outlier shows nothing."""
_STEADIEST, _WILDEST = 0.25, 10.0
"""Limits of the factor of a rate's variance."""
Ray = tuple[float, float, float]
"""A direction in the camera's frame."""
Rows = Sequence[Sequence[float]]
"""A (4, 4) matrix row by row."""


@dataclass(frozen=True)
class RateFilter:
    """Value, rate per second, and their variances and covariance."""

    value: float
    rate: float
    value_var: float
    cross_var: float
    rate_var: float

    def predict(self, rate_walk: float, dt_s: float) -> "RateFilter":
        """The filter ``dt_s`` seconds later.

        Args:
            rate_walk: standard deviation by which the rate changes within a second; grows with the root of time.
            dt_s: seconds, not negative.
        """
        noise = rate_walk**2 * dt_s
        return RateFilter(
            self.value + self.rate * dt_s,
            self.rate,
            self.value_var + 2 * dt_s * self.cross_var + dt_s**2 * self.rate_var + noise * dt_s**2 / 3,
            self.cross_var + dt_s * self.rate_var + noise * dt_s / 2,
            self.rate_var + noise,
        )

    def shifted(self, value: float, rate: float) -> "RateFilter":
        """The filter after a known change of value and rate, which adds no uncertainty."""
        return RateFilter(self.value + value, self.rate + rate, self.value_var, self.cross_var, self.rate_var)

    def mirrored(self) -> "RateFilter":
        """The filter of the negated value."""
        return RateFilter(-self.value, -self.rate, self.value_var, self.cross_var, self.rate_var)

    def doubted(self, factor: float) -> "RateFilter":
        """The filter with variances that are larger by a factor: later measurements count more."""
        return RateFilter(self.value, self.rate, *(factor * v for v in (self.value_var, self.cross_var, self.rate_var)))

    def at(self, value: float, std: float, rate_change: float) -> "RateFilter":
        """The filter with a new value that does not affect the rate; the rate may have changed by ``rate_change``."""
        return RateFilter(value, self.rate, std**2, 0.0, self.rate_var + rate_change**2)

    def update(self, measured: float, std: float) -> "RateFilter":
        """The filter after a measurement of the value with its standard deviation."""
        total = self.value_var + std**2
        innovation = measured - self.value
        rest = std**2 / total
        return RateFilter(
            self.value + self.value_var / total * innovation,
            self.rate + self.cross_var / total * innovation,
            self.value_var * rest,
            self.cross_var * rest,
            self.rate_var - self.cross_var**2 / total,
        )

    def surprise(self, measured: float, std: float) -> float:
        """Squared Mahalanobis distance of a measurement: chi squared with one degree of freedom."""
        return (measured - self.value) ** 2 / (self.value_var + std**2)


@dataclass(frozen=True)
class Jitter:
    """Variance of the values, its weight in residuals, and the last two values with their stamps.

    The unit is that of the filter: metres for distances.

    ``innovation`` is the mean of the filter's squared innovations, in units of their expected variance, and ``lean``
    the mean of the innovations, in units of their expected standard deviation; outliers are bounded.
    """

    variance: float
    weight: float
    last_ns: int
    last: float
    earlier_ns: int | None = None
    earlier: float = 0.0
    innovation: float = 1.0
    lean: float = 0.0

    @classmethod
    def of_first(cls, stamp_ns: int, measured: float, std: float) -> "Jitter":
        """The jitter after one distance."""
        return cls(std**2, _FIRST_WEIGHT, stamp_ns, measured)

    def after(self, stamp_ns: int, filtered: RateFilter, measured: float, std: float) -> "Jitter":
        """The jitter after a later distance with its standard deviation; ``filtered`` is its prediction."""
        if self.earlier_ns is None:
            return changed(self, last_ns=stamp_ns, last=measured, earlier_ns=self.last_ns, earlier=self.last)
        share = (self.last_ns - self.earlier_ns) / (stamp_ns - self.earlier_ns)
        residual = self.last - self.earlier * (1 - share) - measured * share
        square = min(residual**2 / (1 + share**2 + (1 - share) ** 2), std**2)
        weight = self.weight * exp((self.last_ns - stamp_ns) / NS_PER_S / _MEMORY_S)
        variance = (self.variance * weight + square) / (weight + 1)
        surprise = filtered.surprise(measured, max(sqrt(variance), _LEAST_STD))
        innovation = (self.innovation * weight + surprise) / (weight + 1)
        bounded = copysign(min(sqrt(surprise), _MOST_LEAN), measured - filtered.value)
        lean = (self.lean * weight + bounded) / (weight + 1)
        return Jitter(variance, weight + 1, stamp_ns, measured, self.last_ns, self.last, innovation, lean)

    @property
    def one_sided(self) -> float:
        """Square of the mean innovation over its variance: at most chi squared, 1 degree of freedom, if it is 0."""
        return self.lean**2 * self.weight

    def renewed(self) -> "Jitter":
        """The jitter without what it knows of the innovations, for a filter with other variances."""
        return changed(self, innovation=1.0, lean=0.0)

    @property
    def rate_var_scale(self) -> float:
        """Factor of the filter's variance of the rate for this object.

        The filter allows for sudden changes, such as a car that brakes; most objects move more steadily, some less.
        The factor follows from the innovations: covariance matching (R. Mehra, Approaches to adaptive filtering, IEEE
        Transactions on Automatic Control 17, 1972).
        """
        return min(max(self.innovation, self.one_sided, _STEADIEST), _WILDEST)

    def std(self, filtered: RateFilter, measured: float, std: float) -> float:
        """Standard deviation of a distance for the filter: larger for an outlier, at most ``std``.

        Source: P. Huber, Robust estimation of a location parameter, 1964: the influence of an outlier is bounded.
        """
        variance = max(self.variance, _LEAST_STD**2)
        off = (measured - filtered.value) ** 2 / _HUBER**2 - filtered.value_var
        return min(sqrt(max(variance, off)), max(std, _LEAST_STD))


@dataclass(frozen=True)
class EgoRate:
    """Rate of a distance by the car's own motion, m/s: the mean over the last ``dt_s`` seconds, and at their end."""

    mean_mps: float
    end_mps: float
    dt_s: float

    @classmethod
    def after(cls, change_m: float, dt_s: float, before: "EgoRate | None") -> "EgoRate":
        """The rate from the distance's change over a step, extrapolated linearly to the step's end."""
        mean_mps = change_m / dt_s
        if before is None:
            return cls(mean_mps, mean_mps, dt_s)
        return cls(mean_mps, mean_mps + (mean_mps - before.mean_mps) * dt_s / (dt_s + before.dt_s), dt_s)


def start(measured: float, std: float, rate_std: float) -> RateFilter:
    """A filter from one measurement and the standard deviation of the unknown rate."""
    return RateFilter(measured, 0.0, std**2, 0.0, rate_std**2)


def change_of_distance_m(now_T_last: Rows, ray: Ray, distance_m: float) -> float:
    """Change of the distance of a stationary point in the direction ``ray``, metres."""
    scale = distance_m / hypot(*ray)
    return hypot(*moved(now_T_last, (scale * ray[0], scale * ray[1], scale * ray[2]))) - distance_m


def moved(a_T_b: Rows, point_b: Ray, shift: float = 1.0) -> Ray:
    """A point in frame a; with ``shift`` 0 a direction. Plain floats are ten times as fast as ``transform``."""
    x, y, z = point_b
    first, second, third = (xx * x + xy * y + xz * z + x_0 * shift for xx, xy, xz, x_0 in a_T_b[:3])
    return first, second, third
