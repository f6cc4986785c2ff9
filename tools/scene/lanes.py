"""Cross-section of the road with exact borders, lanes with their edges, and painted lines.

In the plain scenes the lines are part of the cross-section. Other scenarios paint lines over a cross-section without
lines. Their position changes along the road, and they can be dashed, worn or missing.
"""

from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float, Float32
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14

from .options import Stretch
from .path import Real

Colour = tuple[float, float, float]
"""Blue, green, red, 0 to 255."""

ASPHALT: Final[Colour] = (157.0, 155.0, 154.0)
PARKING: Final[Colour] = (149.0, 148.0, 147.0)
PAVING: Final[Colour] = (112.0, 113.0, 114.0)
GRASS: Final[Colour] = (58.0, 92.0, 74.0)
YELLOW: Final[Colour] = (62.0, 184.0, 218.0)
WHITE: Final[Colour] = (218.0, 220.0, 221.0)

BIN_M: Final = 0.005
"""Borders are multiples of this length, so that a table over d has no rounding at a border."""
REACH_M: Final = 32.0
CURB_HEIGHT_M: Final = 0.15
GAP_BIN_M: Final = 0.02
DASH_M: Final = 3.0
DASH_PERIOD_M: Final = 7.5
STRETCH_M: Final = 160.0
DASHED_FROM_M: Final = 25.0
DASHED_TO_M: Final = 85.0
"""The line is dashed from ``DASHED_FROM_M`` to here in every ``STRETCH_M`` of the road."""


@dataclass(frozen=True)
class Zone:
    """The range low_m <= d < high_m of one class; ``contrast`` is the relative amplitude of its grain."""

    low_m: float
    high_m: float
    tag_name: str
    colour: Colour
    contrast: float


