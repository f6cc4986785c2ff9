"""Which detection is which object: the pairs of largest total similarity (the assignment problem).

Similar are boxes that overlap; where the distances contradict each other the overlap counts for less. So an object
whose distance jumps to something in front keeps its name, and of two that pass each other each keeps its own.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from roadperc_stream.config import ObjectsConfig
from roadperc_stream.datatypes import Box, Object
from roadperc_stream.geometry import Float
from roadperc_stream.semantics import classes_of_label
from roadperc_stream.stages.objects.tracking import Track, distance_std_m


def assign(
    cfg: ObjectsConfig, tracks: Sequence[Track], items: Sequence[Object], boxes: Sequence[Box]
) -> dict[int, int]:
    """The position in ``items`` of each track's detection, by the track's position; both appear at most once.

    Args:
        cfg: gates.
        tracks: predicted to the time of the detections.
        items: judged detections.
        boxes: their boxes within the image.

    Equal similarities are decided by the order of tracks and items.
    """
    if not tracks or not items:
        return {}
    scores = _scores(cfg, tracks, items, boxes)
    rows, columns = linear_sum_assignment(scores, maximize=True)
    return {int(row): int(column) for row, column in zip(rows, columns, strict=True) if scores[row, column] > 0}


def similarity(cfg: ObjectsConfig, track: Track, item: Object, box: Box) -> float:
    """0 to 1: how well a detection fits a predicted track; 0 where it cannot be the same object.

    It is the overlap, which counts for less as the distances contradict each other, to the whole at the filter's gate.
    """
    if _kind(track.detection.label) != _kind(item.detection.label):
        return 0.0
    score = track.box_px.overlap(box) * (1.0 - cfg.distance_penalty * _contradiction(cfg, track, item))
    return score if score >= cfg.min_overlap else 0.0


def _scores(cfg: ObjectsConfig, tracks: Sequence[Track], items: Sequence[Object], boxes: Sequence[Box]) -> Float:
    """(tracks, items) similarities."""
    pairs = list(zip(items, boxes, strict=True))
    return np.array([[similarity(cfg, track, item, box) for item, box in pairs] for track in tracks])


def _contradiction(cfg: ObjectsConfig, track: Track, item: Object) -> float:
    """0 where the distances agree or one is unknown, 1 from the gate on."""
    if track.distance_m is None or item.distance_m is None:
        return 0.0
    return min(track.distance_m.surprise(item.distance_m, distance_std_m(cfg, item)) / cfg.gate, 1.0)


def _kind(label: str) -> tuple[str, ...]:
    """Labels of one kind may stand for one object: detectors waver between car, van and truck."""
    return classes_of_label(label) or (label,)
