"""The ego car's motion along its lane."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from roadperc_stream.core.datatypes.results import LaneChange
from roadperc_stream.core.geometry import Float, rigid
from roadperc_stream.core.rotations import rotation_from_rpy

from .lanes import Lane
from .manoeuvre import Manoeuvre
from .motion import SpeedProfile
from .shake import Shake
from .world import World

WEAVE_S: Final = 6.0
MAX_WEAVE_SLOPE: Final = 0.15
"""How far the car turns out of its lane's direction at most: a slow car weaves more slowly."""
NOD_S: Final = 1.1
NOD_RAD: Final = float(np.radians(0.3))


@dataclass(frozen=True)
class LaneChangeState:
    """Whether the car is changing its lane, and how often its reference point has come into another one."""

    direction: LaneChange
    count: int


@dataclass(frozen=True)
class Ego:
    """The ego car's motion: along the road's centre line, weaving about its lane's middle.

    Without a ``motion`` its speed is constant.
    """

    world: World
    speed_mps: float
    weave_m: float
    static: bool
    changes: tuple[Manoeuvre, ...] = ()
    motion: SpeedProfile | None = None
    shake: Shake | None = None

    def s(self, time_s: float) -> float:
        """Metres along the road."""
        if self.static:
            return 0.0
        return self.speed_mps * time_s if self.motion is None else self.motion.at(time_s)[0]

    def d(self, time_s: float) -> float:
        """Metres to the left of the road's middle."""
        return self._aside(time_s)[0]

    def _driven_s(self, time_s: float) -> float:
        """Seconds on the way, at the cruising speed: a car that stands neither weaves nor nods."""
        return time_s if self.motion is None else self.s(time_s) / self.speed_mps

    def _aside(self, time_s: float) -> tuple[float, float]:
        """D, and how fast it grows where the car goes at its cruising speed, m/s."""
        s = self.s(time_s)
        middle = self.world.road.lanes.start.way_m(s)
        if self.static:
            return middle, 0.0
        period_s = max(WEAVE_S, 2 * np.pi * self.weave_m / (MAX_WEAVE_SLOPE * self.speed_mps))
        phase = 2 * np.pi * self._driven_s(time_s) / period_s
        d, sideways = middle + self.weave_m * np.sin(phase), self.weave_m * 2 * np.pi / period_s * np.cos(phase)
        for change in self.changes:
            aside, slope = change.at(s)
            d, sideways = d + aside, sideways + slope * self.speed_mps
        return float(d), float(sideways)

    def lane_change(self, time_s: float, half_width_m: float) -> LaneChangeState:
        """The change that the car, so wide to either side, is in: part of it is over the line, or has been."""
        s, d = self.s(time_s), self.d(time_s)
        lanes, count = self.world.road.lanes, 0
        lane: Lane | None = lanes.start
        for change in self.changes:
            if change.is_under_way(s) and lane is not None:
                now = lanes.at(s, d)
                over = any(lane.beside_m(s, d + side * half_width_m) > 0 for side in (-1, 1))
                arrived = now is not lane and all(now.beside_m(s, d + k * half_width_m) == 0 for k in (-1, 1) if now)
                return LaneChangeState(change.towards if over and not arrived else "none", count + (now is not lane))
            if s >= change.from_m and not change.broken_off:
                count, lane = count + 1, next((other for other in lanes.lanes if other is not lane), None)
        return LaneChangeState("none", count)

    def pose(self, time_s: float) -> Float:
        """world_T_ego: on its wheels, headed where it goes, nodding a little."""
        s, (d, sideways) = self.s(time_s), self._aside(time_s)
        if self.static:
            return self.world.ground_pose(0.0, d)
        onwards = self.speed_mps * (1 - self.world.path.curvature(s) * d)
        turn = float(np.arctan2(sideways, onwards))
        nod = NOD_RAD * np.sin(2 * np.pi * self._driven_s(time_s) / NOD_S)
        if self.shake is not None:
            nod += self.shake.at(self._driven_s(time_s))
        return self.world.ground_pose(s, d, turn) @ rigid(rotation_from_rpy(0.0, nod, 0.0), np.zeros(3))
