"""A crossing: a road at right angles to the ego car's, on level ground, without markings where they meet."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from .options import RenderOptions
from .path import Element, Path, Real, chain
from .section import RoadSection

TURN_RADIUS_M: Final = 12.0
"""Of the ego car's way round the corner."""
TURN_MPS: Final = 5.0
TURN_BRAKING_MPS2: Final = 2.0
AFTER_S: Final = 2.0
"""When the ego car begins to slow down for its turn."""
STRAIGHT_AFTER_S: Final = 4.0
"""When an ego car that goes straight on is in the middle of the crossing."""
WIDE_CORNER_M: Final = 10.0
CORNER_M: Final = 6.0
"""Radius of the curbs at the corners: the wide one where no parking strip leaves room to turn."""


@dataclass(frozen=True)
class Crossing:
    """Where the roads' middle lines meet, x along the ego car's road and y = 0, and the way through.

    ``turn`` is 1 for a turn to the left, -1 to the right, 0 for straight on; ``radius_m`` the road's middle line's.
    """

    x_m: float
    turn: int
    radius_m: float
    curb_m: float
    corner_m: float

    @property
    def begins_m(self) -> float:
        """S where the turn begins."""
        return self.x_m - self.radius_m

    @property
    def beyond_m(self) -> float:
        """What s is less than the distance behind the middle, on the way out."""
        return self.x_m + (np.pi / 2 - 2) * self.radius_m if self.turn else self.x_m

    @property
    def unmarked_m(self) -> tuple[float, float]:
        """From and to along the road: without markings."""
        reach = self.curb_m + self.corner_m
        turn_ends = self.begins_m + self.radius_m * np.pi / 2 if self.turn else self.x_m
        start = min(self.x_m - reach, self.begins_m) if self.turn else self.x_m - reach
        return start, max(self.beyond_m + reach, turn_ends)

    @property
    def path(self) -> Path:
        """The ego car's way."""
        start = Element(0.0, 0.0, 0.0, 0.0, 0.0)
        if not self.turn:
            return Path((start,))
        return chain(start, ((self.begins_m, 0.0), (self.radius_m * np.pi / 2, self.turn / self.radius_m), (1.0, 0.0)))

    def around(self, s_m: float) -> "LocalCrossing":
        """The roads, counted from the place at s of the ego car's way."""
        x, y, _ = self.path.pose(np.array([s_m]))
        return LocalCrossing(self, (float(x[0]), float(y[0])), s_m)

    def arm_distances(self, x_m: Real, y_m: Real) -> tuple[Real, Real]:
        """How far a place in the world is from the middle of the first and of the other road, with signs."""
        # The second road runs the way the car leaves; straight on, it runs to the left.
        sign = -1.0 if self.turn < 0 else 1.0
        return y_m, sign * (self.x_m - x_m)


@dataclass(frozen=True)
class LocalCrossing:
    """Coordinates along and across the nearer road; as ``LocalPath`` has them."""

    crossing: Crossing
    origin_m: tuple[float, float]
    s_origin_m: float

    def coordinates(self, x_m: Real, y_m: Real) -> tuple[Real, Real]:
        """S and d (s local) of local points of any shape. Where the curbs are round, d is counted from their arcs."""
        crossing = self.crossing
        x, y = x_m + self.origin_m[0], y_m + self.origin_m[1]
        first, second = crossing.arm_distances(x, y)
        ahead, left = x - crossing.x_m, -y if crossing.turn < 0 else y
        s = np.where(np.abs(first) <= np.abs(second), ahead, left)
        s = s + np.where(s > 0, crossing.beyond_m, crossing.x_m) - self.s_origin_m
        d = np.where(np.abs(first) <= np.abs(second), first, second)
        d = np.copysign(_rounded(crossing, np.abs(first), np.abs(second)), d)
        return s.astype(x_m.dtype), d.astype(x_m.dtype)


def _rounded(crossing: Crossing, first_m: Real, second_m: Real) -> Real:
    """Distance from the nearer road's middle, in the corners as from a curb of a radius."""
    reach = crossing.curb_m + crossing.corner_m
    in_corner = (np.maximum(first_m, second_m) < reach) & (np.minimum(first_m, second_m) > crossing.curb_m)
    arc = reach - np.hypot(reach - first_m, reach - second_m)
    return np.where(in_corner, arc, np.minimum(first_m, second_m))


def crossing_of(options: RenderOptions, section: RoadSection) -> Crossing | None:
    """The crossing that the options ask for."""
    if options.turn is None and not options.crossing_cars:
        return None
    curb, speed = section.curb_m, options.speed_mps
    corner = WIDE_CORNER_M if section.outside_right == "sidewalk" else CORNER_M
    if options.turn is None:
        return Crossing(STRAIGHT_AFTER_S * speed, 0, 0.0, curb, corner)
    turn = 1 if options.turn == "left" else -1
    radius = TURN_RADIUS_M + turn * section.lane_centre_m
    slowing_m = max(speed**2 - TURN_MPS**2, 0.0) / (2 * TURN_BRAKING_MPS2)
    return Crossing(AFTER_S * speed + slowing_m + radius, turn, radius, curb, corner)
