"""How the ego car and the one before it drive on, brake, stand and drive off, in phases of constant acceleration."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float

from .options import RenderOptions
from .roads import AFTER_S, TURN_BRAKING_MPS2, TURN_MPS, TURN_RADIUS_M
from .sheet import CAR_M

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


def ramp(speed_mps: float, acceleration_mps2: float) -> Phase:
    """The phase from a standstill to a speed or, with a negative acceleration, back."""
    return speed_mps / abs(acceleration_mps2), acceleration_mps2


BRAKES_AFTER_S: Final = 2.0
HARD_MPS2: Final = 6.0
"""How hard the car before brakes."""
HARDER_MPS2: Final = 8.0
"""How hard the ego car brakes, late."""
NEAR_MISS_M: Final = 0.8
"""What is left between the two cars."""
GAP_S: Final = 1.6
"""Headway between the cars' middles before the car ahead brakes hard."""
STAND_S: Final = 2.0
DRIVE_OFF_MPS2: Final = 2.0
DRIVE_OFF_LATER_S: Final = 1.5

CRUISE_S: Final = 2.0
"""How long the queue's cars drive at their speed before they brake again."""
QUEUE_MPS2: Final = 2.5
QUEUE_GAP_M: Final = 2.0
"""Between cars that stand in the queue."""
REACTION_S: Final = 0.8


@dataclass(frozen=True)
class Pair:
    """The motions of the ego car and of the car before it."""

    ego: SpeedProfile | None = None
    leader: SpeedProfile | None = None


def pair_of(options: RenderOptions) -> Pair:
    """The motions the options ask for; None where a car keeps its plain way of driving."""
    if options.lead_brakes:
        return hard_braking(options.speed_mps)
    if options.stop_and_go:
        return queue(options.speed_mps, options.seconds)
    if options.turn is not None:
        return Pair(slow_turn(options.speed_mps))
    return Pair()


def hard_braking(speed_mps: float) -> Pair:
    """The car before brakes hard to a standstill, the ego car brakes late, and both drive off again."""
    gap = max(GAP_S * speed_mps, CAR_M[0] + 2.0)
    off = ramp(speed_mps, DRIVE_OFF_MPS2)
    leader = SpeedProfile(gap, speed_mps, ((BRAKES_AFTER_S, 0.0), ramp(speed_mps, -HARD_MPS2), (STAND_S, 0.0), off))
    ego_stop = ramp(speed_mps, -HARDER_MPS2)
    leader_stops_m = leader.at(BRAKES_AFTER_S + speed_mps / HARD_MPS2)[0]
    room = leader_stops_m - CAR_M[0] - NEAR_MISS_M - speed_mps * ego_stop[0] / 2
    brakes_s = room / speed_mps
    drives_off_s = BRAKES_AFTER_S + speed_mps / HARD_MPS2 + STAND_S + DRIVE_OFF_LATER_S
    stands_s = max(drives_off_s - brakes_s - ego_stop[0], 0.5)
    return Pair(SpeedProfile(0.0, speed_mps, ((brakes_s, 0.0), ego_stop, (stands_s, 0.0), off)), leader)


def slow_turn(speed_mps: float) -> SpeedProfile:
    """Slower to a crossing's corner, round it and on at the speed before."""
    slower = max(speed_mps - TURN_MPS, 0.0) / TURN_BRAKING_MPS2
    round_s = TURN_RADIUS_M * np.pi / 2 / min(speed_mps, TURN_MPS)
    brake, off = (slower, -TURN_BRAKING_MPS2), (slower, TURN_BRAKING_MPS2)
    return SpeedProfile(0.0, speed_mps, ((AFTER_S, 0.0), brake, (round_s, 0.0), off))


def queue(speed_mps: float, seconds: float) -> Pair:
    """Both drive off, drive, brake and stand, again and again; the ego car does all of it a little later."""
    brake, off = ramp(speed_mps, -QUEUE_MPS2), ramp(speed_mps, DRIVE_OFF_MPS2)
    wave: tuple[Phase, ...] = ((CRUISE_S, 0.0), brake, (STAND_S, 0.0), off)
    times = int(seconds / sum(phase[0] for phase in wave)) + 2
    gap = CAR_M[0] + QUEUE_GAP_M + speed_mps * REACTION_S
    leader = SpeedProfile(gap, speed_mps, wave * times)
    return Pair(SpeedProfile(0.0, speed_mps, ((REACTION_S, 0.0), *wave * times)), leader)
