"""Changes of lane: how far the car is to the side, metre by metre along the road."""

from dataclasses import dataclass
from typing import Final

from roadperc_stream.core.datatypes.results import LaneChange

from .lanes import LaneMap
from .options import RenderOptions

CHANGE_AFTER_S: Final = 2.0
CHANGE_S: Final = 3.0
STAY_S: Final = 2.0
"""How long the car stays in the other lane before it goes back."""
BROKEN_OFF: Final = 0.42
"""How much of the way to the other lane's middle a change that is broken off goes: onto the line, not over it."""


@dataclass(frozen=True)
class Manoeuvre:
    """A move of ``aside_m`` (to the left) over ``length_m`` of road; one that is broken off ends where it began."""

    from_m: float
    length_m: float
    aside_m: float
    broken_off: bool = False

    def at(self, s_m: float) -> tuple[float, float]:
        """How far aside the car is at s, and how far it moves aside per metre."""
        u = min(max((s_m - self.from_m) / self.length_m, 0.0), 1.0)
        if self.broken_off:
            # There in the first half of the way and back in the second.
            share, slope = _eased(2 * u if u < 0.5 else 2 - 2 * u)
            share, slope = BROKEN_OFF * share, BROKEN_OFF * slope * (2 if u < 0.5 else -2)
        else:
            share, slope = _eased(u)
        return self.aside_m * share, self.aside_m * slope / self.length_m

    def is_under_way(self, s_m: float) -> bool:
        """Whether it has begun and not yet ended."""
        return self.from_m <= s_m < self.from_m + self.length_m

    @property
    def towards(self) -> LaneChange:
        """The side to which it goes."""
        return "left" if self.aside_m > 0 else "right"


def _eased(u: float) -> tuple[float, float]:
    """From 0 to 1 without a jerk at either end, and its derivative."""
    return u**3 * (10 - 15 * u + 6 * u * u), 30 * u * u * (1 - u) ** 2


def lane_changes(options: RenderOptions, lanes: LaneMap) -> tuple[Manoeuvre, ...]:
    """The changes that the options ask for, along the road: after two seconds, over three."""
    if options.change_lane is None:
        return ()
    speed = options.speed_mps
    start = CHANGE_AFTER_S * speed
    target = next(lane for lane in lanes.lanes if lane is not lanes.start)
    aside = target.way_m(start) - lanes.start.way_m(start)
    first = Manoeuvre(start, CHANGE_S * speed, aside, options.change_broken_off)
    back = Manoeuvre(start + (CHANGE_S + STAY_S) * speed, CHANGE_S * speed, -aside)
    return (first, back) if options.change_back else (first,)
