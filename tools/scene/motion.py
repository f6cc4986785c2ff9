"""Speed along the road in phases: driving on, braking, standing, driving off."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from roadperc_stream.core.geometry import Float

Phase = tuple[float, float]
"""Seconds, and the acceleration in them, m/s^2. The last speed lasts on."""


@dataclass(frozen=True)
class SpeedProfile:
    """A way along the road from ``s_m`` at a speed, in phases."""

    s_m: float
    speed_mps: float
    phases: tuple[Phase, ...]

    @cached_property
    def _knots(self) -> Float:
        """(N + 1, 4) time, s, speed and acceleration at the beginning of each phase, and of what comes after."""
        rows = [(0.0, self.s_m, self.speed_mps, 0.0)]
        for seconds, acceleration in self.phases:
            time_s, s_m, speed, _ = rows[-1]
            rows[-1] = (time_s, s_m, speed, acceleration)
            onwards = speed * seconds + acceleration * seconds**2 / 2
            rows.append((time_s + seconds, s_m + onwards, max(speed + acceleration * seconds, 0.0), 0.0))
        return np.array(rows)

    def at(self, time_s: float) -> tuple[float, float]:
        """Metres along the road and metres per second at a time since the start; before it the first speed holds."""
        knots = self._knots
        index = max(int(np.searchsorted(knots[:, 0], time_s, side="right")) - 1, 0)
        start, s_m, speed, acceleration = (float(v) for v in knots[index])
        since = time_s - start
        acceleration = acceleration if since >= 0 else 0.0
        return s_m + speed * since + acceleration * since**2 / 2, speed + acceleration * since


def stopping(speed_mps: float, braking_mps2: float) -> Phase:
    """The phase from a speed to a standstill."""
    return speed_mps / braking_mps2, -braking_mps2


def starting(speed_mps: float, acceleration_mps2: float) -> Phase:
    """The phase from a standstill to a speed."""
    return speed_mps / acceleration_mps2, acceleration_mps2


def repeated(phases: Iterable[Phase], times: int) -> tuple[Phase, ...]:
    """The phases one after the other, again and again."""
    return tuple(phases) * times
