"""Which region is the object of which detection: each object belongs to the detection that fits it best.

A detector also finds cars that are hidden, by what is seen around them: their boxes lie on cars before them. What the
detection of those has is not theirs, and of what remains they get what fits, or nothing.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from math import inf, log
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects.boxes import areas, corners, shared_areas
from roadperc_stream.chain.stages.objects.distance import Measured
from roadperc_stream.chain.stages.objects.kinds import kinds
from roadperc_stream.chain.stages.objects.regions import Region

SAME_DISTANCE = 0.03
"""Share by which the distances of regions of one object differ at most: their nearest point is the same."""
SAME_PLACE = 0.5
"""Least share of the smaller one's bounds that regions of one object have in common."""
_ROWS = 64
"""Candidates that are compared with all others at once: a detector may give thousands."""

NOWHERE: Final[Mapping[int, float | None]] = MappingProxyType({})
"""No object is expected."""
FITS_ALIKE = 0.1
"""Difference of fits that says little."""
AS_EXPECTED = 0.1
"""Share by which the distance of an object that is known may differ from the expected one."""


@dataclass(frozen=True)
class MeasuredRegion:
    """A region that is a detection's object, and its distance."""

    region: Region
    measured: Measured


def choose(
    labels: Sequence[str],
    candidates: Sequence[Sequence[Region]],
    measure: Callable[[Region], Measured],
    expected_m: Mapping[int, float | None] = NOWHERE,
) -> list[MeasuredRegion | None]:
    """One candidate of each detection, those that fit best before the others; None where others have them all.

    Args:
        labels: of the detections.
        candidates: of each of them.
        measure: gives a region's distance; it is asked for what may be chosen alone.
        expected_m: how far the object of a detection is, by its position, where that is known from before.
    """
    fits = _fits(candidates, measure := cache(measure), expected_m)
    unordered = [region for of_one in candidates for region in of_one]
    flat = [unordered[k] for k in sorted(range(len(fits)), key=lambda k: (-fits[k], k))]
    chosen: list[MeasuredRegion | None] = [None] * len(labels)
    claims: list[list[Measured]] = [[] for _ in flat]
    for row, (region, together) in enumerate(zip(flat, _same_places(labels, flat), strict=True)):
        if chosen[region.owner] is not None:
            continue
        measured = measure(region)
        if not any(_same_distance(measured, claim) for claim in claims[row]):
            chosen[region.owner] = MeasuredRegion(region, measured)
            for other in np.flatnonzero(together).tolist():
                claims[other].append(measured)
    return chosen


def _fits(
    candidates: Sequence[Sequence[Region]],
    measure: Callable[[Region], Measured],
    expected_m: Mapping[int, float | None],
) -> list[float]:
    """How well each candidate fits; of those of a known object that fit alike, the one as far as it fits best."""
    fits = [[region.fit for region in of_one] for of_one in candidates]
    for owner, distance_m in expected_m.items():
        best = max(fits[owner], default=0.0)
        alike = [k for k, fit in enumerate(fits[owner]) if fit > best - FITS_ALIKE]
        if distance_m is None or len(alike) < 2:
            continue
        off = [_apart(measure(candidates[owner][k]).distance_m, distance_m) for k in alike]
        if min(off) < AS_EXPECTED:
            fits[owner][alike[off.index(min(off))]] = best + FITS_ALIKE
    return [fit for of_one in fits for fit in of_one]


def _same_places(labels: Sequence[str], flat: Sequence[Region]) -> Iterator[NDArray[np.bool_]]:
    """For each of M candidates, (M,) which may be of the object that it is of, by their place in the image."""
    kind = kinds(labels)[0][np.array([region.owner for region in flat], np.int64)]
    boxes = corners(region.box_px for region in flat)
    sizes = areas(boxes)
    for first in range(0, len(flat), _ROWS):
        rows = slice(first, first + _ROWS)
        smaller = np.minimum(sizes[rows, None], sizes)
        yield from (shared_areas(boxes[:, rows], boxes) > SAME_PLACE * smaller) & (kind[rows, None] == kind)


def _same_distance(one: Measured, other: Measured) -> bool:
    """Whether the nearest points are as far; what is not known is nowhere."""
    return _apart(one.distance_m, other.distance_m) < SAME_DISTANCE


def _apart(one_m: float | None, other_m: float | None) -> float:
    """Share by which two distances differ; infinite where one is not known, or behind the camera."""
    if one_m is None or other_m is None or one_m <= 0 or other_m <= 0:
        return inf
    return abs(log(one_m / other_m))
