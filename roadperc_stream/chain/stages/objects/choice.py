"""Which region is the object of which detection: each object belongs to the detection that fits it best.

A detector also finds cars that are hidden, by what is seen around them: their boxes lie on cars before them. What the
detection of those has is not theirs, and of what remains they get what fits, or nothing.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects.boxes import areas, corners, shared_areas
from roadperc_stream.chain.stages.objects.distance import Measured
from roadperc_stream.chain.stages.objects.kinds import kinds
from roadperc_stream.chain.stages.objects.regions import Region
from roadperc_stream.core.geometry import Float

SAME_DISTANCE = 0.03
"""Share by which the distances of regions of one object differ at most: their nearest point is the same."""
SAME_PLACE = 0.5
"""Least share of the smaller one's bounds that regions of one object have in common."""


@dataclass(frozen=True)
class MeasuredRegion:
    """A region that is a detection's object, and its distance."""

    region: Region
    measured: Measured


def choose(
    labels: Sequence[str], candidates: Sequence[Sequence[Region]], measure: Callable[[Region], Measured]
) -> list[MeasuredRegion | None]:
    """One candidate of each detection, those that fit best before the others; None where others have them all.

    Args:
        labels: of the detections.
        candidates: of each of them.
        measure: gives a region's distance; it is asked for what may be chosen alone.
    """
    flat = [region for of_one in candidates for region in of_one]
    table = _table(labels, flat)
    chosen: list[MeasuredRegion | None] = [None] * len(labels)
    claims: list[list[Measured]] = [[] for _ in flat]
    for row in sorted(range(len(flat)), key=lambda k: (-flat[k].fit, k)):
        region = flat[row]
        if chosen[region.owner] is not None:
            continue
        measured = measure(region)
        if not any(_same_distance(measured, claim) for claim in claims[row]):
            chosen[region.owner] = MeasuredRegion(region, measured)
            for other in table.same_place(row):
                claims[other].append(measured)
    return chosen


@dataclass(frozen=True)
class _Table:
    """The candidates of all detections, one in each row."""

    kind: NDArray[np.int64]
    corners: Float

    def same_place(self, row: int) -> list[int]:
        """Candidates that may be of the object that a row is of, by their place in the image."""
        box = self.corners[:, row : row + 1]
        smaller = np.minimum(areas(box), areas(self.corners))
        together = shared_areas(box, self.corners)[0] > SAME_PLACE * smaller
        rows: list[int] = np.flatnonzero(together & (self.kind == self.kind[row])).tolist()
        return rows


def _table(labels: Sequence[str], flat: Sequence[Region]) -> _Table:
    owner = np.array([region.owner for region in flat], np.int64)
    return _Table(kinds(labels)[0][owner], corners(region.box_px for region in flat))


def _same_distance(one: Measured, other: Measured) -> bool:
    """Whether the nearest points are as far; what is not known is nowhere."""
    if not one.distance_m or not other.distance_m:
        return False
    return abs(log(one.distance_m / other.distance_m)) < SAME_DISTANCE
