"""Pairs of true objects and detections by their distance on the ground."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float
from roadperc_stream.geometry.assignment import largest_total

MATCHES_M: Final = (0.5, 1.0, 2.0, 4.0)
"""Largest distances of a match in nuScenes."""
FARTHEST_M: Final = max(MATCHES_M)
Codes = NDArray[np.int64]
"""(N,) whole numbers."""
Mask = NDArray[np.bool_]


class Pairs(NamedTuple):
    """(P,) row of the true object, row of the detection, and the value of the pair: a distance or a score."""

    true: Codes
    found: Codes
    value: Float

    def at(self, rows: Codes | Mask) -> "Pairs":
        """Some of the pairs."""
        return Pairs(self.true[rows], self.found[rows], self.value[rows])


def near_pairs(true_frame: Codes, true_m: Float, frame: Codes, place_m: Float) -> Pairs:
    """All pairs within a frame that are nearer than ``FARTHEST_M``, and their distances.

    Args:
        true_frame: (M,) frame of each true object.
        true_m: (M, 2) its place.
        frame: (N,) frame of each detection, in rising order.
        place_m: (N, 2) its place.
    """
    begin, end = (np.searchsorted(frame, true_frame, side) for side in ("left", "right"))
    counts = end - begin
    true = np.repeat(np.arange(len(true_frame)), counts)
    found = np.arange(len(true)) + np.repeat(begin - np.cumsum(counts) + counts, counts)
    apart_m = np.hypot(*(true_m[true] - place_m[found]).T)
    near = apart_m < FARTHEST_M
    return Pairs(true, found, apart_m).at(near)


def by_score(score: Float) -> Codes:
    """The order of falling scores; of equal scores the later detection is first, as in nuScenes."""
    return np.argsort(score, kind="stable")[::-1]


def greedy(pairs: Pairs, frame: Codes, score: Float, limit_m: float) -> Codes:
    """(N,) the true object that each detection hits, else -1.

    In the order of falling score, each detection takes the nearest free true object of its frame, if it is nearer than
    ``limit_m``. Source: Caesar et al., nuScenes: A multimodal dataset for autonomous driving, 2020, section 3.1.
    """
    hits = np.full(len(frame), -1)
    true, found, apart_m = pairs.at(pairs.value < limit_m)
    if not len(true):
        return hits
    place = np.empty(len(frame), np.int64)
    place[by_score(score)] = np.arange(len(frame))
    nearest_first = np.lexsort((true, apart_m, place[found], frame[found]))
    true, found = true[nearest_first], found[nearest_first]
    rank = _rank_in_frame(found, frame)
    taken = np.zeros(int(true.max()) + 1, bool)
    for turn in range(int(rank.max()) + 1):  # of all frames at once
        free = (rank == turn) & ~taken[true]
        first = np.flatnonzero(free)[np.unique(found[free], return_index=True)[1]]
        hits[found[first]] = true[first]
        taken[true[first]] = True
    return hits


def _rank_in_frame(found: Codes, frame: Codes) -> Codes:
    """(P,) the number of the pair's detection among those of its frame; pairs are sorted by frame and detection."""
    new_detection = np.diff(found, prepend=-1) != 0
    new_frame = np.diff(frame[found], prepend=-1) != 0
    number = np.cumsum(new_detection)
    rank: Codes = number - np.maximum.accumulate(np.where(new_frame, number, 0))
    return rank


def alone(pairs: Pairs) -> Mask:
    """(P,) whether a pair is the only one of its true object and of its detection."""
    true, found, _ = pairs
    alone: Mask = (np.bincount(true)[true] == 1) & (np.bincount(found)[found] == 1)
    return alone


def one_to_one(pairs: Pairs, group: Codes) -> Mask:
    """(P,) the pairs of the one-to-one assignment with the largest total; ``group`` (P,) separates problems."""
    chosen = alone(pairs)
    for rows in rows_by(np.flatnonzero(~chosen), group):
        chosen[rows[assigned(pairs.at(rows))]] = True
    return chosen


def rows_by(rows: Codes, group: Codes) -> list[Codes]:
    """The rows of each group, in rising order of the groups."""
    ordered = rows[np.argsort(group[rows], kind="stable")]
    return np.split(ordered, np.flatnonzero(np.diff(group[ordered])) + 1) if len(ordered) else []


def assigned(pairs: Pairs) -> Codes:
    """The indices of the pairs in the one-to-one assignment with the largest total of their numbers."""
    true, found, value = pairs
    (rows, row), (columns, column) = (np.unique(side, return_inverse=True) for side in (true, found))
    scores, number = np.zeros((len(rows), len(columns))), np.zeros((len(rows), len(columns)), np.int64)
    scores[row, column], number[row, column] = value, np.arange(len(value))
    return np.array([number[at] for at in largest_total(scores).items()], np.int64)