@dataclass(frozen=True)
class RoadSection:
    """Zones (later ones cover earlier ones), curbs at d = +-curb_m, and the borders of the ego lane."""

    zones: tuple[Zone, ...]
    curb_m: float
    walk_m: float
    """Outer edge of the sidewalks."""
    left_edge_m: float
    right_edge_m: float
    outside_right: str
    """Class beyond the right marking; beyond the left one it is ``road``."""
    broken: bool
    """True if the right line of the ego lane is dashed in parts."""
    lane_m: float
    """Half the width of the carriageway without parking strips."""

    @property
    def lane_centre_m(self) -> float:
        """Return d of the centre of the ego lane."""
        return (self.left_edge_m + self.right_edge_m) / 2

    @cached_property
    def tag_table(self) -> NDArray[np.uint8]:
        """Return the tag by d; bin i starts at -REACH_M + i BIN_M."""
        table = np.zeros(round(2 * REACH_M / BIN_M), np.uint8)
        for zone in self.zones:
            table[_bin(zone.low_m) : _bin(zone.high_m)] = CARLA_FROM_0_9_14.names.index(zone.tag_name)
        return table

    def on_right_line(self, d_bins: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return True for the bins of d on the right line of the ego lane."""
        return (d_bins >= _bin(self.right_edge_m - LINE_M)) & (d_bins < _bin(self.right_edge_m))


def line_gap(s_m: Float32, s_origin_m: float) -> NDArray[np.bool_]:
    """Return True in the gaps of a line that is dashed in parts; s is relative to ``s_origin_m``."""
    period = round(STRETCH_M / GAP_BIN_M)
    index = ((s_m + np.float32(s_origin_m % STRETCH_M + STRETCH_M)) * np.float32(1 / GAP_BIN_M)).astype(np.int32)
    return _gap_table()[index % period]


@cache
def _gap_table() -> NDArray[np.bool_]:
    """Return True in the gaps of a broken line, over one ``STRETCH_M``."""
    s = np.arange(round(STRETCH_M / GAP_BIN_M)) * GAP_BIN_M
    broken = (s >= DASHED_FROM_M) & (s < DASHED_TO_M)
    return broken & ((s - DASHED_FROM_M) % DASH_PERIOD_M >= DASH_M)


LINE_M: Final = 0.15


def bins(d_m: Float32) -> NDArray[np.int32]:
    """Return the table bin of each d, clipped to the table."""
    index = (d_m + np.float32(REACH_M)) * np.float32(1 / BIN_M)
    np.clip(index, 0, round(2 * REACH_M / BIN_M) - 1, out=index)
    return index.astype(np.int32)


def street(*, parking: bool, broken: bool, lines: bool = True) -> RoadSection:
    """Return two lanes of 3.6 m with a double yellow line; with ``parking`` also white edge lines and parking strips.

    Without ``lines`` the asphalt is bare, and ``Markings`` holds the lines.
    """
    lane, curb = 3.6, 6.0 if parking else 3.6
    zones = [
        Zone(-REACH_M, REACH_M, "terrain", GRASS, 0.6),
        Zone(-curb - 3.5, curb + 3.5, "sidewalk", PAVING, 0.45),
        Zone(-curb, curb, "road", PARKING, 0.2),
        Zone(-lane, lane, "road", ASPHALT, 0.2),
    ]
    if lines:
        zones.append(Zone(-0.225, -0.075, "road_line", YELLOW, 0.3))
        zones.append(Zone(0.075, 0.225, "road_line", YELLOW, 0.3))
    if lines and parking:
        zones.append(Zone(-lane - LINE_M, -lane, "road_line", WHITE, 0.3))
        zones.append(Zone(lane, lane + LINE_M, "road_line", WHITE, 0.3))
    outside = "road" if parking else "sidewalk"
    return RoadSection(tuple(zones), curb, curb + 3.5, -0.225, -lane, outside, broken and parking, lane)


def _bin(d_m: float) -> int:
    return round((d_m + REACH_M) / BIN_M)


@dataclass(frozen=True)
class Along:
    """A quantity over s: linear between knots, constant beyond the outer knots."""

    s_m: tuple[float, ...]
    value: tuple[float, ...]

    def at(self, s_m: Real | float) -> Float:
        """Return the quantity at s of any shape."""
        return np.asarray(np.interp(s_m, self.s_m, self.value))


def constant(value: float) -> Along:
    """Return a quantity that is the same everywhere."""
    return Along((0.0,), (value,))


@dataclass(frozen=True)
class Edge:
    """The border of a lane: d over s between two positions, and the class beyond its marking."""

    d_m: Along
    outside: str
    from_m: float = -np.inf
    to_m: float = np.inf


@dataclass(frozen=True)
class Lane:
    """A lane between two positions along the road; cars drive at d = ``driven_m``, by default its centre."""

    left: Edge
    right: Edge
    from_m: float = -np.inf
    to_m: float = np.inf
    driven_m: float | None = None

    def way_m(self, s_m: float) -> float:
        """Return d of the line that cars follow in the lane."""
        if self.driven_m is not None:
            return self.driven_m
        return float(self.left.d_m.at(s_m) + self.right.d_m.at(s_m)) / 2

    def beside_m(self, s_m: float, d_m: float) -> float:
        """Return the distance of a point outside the lane, 0 inside."""
        return max(d_m - float(self.left.d_m.at(s_m)), float(self.right.d_m.at(s_m)) - d_m, 0.0)


@dataclass(frozen=True)
class LaneMap:
    """All lanes in the ego car's direction; two lanes meet at the centre of the line between them."""

    lanes: tuple[Lane, ...]
    start: Lane = field(repr=False)
    """The ego car's first lane."""

    def at(self, s_m: float, d_m: float) -> Lane | None:
        """Return the lane at a point; None where the road has no lane."""
        there = [lane for lane in self.lanes if lane.from_m <= s_m < lane.to_m]
        return min(there, key=lambda lane: lane.beside_m(s_m, d_m)) if there else None


Dashes = Literal["none", "all", "stretches"]


@dataclass(frozen=True)
class Marking:
    """A line of width ``LINE_M`` between two positions along the road; its centre can change with s.

    ``dashes``: solid, dashed everywhere, or dashed in a part of each ``STRETCH_M`` as in the plain scenes.
    """

    middle_m: Along
    colour: Colour
    dashes: Dashes = "none"
    from_m: float = -np.inf
    to_m: float = np.inf


@dataclass(frozen=True)
class Markings:
    """All lines of a road, and the stretches where they are missing or worn."""

    lines: tuple[Marking, ...]
    missing: tuple[Stretch, ...] = ()
    worn: tuple[Stretch, ...] = ()
