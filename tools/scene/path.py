"""The road in plan view: a chain of lines and arcs, and the coordinates (s, d) along and across it.

s is the length along the centre line in metres, d the offset from it, positive to the left. World frames are
right-handed: x forward, y left, z up.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float

Real = NDArray[np.floating[Any]]
"""Single or double precision; results have the precision of the arguments."""


@dataclass(frozen=True)
class Element:
    """A curve of constant curvature from (x_m, y_m) with a heading (radians from x, positive left)."""

    s_m: float
    x_m: float
    y_m: float
    heading: float
    curvature_per_m: float

    def at(self, s_m: float) -> "Element":
        """Return the same curve, described from another point of it."""
        turn = self.curvature_per_m * (s_m - self.s_m)
        x, y = _along(self.heading, self.curvature_per_m, s_m - self.s_m)
        return Element(s_m, self.x_m + float(x), self.y_m + float(y), self.heading + turn, self.curvature_per_m)


@dataclass(frozen=True)
class Path:
    """Elements in the order of s; the first and the last one have no end."""

    elements: tuple[Element, ...]

    @cached_property
    def _columns(self) -> Float:
        return np.array([(e.s_m, e.x_m, e.y_m, e.heading, e.curvature_per_m) for e in self.elements])

    def pose(self, s_m: Float) -> tuple[Float, Float, Float]:
        """Return x, y and heading of the centre line at (N,) s."""
        columns = self._columns
        index = np.maximum(np.searchsorted(columns[:, 0], s_m, side="right") - 1, 0)
        start, x0, y0, heading, curvature = columns[index].T
        ahead = s_m - start
        x, y = _along(heading, curvature, ahead)
        return x0 + x, y0 + y, heading + curvature * ahead

    def point(self, s_m: Float, d_m: Float | float) -> tuple[Float, Float]:
        """Return world x and y of road coordinates."""
        x, y, heading = self.pose(s_m)
        return x - d_m * np.sin(heading), y + d_m * np.cos(heading)

    def curvature(self, s_m: float) -> float:
        """Return the curvature of the centre line, 1/m, positive to the left."""
        index = int(np.searchsorted(self._columns[:, 0], s_m, side="right")) - 1
        return float(self._columns[max(index, 0), 4])

    def around(self, s_m: float, behind_m: float = 60.0, ahead_m: float = 400.0) -> "LocalPath":
        """Return the road near s, with s and the origin relative to that point, so that single precision suffices."""
        x, y, _ = self.pose(np.array([s_m]))
        origin = (float(x[0]), float(y[0]))
        ends = [e.s_m for e in self.elements[1:]] + [np.inf]
        near = [e for e, end in zip(self.elements, ends, strict=True) if e.s_m < s_m + ahead_m and end > s_m - behind_m]
        # Describe a ring from the position of the car, so that angles reach half a turn in both directions.
        moved = [near[0].at(s_m)] if len(self.elements) == 1 else near
        shifted = (replace(e, s_m=e.s_m - s_m, x_m=e.x_m - origin[0], y_m=e.y_m - origin[1]) for e in moved)
        return LocalPath(tuple(shifted), origin, s_m)


@dataclass(frozen=True)
class LocalPath:
    """A stretch of road with coordinates relative to ``origin_m`` (world x, y) and ``s_origin_m``."""

    elements: tuple[Element, ...]
    origin_m: tuple[float, float]
    s_origin_m: float

    def coordinates(self, x_m: Real, y_m: Real) -> tuple[Real, Real]:
        """Return the exact local s and d of local points of any shape, by projection on the nearest line or arc.

        A point belongs to the last element whose start normal it has passed, checked in order. Headings stay within 90
        degrees of each other, so the normals do not cross near the road.
        """
        s, d = _beside(self.elements[0], x_m, y_m)
        # Most points are near. Each element checks only the points that passed the element before.
        reached, x, y = np.arange(x_m.size), x_m.ravel(), y_m.ravel()
        for element in self.elements[1:]:
            cos, sin = float(np.cos(element.heading)), float(np.sin(element.heading))
            passed = np.flatnonzero((x - element.x_m) * cos + (y - element.y_m) * sin > 0)
            reached, x, y = reached[passed], x[passed], y[passed]
            s.ravel()[reached], d.ravel()[reached] = _beside(element, x, y)
        return s, d


def chain(start: Element, pieces: Iterable[tuple[float, float]]) -> Path:
    """Return a path of (length in metres, curvature) pieces, each tangent to the previous one."""
    elements: list[Element] = []
    end = start
    for length, curvature in pieces:
        elements.append(replace(end, curvature_per_m=curvature))
        end = elements[-1].at(end.s_m + length)
    return Path(tuple(elements))


def _along(heading: Float | float, curvature: Float | float, ahead: Float | float) -> tuple[Float, Float]:
    """Return the displacement after ``ahead`` metres: a chord of length 2/k sin(k s / 2), turned by half the angle."""
    half = np.asarray(curvature) * ahead / 2
    chord = ahead * np.sinc(half / np.pi)
    return chord * np.cos(heading + half), chord * np.sin(heading + half)


def _beside(element: Element, x_m: Real, y_m: Real) -> tuple[Real, Real]:
    cos, sin = float(np.cos(element.heading)), float(np.sin(element.heading))
    dx, dy = x_m - element.x_m, y_m - element.y_m
    ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
    if element.curvature_per_m == 0:
        return ahead + element.s_m, left
    radius = 1 / element.curvature_per_m
    sign = 1.0 if radius > 0 else -1.0
    inward = radius - left
    s = np.arctan2(sign * ahead, sign * inward) * radius + element.s_m
    return s, radius - sign * np.sqrt(ahead * ahead + inward * inward)
