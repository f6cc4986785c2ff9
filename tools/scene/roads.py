"""The roads of the scenes: cross-section, lanes in the ego car's direction, added lanes, and crossings.

A crossing is a second road at a right angle, on level ground. There are no markings where the roads meet.
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
"""Radius of the ego car's path in a turn."""
TURN_MPS: Final = 5.0
TURN_BRAKING_MPS2: Final = 2.0
AFTER_S: Final = 2.0
"""Time at which the ego car starts to brake for its turn."""
STRAIGHT_AFTER_S: Final = 4.0
"""Time at which an ego car that does not turn is at the centre of the crossing."""
WIDE_CORNER_M: Final = 10.0
CORNER_M: Final = 6.0
"""Radius of the curbs at the corners; ``WIDE_CORNER_M`` on roads without parking strips, so that a car can turn."""


@dataclass(frozen=True)
class Crossing:
    """A crossing at (x, 0), with x along the ego car's road, and the ego car's path through it.

    ``turn`` is 1 for left, -1 for right, 0 for straight on. ``radius_m`` is the radius of the road's centre line.
    """

    x_m: float
    turn: int
    radius_m: float
    curb_m: float
    corner_m: float

    @property
    def begins_m(self) -> float:
        """Return s at the start of the turn."""
        return self.x_m - self.radius_m

    @property
    def beyond_m(self) -> float:
        """Return the offset to add to the distance behind the centre to get s, after the crossing."""
        return self.x_m + (np.pi / 2 - 2) * self.radius_m if self.turn else self.x_m

    @property
    def unmarked_m(self) -> tuple[float, float]:
        """Return the stretch of s without markings, from and to."""
        reach = self.curb_m + self.corner_m
        turn_ends = self.begins_m + self.radius_m * np.pi / 2 if self.turn else self.x_m
        start = min(self.x_m - reach, self.begins_m) if self.turn else self.x_m - reach
        return start, max(self.beyond_m + reach, turn_ends)

    @property
    def path(self) -> Path:
        """Return the ego car's path."""
        start = Element(0.0, 0.0, 0.0, 0.0, 0.0)
        if not self.turn:
            return Path((start,))
        return chain(start, ((self.begins_m, 0.0), (self.radius_m * np.pi / 2, self.turn / self.radius_m), (1.0, 0.0)))

    def around(self, s_m: float) -> "LocalCrossing":
        """Return the roads in coordinates relative to s on the ego car's path."""
        x, y, _ = self.path.pose(np.array([s_m]))
        return LocalCrossing(self, (float(x[0]), float(y[0])), s_m)

    def arm_distances(self, x_m: Real, y_m: Real) -> tuple[Real, Real]:
        """Return the signed distances of a world point from the centre lines of the first and the second road."""
        # The second road points in the direction of the turn, or to the left if the car does not turn.
        sign = -1.0 if self.turn < 0 else 1.0
        return y_m, sign * (self.x_m - x_m)


@dataclass(frozen=True)
class LocalCrossing:
    """Coordinates along and across the nearer road, like those of ``LocalPath``."""

    crossing: Crossing
    origin_m: tuple[float, float]
    s_origin_m: float

    def coordinates(self, x_m: Real, y_m: Real) -> tuple[Real, Real]:
        """Return local s, and d, of local points of any shape. At the corners d follows the arcs of the curbs."""
        crossing = self.crossing
        x, y = x_m + self.origin_m[0], y_m + self.origin_m[1]
        first, second = crossing.arm_distances(x, y)
        ahead, left = x - crossing.x_m, -y if crossing.turn < 0 else y
        on_first = np.abs(first) <= np.abs(second)
        s, d = np.where(on_first, ahead, left), np.where(on_first, first, second)
        s = s + np.where(s > 0, crossing.beyond_m, crossing.x_m) - self.s_origin_m
        d = np.copysign(_rounded(crossing, np.abs(first), np.abs(second)), d)
        return s.astype(x_m.dtype), d.astype(x_m.dtype)


def _rounded(crossing: Crossing, first_m: Real, second_m: Real) -> Real:
    """Return the distance from the centre of the nearer road; in the corners it follows the round curb."""
    reach = crossing.curb_m + crossing.corner_m
    in_corner = (np.maximum(first_m, second_m) < reach) & (np.minimum(first_m, second_m) > crossing.curb_m)
    arc = reach - np.hypot(reach - first_m, reach - second_m)
    return np.where(in_corner, arc, np.minimum(first_m, second_m))


def crossing_of(options: RenderOptions, section: RoadSection) -> Crossing | None:
    """Return the crossing of the options, or None."""
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
"""Width of an additional lane between its lines."""
LANE_AFTER_S: Final = 4.0
"""Time at which the ego car reaches the start, end, split or merge of a lane."""
TAPER_M: Final = 30.0
_YELLOW_M: Final = 0.15
"""Distance of each yellow line's centre from the road's centre."""


