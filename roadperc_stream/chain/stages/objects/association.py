"""Which detection is which object: the pairs of largest total similarity (the assignment problem).

Similar are boxes that overlap; where the distances contradict each other the overlap counts for less. So an object
whose distance jumps to something in front keeps its id, and of two that pass each other each keeps its own.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from roadperc_stream.chain.stages.objects.tracking import ObjectTrack, distance_std_m
from roadperc_stream.core.config import ObjectsConfig
from roadperc_stream.core.datatypes import Box, Object
from roadperc_stream.core.geometry import Float
from roadperc_stream.core.semantics import classes_of_label


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
    scores = similarities(cfg, tracks, items, boxes)
    rows, columns = linear_sum_assignment(scores, maximize=True)
    return {int(row): int(column) for row, column in zip(rows, columns, strict=True) if scores[row, column] > 0}


def similarities(
    cfg: ObjectsConfig, tracks: Sequence[ObjectTrack], items: Sequence[Object], boxes: Sequence[Box]
) -> Float:
    """(tracks, items) 0 to 1: how well each detection fits each predicted track; 0 where it cannot be the same object.

    It is the overlap, which counts for less as the distances contradict each other, to the whole at the filter's gate.
    All pairs at once: a detector may give thousands of boxes, and each is compared with every track.
    """
    kinds = [_kind(track.detection.label) for track in tracks], [_kind(item.detection.label) for item in items]
    numbers = {kind: number for number, kind in enumerate(dict.fromkeys((*kinds[0], *kinds[1])))}
    ours, theirs = (np.array([numbers[kind] for kind in side], np.int64) for side in kinds)
    with np.errstate(all="ignore"):  # boxes may be beyond all numbers: what is no number is no similarity
        overlap = _overlaps(_corners(track.box_px for track in tracks), _corners(boxes))
        scores = overlap * (1.0 - cfg.distance_penalty * _contradictions(cfg, tracks, items))
        fits = (ours[:, None] == theirs) & (scores >= cfg.min_overlap)
    return np.where(fits, scores, 0.0)


def _corners(boxes: Iterable[Box]) -> Float:
    """(4, N) x_min, y_min, x_max and y_max."""
    return np.array([(b.x_min, b.y_min, b.x_max, b.y_max) for b in boxes], np.float64).reshape(-1, 4).T


def _overlaps(ours: Float, theirs: Float) -> Float:
    """(M, N) intersection over union of (4, M) with (4, N) corners: ``Box.overlap`` of all pairs."""
    x0, y0, x1, y1 = ours[:, :, None]
    width = np.minimum(x1, theirs[2]) - np.maximum(x0, theirs[0])
    height = np.minimum(y1, theirs[3]) - np.maximum(y0, theirs[1])
    shared = width * height
    meet = (width > 0) & (height > 0)
    return np.where(meet, shared / (_areas(ours)[:, None] + _areas(theirs) - shared), 0.0)


def _areas(corners: Float) -> Float:
    """(N,) square pixels."""
    areas: Float = np.maximum(corners[2] - corners[0], 0.0) * np.maximum(corners[3] - corners[1], 0.0)
    return areas


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


def _kind(label: str) -> tuple[str, ...]:
    """Labels of one kind may stand for one object: detectors waver between car, van and truck."""
    return classes_of_label(label) or (label,)
