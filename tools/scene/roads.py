"""The roads of the scenes: a cross-section, the lanes of the own direction, and what changes along the way."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from .along import Along, constant
from .crossing import Crossing, crossing_of
from .lanes import Edge, Lane, LaneMap, side_by_side, single
from .markings import Dashes, Marking, Markings
from .options import LaneEvent, RenderOptions
from .path import Real
from .section import LINE_M, WHITE, YELLOW, RoadSection, street

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
        if not self.wider_m.value[0] and self.wider_m.constant:
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
    return Road(section, single(Lane(left, right)), constant(0.0))


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
    lanes = side_by_side(
        (
            (Edge(constant(section.left_edge_m), "road"), Edge(constant(inner), "road")),
            (Edge(constant(inner - LINE_M), "road"), Edge(constant(outer), section.outside_right)),
        ),
        start=1 if change_to == "left" else 0,
    )
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
