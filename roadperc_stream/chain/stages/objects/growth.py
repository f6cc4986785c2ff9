"""The growth of a box in the image, and the time to impact that follows from it.

An object of constant size at the distance d appears in a size s that is proportional to 1 / d. So the rate of ln(s) is
-d' / d, the inverse of the time to impact (D. Lee, A theory of visual control of braking based on information about
time-to-collision, Perception 5, 1976). It needs neither a distance nor the camera's pitch.
"""

from dataclasses import dataclass
from math import hypot, log, sqrt
from typing import Final

from roadperc_stream.chain.stages.objects import rate_filter
from roadperc_stream.chain.stages.objects.rate_filter import Jitter, RateFilter
from roadperc_stream.model import Box

_PERCENT: Final = 100.0
"""The filter's unit of ln(size), so that its jitter is far above the least one."""
_FIRST_RATE_STD: Final = 1.0
"""Standard deviation of an unknown growth, 1/s."""
_MOST_STEP: Final = 0.5
"""Largest share of the distance that one prediction covers."""
GROWTH_WALK: Final = 0.1
"""Standard deviation by which the growth of an object at an unknown distance changes within a second, 1/s."""
_MOST_JITTER: Final = 3.0
"""Largest deviation of a size that counts fully, in standard deviations: the jitter is the whole error of a size."""
_CORRELATION: Final = 0.5
"""Correlation of the errors of a ground distance and a size. With equal errors of all four edges, as shares of the
sides, the lower edge causes a quarter of the size's variance and all of the distance's."""


@dataclass(frozen=True)
class Approach:
    """Closing speed over distance, 1/s, and its variance: the inverse of the time to impact."""

    rate: float
    variance: float

    @property
    def time_to_impact_std_s(self) -> float:
        """Half the width of the times to impact within one standard deviation of the rate, seconds.

        The rate must exceed its standard deviation.
        """
        return sqrt(self.variance) / (self.rate**2 - self.variance)

    def fused(self, other: "Approach", gate: float) -> "Approach":
        """The weighted mean with the least variance; if both contradict each other, the more certain one.

        Both depend on the lower edge of the box, so their errors are correlated (Y. Bar-Shalom and L. Campo, The effect
        of the common process noise on the two-sensor fused-track covariance, IEEE Transactions on Aerospace and
        Electronic Systems 22, 1986).

        Args:
            other: the approach by another measurement.
            gate: squared difference, in variances, beyond which they contradict each other.
        """
        least = min(self, other, key=lambda approach: approach.variance)
        common = min(_CORRELATION * sqrt(self.variance * other.variance), least.variance)
        total = self.variance + other.variance - 2 * common
        if total <= 0 or (self.rate - other.rate) ** 2 > gate * total:
            return least
        share = (other.variance - common) / total
        variance = (self.variance * other.variance - common**2) / total
        return Approach(share * self.rate + (1.0 - share) * other.rate, variance)


@dataclass(frozen=True)
class Growth:
    """The filter of 100 ln(size) of a box, the size being the root of its area, and the jitter of its sizes."""

    size: RateFilter
    jitter: Jitter

    @classmethod
    def of_first(cls, stamp_ns: int, box: Box, edge_std_px: tuple[float, float]) -> "Growth":
        """The growth after one box, with the standard deviations of its vertical and horizontal edges."""
        size, std = _log_size(box, edge_std_px)
        first = rate_filter.start(size, std, _PERCENT * _FIRST_RATE_STD)
        return cls(first, Jitter.of_first(stamp_ns, size, std))

    def predict(self, walk: float, dt_s: float) -> "Growth":
        """The growth ``dt_s`` seconds later: at constant speed it and its error increase as the distance shrinks.

        Args:
            walk: standard deviation by which the growth changes within a second, 1/s.
            dt_s: seconds, not negative.
        """
        size, noise = self.size, (_PERCENT * walk) ** 2 * dt_s
        closer = 1.0 / (1.0 - min(size.rate / _PERCENT * dt_s, _MOST_STEP))
        by_rate_s = closer * dt_s
        later = RateFilter(
            size.value + _PERCENT * log(closer),
            closer * size.rate,
            size.value_var + 2 * by_rate_s * size.cross_var + by_rate_s**2 * size.rate_var + noise * dt_s**2 / 3,
            closer**2 * (size.cross_var + by_rate_s * size.rate_var) + noise * dt_s / 2,
            closer**4 * size.rate_var + noise,
        )
        return Growth(later, self.jitter)

    def after(self, stamp_ns: int, box: Box, edge_std_px: tuple[float, float], gate: float) -> "Growth":
        """The predicted growth after a box; a box beyond the gate restarts it, because another part is visible."""
        size, std = _log_size(box, edge_std_px)
        if self.size.surprise(size, std) > gate:
            return Growth.of_first(stamp_ns, box, edge_std_px)
        jitter = self.jitter.after(stamp_ns, self.size, size, _MOST_JITTER * std)
        return Growth(self.size.update(size, jitter.std(self.size, size, _MOST_JITTER * std)), jitter)

    @property
    def approach(self) -> Approach:
        """The approach that the growth shows."""
        variance = max(self.jitter.rate_var_scale, 1.0) * self.size.rate_var
        return Approach(self.size.rate / _PERCENT, variance / _PERCENT**2)


def of_distance(distance: RateFilter, variance_scale: float, common_share: float) -> Approach:
    """The approach by the filter of a distance above 0, to first order.

    Args:
        distance: metres and metres per second.
        variance_scale: factor of its variances.
        common_share: standard deviation of an error that all distances share, as a share of them.
    """
    value, rate = distance.value, distance.rate
    by_value, by_rate = rate / value**2, -1.0 / value
    variance = by_value**2 * distance.value_var + by_rate**2 * distance.rate_var
    variance += 2 * by_value * by_rate * distance.cross_var
    return Approach(-rate / value, variance_scale * max(variance, 0.0) + (rate / value * common_share) ** 2)


def _log_size(box: Box, edge_std_px: tuple[float, float]) -> tuple[float, float]:
    """100 ln(size) of a box and its standard deviation; both edges of a side are independent."""
    width, height = box.x_max - box.x_min, box.y_max - box.y_min
    of_x, of_y = edge_std_px
    return _PERCENT * log(width * height) / 2, _PERCENT * sqrt(2.0) * hypot(of_x / width, of_y / height) / 2
