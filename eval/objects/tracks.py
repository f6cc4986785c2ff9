"""HOTA, CLEAR MOT and identity measures of tracks, with a similarity by the distance on the ground.

Sources: Luiten et al., HOTA: A Higher Order Metric for Evaluating Multi-Object Tracking, IJCV 2021. Bernardin and
Stiefelhagen, Evaluating Multiple Object Tracking Performance: The CLEAR MOT Metrics, 2008 (MOTA). Ristani et al.,
Performance Measures and a Data Set for Multi-Target, Multi-Camera Tracking, 2016 (IDF1). The functions agree with those
of ``trackeval``.
"""

from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float

from .matching import FARTHEST_M, Codes, Mask, Pairs, alone, assigned, one_to_one, rows_by

LEAST_SIMILARITY: Final = 0.5
"""That of a match of MOTA and IDF1: 2 m."""
ALPHAS: Final = np.arange(0.05, 0.99, 0.05)
"""(19,) the least similarities over which HOTA is averaged."""
_SAME: Final = 1000.0
"""Score of a pair that continues a match of the previous frame: more than any sum of similarities."""
_EPS: Final = float(np.finfo(float).eps)


def similarity(apart_m: Float) -> Float:
    """1 at the same place, falling to 0 at ``FARTHEST_M``."""
    return np.asarray(1.0 - apart_m / FARTHEST_M, np.float64)


@dataclass(frozen=True)
class Sighted:
    """The frame and the track of (N,) objects; no track is in two logs."""

    frame: Codes
    track: Codes


def hota_matches(pairs: Pairs, true: Sighted, found: Sighted) -> Mask:
    """(P,) the pairs that HOTA matches: those with the best agreement of the whole tracks, weighted by similarity.

    The value of ``pairs`` is their similarity.
    """
    i, k, alike = pairs
    share = alike / (np.bincount(i, alike)[i] + np.bincount(k, alike)[k] - alike)
    number, both = _numbers(true.track[i], found.track[k])
    together = np.bincount(number, share, len(both))
    lengths = np.bincount(true.track)[both[:, 0]] + np.bincount(found.track)[both[:, 1]]
    agreement = together / (lengths - together)
    return one_to_one(Pairs(i, k, agreement[number] * alike), true.frame[i])


def clear_matches(pairs: Pairs, true: Sighted, found: Sighted) -> Codes:
    """(M,) the row of the detection that each true object matches, else -1.

    Matches of the previous frame are continued first. The value of ``pairs`` is their similarity.
    """
    i, k, alike = pairs = pairs.at(pairs.value >= LEAST_SIMILARITY - _EPS)
    single = alone(pairs)
    match = np.full(len(true.frame), -1)
    match[i[single]] = k[single]
    before = _before(true, found)
    for rows in rows_by(np.flatnonzero(~single), true.frame[i]):
        own, other = i[rows], k[rows]
        last = np.where(before[own] >= 0, match[before[own]], -1)
        same = (last >= 0) & (found.track[last] == found.track[other])
        chosen = assigned(Pairs(own, other, alike[rows] + _SAME * same))
        match[own[chosen]] = other[chosen]
    return match


def _before(true: Sighted, found: Sighted) -> Codes:
    """(M,) the row of the same true object in the previous frame with true objects and detections."""
    filled = np.flatnonzero(np.isin(true.frame, found.frame))
    steps = np.unique(true.frame[filled])
    order = filled[np.lexsort((true.frame[filled], true.track[filled]))]
    step = np.searchsorted(steps, true.frame[order])
    follows = (np.diff(true.track[order], prepend=-1) == 0) & (np.diff(step, prepend=-2) == 1)
    before = np.full(len(true.frame), -1)
    before[order[follows]] = order[np.flatnonzero(follows) - 1]
    return before


def switches(match: Codes, true: Sighted, found: Sighted) -> Mask:
    """(M,) whether a true object matches another track than at its last match."""
    rows = np.flatnonzero(match >= 0)
    rows = rows[np.lexsort((true.frame[rows], true.track[rows]))]
    same = np.diff(true.track[rows], prepend=-1) == 0
    switched = np.zeros(len(match), bool)
    switched[rows] = same & (np.diff(found.track[match[rows]], prepend=-1) != 0)
    return switched


def identity_matches(true_track: Codes, track: Codes, sequence: Codes) -> int:
    """The largest number of pairs whose tracks belong together, if each track belongs to one true object at most.

    Args:
        true_track: (P,) track of the true object of each pair that is similar enough.
        track: (P,) track of its detection.
        sequence: (P,) its sequence.
    """
    number, both = _numbers(true_track, track)
    counts = np.bincount(number, minlength=len(both)).astype(np.float64)
    of_both = np.empty(len(both), np.int64)
    of_both[number] = sequence
    return int(counts[one_to_one(Pairs(both[:, 0], both[:, 1], counts), of_both)].sum())


def association(true_track: Codes, track: Codes, alike: Float, lengths: Codes) -> tuple[Float, Float]:
    """(19,) the number of matches at each alpha, and the sum of their association scores.

    Args:
        true_track: (T,) track of the true object of each match.
        track: (T,) track of its detection.
        alike: (T,) their similarity.
        lengths: (T,) the numbers of frames of both tracks together.
    """
    number, both = _numbers(true_track, track)
    level = np.searchsorted(ALPHAS - _EPS, alike, "right")  # as many alphas are reached
    levels = len(ALPHAS) + 1
    counts = np.bincount(number * levels + level, minlength=len(both) * levels).reshape(-1, levels).astype(np.float64)
    reached = counts[:, ::-1].cumsum(axis=1)[:, ::-1][:, 1:]
    together = np.zeros((len(both), 1))
    together[number, 0] = lengths
    scores = reached * reached / np.maximum(1.0, together - reached)
    return reached.sum(axis=0), scores.sum(axis=0)


def _numbers(true_track: Codes, track: Codes) -> tuple[Codes, Codes]:
    """(P,) the number of each pair of tracks, and (Q, 2) the pairs."""
    width = int(track.max(initial=0)) + 1
    codes, number = np.unique(true_track * width + track, return_inverse=True)
    return number, np.stack((codes // width, codes % width), axis=1)


@dataclass(frozen=True)
class TrackSums:
    """Sums from which the measures follow; those of several classes or logs can be added.

    ``true`` and ``found`` count objects in frames. ``hits`` and ``scores`` are (19,) those of ``association``.
    """

    true: int = 0
    found: int = 0
    hits: Float | float = 0.0
    scores: Float | float = 0.0
    matches: int = 0
    switched: int = 0
    identified: int = 0

    def __add__(self, other: "TrackSums") -> "TrackSums":
        """The sums over both."""
        return TrackSums(*(getattr(self, field.name) + getattr(other, field.name) for field in fields(self)))

    @property
    def figures(self) -> dict[str, float]:
        """The measures by name; empty without true objects."""
        if not self.true:
            return {}
        detected = self.hits / (self.true + self.found - self.hits)
        associated = self.scores / np.maximum(1.0, self.hits)
        return {
            "hota": float(np.mean(np.sqrt(detected * associated))),
            "deta": float(np.mean(detected)),
            "assa": float(np.mean(associated)),
            "mota": (self.matches - (self.found - self.matches) - self.switched) / self.true,
            "idf1": 2 * self.identified / (self.true + self.found),
        }
