"""The ego car's motion: position along its lane, lane changes, and pitching of the body."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float, rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.model.results import LaneChange

from .lanes import Lane, LaneMap
from .motions import SpeedProfile
from .options import RenderOptions
from .scenes import RenderedScene

CHANGE_AFTER_S: Final = 2.0
CHANGE_S: Final = 3.0
STAY_S: Final = 2.0
"""Time in the other lane before the car goes back."""
ABORTED: Final = 0.42
"""Share of the distance to the other lane's centre in an aborted change: the car touches the line only."""


@dataclass(frozen=True)
class LateralMove:
    """A lateral move by ``aside_m`` (positive left) over ``length_m`` of road; an aborted move returns to its start."""

    from_m: float
    length_m: float
    aside_m: float
    aborted: bool = False

    def at(self, s_m: float) -> tuple[float, float]:
        """Return the lateral offset at s in metres, and its derivative by s."""
        u = min(max((s_m - self.from_m) / self.length_m, 0.0), 1.0)
        if self.aborted:
            # Out in the first half, back in the second.
            share, slope = _eased(2 * u if u < 0.5 else 2 - 2 * u)
            share, slope = ABORTED * share, ABORTED * slope * (2 if u < 0.5 else -2)
        else:
            share, slope = _eased(u)
        return self.aside_m * share, self.aside_m * slope / self.length_m


def _eased(u: float) -> tuple[float, float]:
    """Return a smooth step from 0 to 1 (zero slope and curvature at both ends), and its derivative."""
    return u**3 * (10 - 15 * u + 6 * u * u), 30 * u * u * (1 - u) ** 2


def lane_changes(options: RenderOptions, lanes: LaneMap) -> tuple[LateralMove, ...]:
    """Return the lane changes of the options: the first starts after 2 s and takes 3 s."""
    if options.change_lane is None:
        return ()
    speed = options.speed_mps
    start = CHANGE_AFTER_S * speed
    target = next(lane for lane in lanes.lanes if lane is not lanes.start)
    aside = target.way_m(start) - lanes.start.way_m(start)
    first = LateralMove(start, CHANGE_S * speed, aside, options.change_broken_off)
    back = LateralMove(start + (CHANGE_S + STAY_S) * speed, CHANGE_S * speed, -aside)
    return (first, back) if options.change_back else (first,)


WAVES: Final = 6
FREQUENCY_HZ: Final = (0.4, 2.5)
"""From the slow heave of the body to the fastest pitching of a stiff suspension."""


def pitching(std_deg: float, seed: int) -> Callable[[float], float]:
    """Return the additional pitch by time, radians, nose down: a sum of sine waves of a given standard deviation."""
    rng = np.random.default_rng((seed, 303))
    frequency_hz, phase = rng.uniform(*FREQUENCY_HZ, WAVES), rng.uniform(0, 2 * np.pi, WAVES)
    amplitude = float(np.radians(std_deg)) * float(np.sqrt(2 / WAVES))
    return lambda time_s: amplitude * float(np.sin(2 * np.pi * frequency_hz * time_s + phase).sum())


WEAVE_S: Final = 6.0
MAX_WEAVE_SLOPE: Final = 0.15
"""Largest slope of the car's path relative to its lane; a slow car weaves with a longer period."""
NOD_S: Final = 1.1
NOD_RAD: Final = float(np.radians(0.3))


@dataclass(frozen=True)
class LaneChangeState:
    """Direction of a lane change in progress, and how often the reference point has entered another lane."""

    direction: LaneChange
    count: int


@dataclass(frozen=True)
class Ego:
    """The ego car: it follows the road and weaves about its lane's centre, at constant speed without a ``motion``."""

    scene: RenderedScene
    speed_mps: float
    weave_m: float
    static: bool
    changes: tuple[LateralMove, ...] = ()
    motion: SpeedProfile | None = None
    pitching: Callable[[float], float] | None = None
    """Additional pitch by time, radians."""

    def s(self, time_s: float) -> float:
        """Return s in metres along the road."""
        if self.static:
            return 0.0
        return self.speed_mps * time_s if self.motion is None else self.motion.at(time_s)[0]

    def d(self, time_s: float) -> float:
        """Return d in metres to the left of the road's centre line."""
        return self._aside(time_s)[0]

    def _driven_s(self, time_s: float) -> float:
        """Return the time that s takes at cruising speed, so that a standing car neither weaves nor pitches."""
        return time_s if self.motion is None else self.s(time_s) / self.speed_mps

    def _aside(self, time_s: float) -> tuple[float, float]:
        """Return d in metres, and its rate of change at cruising speed in m/s."""
        s = self.s(time_s)
        middle = self.scene.road.lanes.start.way_m(s)
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
        """Return the lane change in progress: from the car's first contact with the line until it has crossed it."""
        s, d = self.s(time_s), self.d(time_s)
        lanes, count = self.scene.road.lanes, 0
        lane: Lane | None = lanes.start
        for change in self.changes:
            if change.from_m <= s < change.from_m + change.length_m and lane is not None:
                towards: LaneChange = "left" if change.aside_m > 0 else "right"
                now = lanes.at(s, d)
                over = any(lane.beside_m(s, d + side * half_width_m) > 0 for side in (-1, 1))
                arrived = now is not lane and all(now.beside_m(s, d + k * half_width_m) == 0 for k in (-1, 1) if now)
                return LaneChangeState(towards if over and not arrived else "none", count + (now is not lane))
            if s >= change.from_m and not change.aborted:
                count, lane = count + 1, next((other for other in lanes.lanes if other is not lane), None)
        return LaneChangeState("none", count)

    def pose(self, time_s: float) -> Float:
        """Return world_T_ego: on the ground, heading along its motion, with a small pitching."""
        s, (d, sideways) = self.s(time_s), self._aside(time_s)
        if self.static:
            return self.scene.ground_pose(0.0, d)
        onwards = self.speed_mps * (1 - self.scene.path.curvature(s) * d)
        turn = float(np.arctan2(sideways, onwards))
        nod = NOD_RAD * np.sin(2 * np.pi * self._driven_s(time_s) / NOD_S)
        if self.pitching is not None:
            nod += self.pitching(self._driven_s(time_s))
        return self.scene.ground_pose(s, d, turn) @ rigid(rotation_from_rpy(0.0, nod, 0.0), np.zeros(3))
