"""Motions of the ego car and the car ahead along the road, in phases of constant acceleration."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float

from .atlas import CAR_M
from .options import RenderOptions
from .roads import AFTER_S, TURN_BRAKING_MPS2, TURN_MPS, TURN_RADIUS_M

Phase = tuple[float, float]
"""Duration in seconds, and acceleration in m/s^2."""


@dataclass(frozen=True)
class SpeedProfile:
    """A motion along the road from ``s_m`` at a speed, in phases; the last speed continues."""

    s_m: float
    speed_mps: float
    phases: tuple[Phase, ...]

    @cached_property
    def _knots(self) -> Float:
        """Return (N + 1, 4) time, s, speed and acceleration at the start of each phase and at the end."""
        rows = [(0.0, self.s_m, self.speed_mps, 0.0)]
        for seconds, acceleration in self.phases:
            time_s, s_m, speed, _ = rows[-1]
            rows[-1] = (time_s, s_m, speed, acceleration)
            onwards = speed * seconds + acceleration * seconds**2 / 2
            rows.append((time_s + seconds, s_m + onwards, max(speed + acceleration * seconds, 0.0), 0.0))
        return np.array(rows)

    def at(self, time_s: float) -> tuple[float, float]:
        """Return s in metres and the speed in m/s at a time in seconds; before 0 the first speed applies."""
        knots = self._knots
        index = max(int(np.searchsorted(knots[:, 0], time_s, side="right")) - 1, 0)
        start, s_m, speed, acceleration = (float(v) for v in knots[index])
        since = time_s - start
        acceleration = acceleration if since >= 0 else 0.0
        return s_m + speed * since + acceleration * since**2 / 2, speed + acceleration * since


def ramp(speed_mps: float, acceleration_mps2: float) -> Phase:
    """Return the phase from standstill to a speed or, with a negative acceleration, from the speed to standstill."""
    return speed_mps / abs(acceleration_mps2), acceleration_mps2


BRAKES_AFTER_S: Final = 2.0
HARD_MPS2: Final = 6.0
"""Braking of the car ahead."""
HARDER_MPS2: Final = 8.0
"""Late braking of the ego car."""
NEAR_MISS_M: Final = 0.8
"""Smallest gap between the two cars."""
GAP_S: Final = 1.6
"""Time gap between the cars' centres before the car ahead brakes."""
STAND_S: Final = 2.0
DRIVE_OFF_MPS2: Final = 2.0
DRIVE_OFF_LATER_S: Final = 1.5

CRUISE_S: Final = 2.0
"""Time at constant speed before the cars of the queue brake again."""
QUEUE_MPS2: Final = 2.5
QUEUE_GAP_M: Final = 2.0
"""Gap between standing cars of the queue."""
REACTION_S: Final = 0.8


def motions_of(options: RenderOptions) -> tuple[SpeedProfile | None, SpeedProfile | None]:
    """Return the motions of the ego car and the car ahead; None for default driving."""
    if options.lead_brakes:
        return hard_braking(options.speed_mps)
    if options.stop_and_go:
        return queue(options.speed_mps, options.seconds)
    if options.turn is not None:
        return slow_turn(options.speed_mps), None
    return None, None


def hard_braking(speed_mps: float) -> tuple[SpeedProfile, SpeedProfile]:
    """Return motions of ego car and leader: the leader brakes hard, the ego car late, both stop and drive off."""
    gap = max(GAP_S * speed_mps, CAR_M[0] + 2.0)
    off = ramp(speed_mps, DRIVE_OFF_MPS2)
    leader = SpeedProfile(gap, speed_mps, ((BRAKES_AFTER_S, 0.0), ramp(speed_mps, -HARD_MPS2), (STAND_S, 0.0), off))
    ego_stop = ramp(speed_mps, -HARDER_MPS2)
    leader_stops_m = leader.at(BRAKES_AFTER_S + speed_mps / HARD_MPS2)[0]
    room = leader_stops_m - CAR_M[0] - NEAR_MISS_M - speed_mps * ego_stop[0] / 2
    brakes_s = room / speed_mps
    drives_off_s = BRAKES_AFTER_S + speed_mps / HARD_MPS2 + STAND_S + DRIVE_OFF_LATER_S
    stands_s = max(drives_off_s - brakes_s - ego_stop[0], 0.5)
    return SpeedProfile(0.0, speed_mps, ((brakes_s, 0.0), ego_stop, (stands_s, 0.0), off)), leader


def slow_turn(speed_mps: float) -> SpeedProfile:
    """Return a motion that slows down before a turn and speeds up after it."""
    slower = max(speed_mps - TURN_MPS, 0.0) / TURN_BRAKING_MPS2
    round_s = TURN_RADIUS_M * np.pi / 2 / min(speed_mps, TURN_MPS)
    brake, off = (slower, -TURN_BRAKING_MPS2), (slower, TURN_BRAKING_MPS2)
    return SpeedProfile(0.0, speed_mps, ((AFTER_S, 0.0), brake, (round_s, 0.0), off))


def queue(speed_mps: float, seconds: float) -> tuple[SpeedProfile, SpeedProfile]:
    """Return motions of ego car and leader: both drive, brake, stand and drive off repeatedly, the ego car later."""
    brake, off = ramp(speed_mps, -QUEUE_MPS2), ramp(speed_mps, DRIVE_OFF_MPS2)
    wave: tuple[Phase, ...] = ((CRUISE_S, 0.0), brake, (STAND_S, 0.0), off)
    times = int(seconds / sum(phase[0] for phase in wave)) + 2
    gap = CAR_M[0] + QUEUE_GAP_M + speed_mps * REACTION_S
    leader = SpeedProfile(gap, speed_mps, wave * times)
    return SpeedProfile(0.0, speed_mps, ((REACTION_S, 0.0), *wave * times)), leader
