"""The Kalman filter of a value and its rate.

The rate is a random walk (continuous white noise acceleration: Bar-Shalom, Li and Kirubarajan 2001,
section 6.2.2), so that one step of 0.2 s equals two of 0.1 s. Two numbers need no matrices: plain floats are faster.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class RateFilter:
    """Value, rate per second, and their variances and covariance."""

    value: float
    rate: float
    value_var: float
    cross_var: float
    rate_var: float

    def predict(self, rate_walk: float, dt_s: float) -> "RateFilter":
        """The same ``dt_s`` seconds later.

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
        """With a known change of value and rate: an input, which adds no uncertainty."""
        return RateFilter(self.value + value, self.rate + rate, self.value_var, self.cross_var, self.rate_var)

    def mirrored(self) -> "RateFilter":
        """Of the value's negative."""
        return RateFilter(-self.value, -self.rate, self.value_var, self.cross_var, self.rate_var)

    def at(self, value: float, std: float, rate_change: float) -> "RateFilter":
        """At a value that says nothing of the rate, which has changed by about so much besides."""
        return RateFilter(value, self.rate, std**2, 0.0, self.rate_var + rate_change**2)

    def update(self, measured: float, std: float) -> "RateFilter":
        """After a measurement of the value with its standard deviation."""
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


def start(measured: float, std: float, rate_std: float) -> RateFilter:
    """From one measurement and what rates there may be."""
    return RateFilter(measured, 0.0, std**2, 0.0, rate_std**2)
