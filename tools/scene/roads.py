"""The roads of the scenes: cross-section, lanes of the ego direction, changes along the road, and crossings.

A crossing is a road at right angles to the ego car's, on level ground, without markings where they meet.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from .lanes import (
    LINE_M,
    WHITE,
    YELLOW,
    Along,
    Dashes,
    Edge,
    Lane,
    LaneMap,
    Marking,
    Markings,
    RoadSection,
    constant,
    street,
)
from .options import LaneEvent, RenderOptions
from .path import Element, Path, Real, chain

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
    """A crossing at (x, 0), x along the ego car's road, and the ego car's path through it.

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
        """Offset from the distance behind the middle to s, after the crossing."""
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
        # The second road runs in the direction in which the car leaves; for straight on, to the left.
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


LANE_M: Final = 3.6
"""Width of an added lane between its lines."""
LANE_AFTER_S: Final = 4.0
"""When the ego car is where a lane begins, ends, is split or merges."""
TAPER_M: Final = 30.0
_YELLOW_M: Final = 0.15
"""How far the middles of the double yellow line are from the road's."""


@dataclass(frozen=True)
class Road:
    """A road; ``wider_m`` is by how much its right half is wider than the cross-section says."""

    section: RoadSection
    lanes: LaneMap
    wider_m: Along
    markings: Markings | None = None
    """Lines that are not in the cross-section."""
    crossing: Crossing | None = None

    def section_d(self, s_m: Real, d_m: Real) -> Real:
        """The place in the cross-section of (s, d): the right half's outer part is moved outwards."""
        if not any(self.wider_m.value):
            return d_m
        inner = -self.section.lane_m
        moved = np.minimum(d_m + self.wider_m.at(s_m), inner + LINE_M)
        return np.where(d_m >= inner + LINE_M, d_m, moved).astype(d_m.dtype)

    def aside(self, side: int, s_m: float, d_m: float) -> float:
        """D of what stands ``d_m`` from the middle of a plain road, to the left (1) or the right (-1)."""
        return side * d_m - (float(self.wider_m.at(s_m)) if side < 0 else 0.0)


def plain_road(section: RoadSection) -> Road:
    """A road that is the same all along, with its lines in the cross-section."""
    left = Edge(constant(section.left_edge_m), section.outside_left)
    right = Edge(constant(section.right_edge_m), section.outside_right)
    lane = Lane(left, right)
    return Road(section, LaneMap((lane,), lane), constant(0.0))


def road_of(options: RenderOptions) -> Road:
    """The road that the options ask for."""
    parking, broken = options.scene != "hill" or options.parked_rows, options.scene in ("bend", "town")
    bare = street(parking=parking, broken=False, lines=False)
    missing, worn = (() if s is None else (s,) for s in (options.missing_lines, options.worn_lines))
    if options.change_lane is not None:
        road = _two_lanes(bare, options.change_lane)
    elif options.lane is not None:
        road = _changing(bare, options.lane, LANE_AFTER_S * options.speed_mps)
    elif crossing := crossing_of(options, bare):
        lines = _outer_lines(bare, constant(bare.right_edge_m))
        missing = (crossing.unmarked_m, *missing)
        lanes = _lanes_to_and_from(bare, crossing)
        road = Road(bare, lanes, constant(0.0), Markings(tuple(lines)), crossing)
    elif missing or worn:
        lines = _outer_lines(bare, constant(bare.right_edge_m), "stretches" if broken else "none")
        road = replace(plain_road(bare), markings=Markings(tuple(lines)))
    else:
        return plain_road(street(parking=parking, broken=broken))
    assert road.markings is not None
    return replace(road, markings=replace(road.markings, missing=missing, worn=worn))


def _two_lanes(section: RoadSection, change_to: str) -> Road:
    """Two lanes of the own direction with a dashed line between them."""
    inner, outer = -section.lane_m, -section.lane_m - LINE_M - LANE_M
    left = Lane(Edge(constant(section.left_edge_m), "road"), Edge(constant(inner), "road"))
    right = Lane(Edge(constant(inner - LINE_M), "road"), Edge(constant(outer), section.outside_right))
    lanes = LaneMap((left, right), right if change_to == "left" else left)
    lines = [*_outer_lines(section, constant(outer)), Marking(constant(inner - LINE_M / 2), WHITE, "all")]
    return Road(section, lanes, constant(LINE_M + LANE_M), Markings(tuple(lines)))


def _lanes_to_and_from(section: RoadSection, crossing: Crossing) -> LaneMap:
    """The lane up to a crossing, and the one beyond it."""
    end, start = crossing.unmarked_m
    lanes = []
    for from_m, to_m in ((-np.inf, end), (start, np.inf)):
        left = Edge(constant(section.left_edge_m), section.outside_left, from_m, to_m)
        right = Edge(constant(section.right_edge_m), section.outside_right, from_m, to_m)
        lanes.append(Lane(left, right, from_m, to_m))
    return LaneMap(tuple(lanes), lanes[0])


def _changing(section: RoadSection, what: LaneEvent, from_m: float) -> Road:
    """A second lane on the right that begins or ends beside the ego car's, or is split from it or merges with it.

    Where it begins or ends the dashed line between the two accompanies the taper, and the ego car's lane stays as it
    is. Where a lane is split it first grows as wide as two, and the line begins behind the taper; a merger is the same
    the other way round.
    """
    to_m = from_m + TAPER_M
    more = LINE_M + LANE_M
    wider = Along((from_m, to_m), (0.0, more) if what in ("begins", "splits") else (more, 0.0))
    left, inner = Edge(constant(section.left_edge_m), "road"), -section.lane_m
    outer = Edge(Along(wider.s_m, tuple(inner - w for w in wider.value)), section.outside_right)
    ends = {"begins": (from_m, np.inf), "ends": (-np.inf, to_m), "splits": (to_m, np.inf), "merges": (-np.inf, from_m)}
    two = ends[what]
    alone = (-np.inf, two[0]) if np.isfinite(two[0]) else (two[1], np.inf)
    straight_on = what in ("begins", "ends")
    right = Edge(constant(inner), section.outside_right) if straight_on else outer
    divided = Edge(constant(inner), "road") if straight_on else Edge(constant(inner), "road", *two)
    lanes = (
        Lane(left, right, *alone, driven_m=section.lane_centre_m),
        Lane(left, divided, *two),
        Lane(Edge(constant(inner - LINE_M), "road", *two), outer, *two),
    )
    divider = Marking(constant(inner - LINE_M / 2), WHITE, "all", *two)
    lines = [*_outer_lines(section, outer.d_m), divider]
    return Road(section, LaneMap(lanes, lanes[0]), wider, Markings(tuple(lines)))


def _outer_lines(section: RoadSection, right_m: Along, right: Dashes = "none") -> list[Marking]:
    """The double yellow line and, where cars park, the white ones at the edges; ``right_m`` is the right edge."""
    lines = [Marking(constant(d), YELLOW) for d in (_YELLOW_M, -_YELLOW_M)]
    if section.outside_right == "road":
        lines.append(Marking(constant(section.lane_m + LINE_M / 2), WHITE))
        lines.append(Marking(Along(right_m.s_m, tuple(d - LINE_M / 2 for d in right_m.value)), WHITE, right))
    return lines
