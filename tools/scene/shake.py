"""The car's body rocking about its axle, smooth in time."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from roadperc_stream.core.geometry import Float

WAVES: Final = 6
FREQUENCY_HZ: Final = (0.4, 2.5)
"""From the body's slow heave to what a stiff suspension lets through."""


@dataclass(frozen=True, eq=False)
class Shake:
    """A sum of waves whose standard deviation over time is the one asked for."""

    frequency_hz: Float
    phase: Float
    amplitude_rad: float

    def at(self, time_s: float) -> float:
        """Pitch beside the car's own, radians, nose down positive."""
        return self.amplitude_rad * float(np.sin(2 * np.pi * self.frequency_hz * time_s + self.phase).sum())


def shake_of(std_deg: float, seed: int) -> Shake | None:
    """Waves drawn from the seed; none where nothing rocks."""
    if std_deg == 0:
        return None
    rng = np.random.default_rng((seed, 303))
    frequency = rng.uniform(*FREQUENCY_HZ, WAVES)
    return Shake(frequency, rng.uniform(0, 2 * np.pi, WAVES), float(np.radians(std_deg)) * float(np.sqrt(2 / WAVES)))