@dataclass(frozen=True)
class Road:
    """A road; its right half is ``wider_m`` wider than in the cross-section."""

    section: RoadSection
    lanes: LaneMap
    wider_m: Along
    markings: Markings | None = None
    """Lines outside the cross-section."""
    crossing: Crossing | None = None

    def section_d(self, s_m: Real, d_m: Real) -> Real:
        """Return d in the cross-section for (s, d): the outer part of the right half moves outwards."""
        if not any(self.wider_m.value):
            return d_m
        inner = -self.section.lane_m
        moved = np.minimum(d_m + self.wider_m.at(s_m), inner + LINE_M)
        return np.where(d_m >= inner + LINE_M, d_m, moved).astype(d_m.dtype)

    def aside(self, side: int, s_m: float, d_m: float) -> float:
        """Return d of a body that is ``d_m`` from the centre of a plain road, left (1) or right (-1)."""
        return side * d_m - (float(self.wider_m.at(s_m)) if side < 0 else 0.0)


def plain_road(section: RoadSection) -> Road:
    """Return a uniform road with its lines in the cross-section."""
    right = Edge(constant(section.right_edge_m), section.outside_right)
    lane = Lane(Edge(constant(section.left_edge_m), "road"), right)
    return Road(section, LaneMap((lane,), lane), constant(0.0))


def road_of(options: RenderOptions) -> Road:
    """Return the road of the options."""
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
        road = Road(bare, _lanes_to_and_from(bare, crossing), constant(0.0), Markings(tuple(lines)), crossing)
    elif missing or worn:
        lines = _outer_lines(bare, constant(bare.right_edge_m), "stretches" if broken else "none")
        road = replace(plain_road(bare), markings=Markings(tuple(lines)))
    else:
        return plain_road(street(parking=parking, broken=broken))
    assert road.markings is not None
    return replace(road, markings=replace(road.markings, missing=missing, worn=worn))


def _two_lanes(section: RoadSection, change_to: str) -> Road:
    """Return a road with two lanes in the ego car's direction and a dashed line between them."""
    inner, outer = -section.lane_m, -section.lane_m - LINE_M - LANE_M
    left = Lane(Edge(constant(section.left_edge_m), "road"), Edge(constant(inner), "road"))
    right = Lane(Edge(constant(inner - LINE_M), "road"), Edge(constant(outer), section.outside_right))
    lanes = LaneMap((left, right), right if change_to == "left" else left)
    lines = [*_outer_lines(section, constant(outer)), Marking(constant(inner - LINE_M / 2), WHITE, "all")]
    return Road(section, lanes, constant(LINE_M + LANE_M), Markings(tuple(lines)))


def _lanes_to_and_from(section: RoadSection, crossing: Crossing) -> LaneMap:
    """Return the lane before a crossing and the lane after it."""
    end, start = crossing.unmarked_m
    lanes = []
    for from_m, to_m in ((-np.inf, end), (start, np.inf)):
        left = Edge(constant(section.left_edge_m), "road", from_m, to_m)
        right = Edge(constant(section.right_edge_m), section.outside_right, from_m, to_m)
        lanes.append(Lane(left, right, from_m, to_m))
    return LaneMap(tuple(lanes), lanes[0])


def _changing(section: RoadSection, what: LaneEvent, from_m: float) -> Road:
    """Return a road with a second lane on the right that begins, ends, splits from the ego lane or merges with it.

    For a beginning or ending lane, the dashed line runs along the taper and the ego lane keeps its width. A lane that
    splits first grows to the width of two, and the line begins after the taper. A merge is the reverse.
    """
    to_m, more = from_m + TAPER_M, LINE_M + LANE_M
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
    lines = [*_outer_lines(section, outer.d_m), Marking(constant(inner - LINE_M / 2), WHITE, "all", *two)]
    return Road(section, LaneMap(lanes, lanes[0]), wider, Markings(tuple(lines)))


def _outer_lines(section: RoadSection, right_m: Along, right: Dashes = "none") -> list[Marking]:
    """Return the double yellow line, and white edge lines where cars park; ``right_m`` is d of the right edge."""
    lines = [Marking(constant(d), YELLOW) for d in (_YELLOW_M, -_YELLOW_M)]
    if section.outside_right == "road":
        lines.append(Marking(constant(section.lane_m + LINE_M / 2), WHITE))
        lines.append(Marking(Along(right_m.s_m, tuple(d - LINE_M / 2 for d in right_m.value)), WHITE, right))
    return lines
