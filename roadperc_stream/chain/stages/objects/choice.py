"""Which region is the object of which detection: each object belongs to the detection that fits it best.

A detector also finds cars that are hidden, by what is seen around them: their boxes lie on cars before them. What the
detection of those has is not theirs, and of what remains they get what fits, or nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

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
    """A region that may be a detection's object, and its distance."""

    region: Region
    measured: Measured


@dataclass(frozen=True)
class _Table:
    """The candidates of all detections, one in each row."""

    owner: NDArray[np.int64]
    kind: NDArray[np.int64]
    corners: Float
    log_distance: Float

    def same_object(self, row: int) -> NDArray[np.bool_]:
        """Which candidates have their nearest point where that of a row has it, NaN being no place."""
        box = self.corners[:, row : row + 1]
        smaller = np.minimum(areas(box), areas(self.corners))
        together = shared_areas(box, self.corners)[0] > SAME_PLACE * smaller
        near = np.abs(self.log_distance - self.log_distance[row]) < SAME_DISTANCE
        return np.asarray(together & near & (self.kind == self.kind[row]), np.bool_)


def choose(labels: Sequence[str], candidates: Sequence[Sequence[MeasuredRegion]]) -> list[MeasuredRegion | None]:
    """One candidate of each detection, those that fit best before the others; None where others have them all.

    Args:
        labels: of the detections.
        candidates: of each of them.
    """
    flat = [candidate for of_one in candidates for candidate in of_one]
    table = _table(labels, flat)
    chosen: list[MeasuredRegion | None] = [None] * len(labels)
    taken = np.zeros(len(flat), np.bool_)
    for row in sorted(range(len(flat)), key=lambda k: (-flat[k].region.fit, k)):
        owner = flat[row].region.owner
        if not taken[row] and chosen[owner] is None:
            chosen[owner] = flat[row]
            taken |= table.same_object(row)
    return chosen


def _table(labels: Sequence[str], flat: Sequence[MeasuredRegion]) -> _Table:
    owner = np.array([candidate.region.owner for candidate in flat], np.int64)
    distances = [candidate.measured.distance_m for candidate in flat]
    known = np.array([np.nan if distance is None else distance for distance in distances])
    return _Table(owner, kinds(labels)[0][owner], corners(c.region.box_px for c in flat), np.log(known))
