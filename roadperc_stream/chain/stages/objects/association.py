"""Which detection is which object: the pairs of largest total similarity (the assignment problem).

Similar are boxes that overlap; where the distances contradict each other the overlap counts for less. So an object
whose distance jumps to something in front keeps its id, and of two that pass each other each keeps its own.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects.mosaic import corners, kinds, overlaps
from roadperc_stream.chain.stages.objects.tracking import ObjectTrack, distance_std_m
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Float
from roadperc_stream.geometry.assignment import largest_total
from roadperc_stream.model import Box, Object

EXPECTED_OVERLAP = 0.4
"""Intersection over union with the predicted box from which a detection is where its object is expected."""
DISTANCE_PENALTY = 0.3
"""Share of the overlap that does not count where the distances contradict each other."""


def assign(
    cfg: ObjectsConfig, tracks: Sequence[ObjectTrack], items: Sequence[Object], boxes: Sequence[Box]
) -> dict[int, int]:
    """The position in ``items`` of each track's detection, by the track's position; both appear at most once.

    Args:
        cfg: gates.
        tracks: predicted to the time of the detections.
        items: filtered detections.
        boxes: their boxes within the image.

    Equal similarities are decided by the order of tracks and items.
    """
    if not tracks or not items:
        return {}
    return largest_total(similarities(cfg, tracks, items, boxes))


def similarities(
    cfg: ObjectsConfig, tracks: Sequence[ObjectTrack], items: Sequence[Object], boxes: Sequence[Box]
) -> Float:
    """(tracks, items) 0 to 1: how well each detection fits each predicted track; 0 where it cannot be the same object.

    It is the overlap, which counts for less as the distances contradict each other, to the whole at the filter's gate.
    All pairs at once: a detector may give thousands of boxes, and each is compared with every track.
    """
    ours, theirs = kinds([track.detection.label for track in tracks], [item.detection.label for item in items])
    with np.errstate(all="ignore"):  # boxes may be beyond all numbers: what is no number is no similarity
        overlap = overlaps(corners(track.box_px for track in tracks), corners(boxes))
        scores = overlap * (1.0 - DISTANCE_PENALTY * _contradictions(cfg, tracks, items))
        fits = (ours[:, None] == theirs) & (scores >= cfg.min_overlap)
    return np.where(fits, scores, 0.0)


def _contradictions(cfg: ObjectsConfig, tracks: Sequence[ObjectTrack], items: Sequence[Object]) -> Float:
    """(tracks, items) 0 where the distances agree or one is unknown, 1 from the gate on."""
    motions = [track.distance_m for track in tracks]
    expected = np.array([np.nan if m is None else m.value for m in motions])[:, None]
    variances = np.array([np.nan if m is None else m.value_var for m in motions])[:, None]
    measured = np.array([np.nan if item.distance_m is None else item.distance_m for item in items])
    # As RateFilter.surprise has it; float_power rounds as Python's ** does, squaring by a product does not always.
    noise = np.float_power(np.array([distance_std_m(cfg, item) for item in items]), 2.0)
    surprise = np.float_power(measured - expected, 2.0) / (variances + noise)
    unknown: NDArray[np.bool_] = np.isnan(expected) | np.isnan(measured)
    return np.where(unknown, 0.0, np.minimum(surprise / cfg.gate, 1.0))


def expected(tracks: Sequence[ObjectTrack], labels: Sequence[str], boxes: Sequence[Box]) -> dict[int, float | None]:
    """Boxes that lie where a track of their kind is predicted, by position, and how far the track's object is.

    Of several tracks it is the one whose box is overlapped most; None where its distance is not known.
    """
    if not tracks or not boxes:
        return {}
    ours, theirs = kinds([track.detection.label for track in tracks], labels)
    with np.errstate(all="ignore"):
        overlap = overlaps(corners(track.box_px for track in tracks), corners(boxes))
    overlap = np.where((overlap >= EXPECTED_OVERLAP) & (ours[:, None] == theirs), overlap, 0.0)
    best = overlap.argmax(axis=0)
    known = [None if track.distance_m is None else track.distance_m.value for track in tracks]
    return {k: known[best[k]] for k in np.flatnonzero(overlap.max(axis=0)).tolist()}
