"""The lanes of the ego car's own direction, their edges, and painted lines whose place changes along the road.

Lines are dashed, worn or missing for stretches. The plain scenes have their lines in the cross-section; these are
painted over a cross-section without lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from roadperc_stream.geometry import Float

from .options import Stretch
from .path import Real
from .section import Colour


@dataclass(frozen=True)
class Along:
    """A quantity over s: straight between knots, constant beyond the outer ones."""

    s_m: tuple[float, ...]
    value: tuple[float, ...]

    @property
    def constant(self) -> bool:
        """Whether it is the same everywhere."""
        return len(set(self.value)) == 1

    def at(self, s_m: Real | float) -> Float:
        """The quantity at s of any shape."""
        return np.asarray(np.interp(s_m, self.s_m, self.value))


def constant(value: float) -> Along:
    """The same everywhere."""
    return Along((0.0,), (value,))


@dataclass(frozen=True)
class Edge:
    """The border of a lane: d over s between two places, and the class that lies beyond its marking."""

    d_m: Along
    outside: str
    from_m: float = -np.inf
    to_m: float = np.inf


@dataclass(frozen=True)
class Lane:
    """A lane from one place along the road to another; ``driven_m`` is where cars keep to, by default its middle."""

    left: Edge
    right: Edge
    from_m: float = -np.inf
    to_m: float = np.inf
    driven_m: float | None = None

    def way_m(self, s_m: float) -> float:
        """D of where cars drive in the lane."""
        if self.driven_m is not None:
            return self.driven_m
        return float(self.left.d_m.at(s_m) + self.right.d_m.at(s_m)) / 2

    def beside_m(self, s_m: float, d_m: float) -> float:
        """How far outside the lane a place is, 0 within."""
        return max(d_m - float(self.left.d_m.at(s_m)), float(self.right.d_m.at(s_m)) - d_m, 0.0)


@dataclass(frozen=True)
class LaneMap:
    """All lanes of the own direction; between two of them the middle of their line is the border."""

    lanes: tuple[Lane, ...]
    start: Lane = field(repr=False)
    """The lane that the ego car begins in."""

    def at(self, s_m: float, d_m: float) -> Lane | None:
        """The lane that a place is in; None where there is none along the road."""
        there = [lane for lane in self.lanes if lane.from_m <= s_m < lane.to_m]
        return min(there, key=lambda lane: lane.beside_m(s_m, d_m)) if there else None


def single(lane: Lane) -> LaneMap:
    """One lane all along."""
    return LaneMap((lane,), lane)


def side_by_side(edges: Sequence[tuple[Edge, Edge]], start: int) -> LaneMap:
    """Lanes without end from left to right; ``start`` is the number of the one the ego car begins in."""
    lanes = tuple(Lane(left, right) for left, right in edges)
    return LaneMap(lanes, lanes[start])


Dashes = Literal["none", "all", "stretches"]


@dataclass(frozen=True)
class Marking:
    """A line as wide as all are, about a middle that changes with s, between two places.

    ``dashes`` says where it is dashed: nowhere, all along, or for a part of each stretch as in the plain scenes.
    """

    middle_m: Along
    colour: Colour
    dashes: Dashes = "none"
    from_m: float = -np.inf
    to_m: float = np.inf


@dataclass(frozen=True)
class Markings:
    """All lines of a road, and the stretches where they are missing or worn down to remains."""

    lines: tuple[Marking, ...]
    missing: tuple[Stretch, ...] = ()
    worn: tuple[Stretch, ...] = ()
