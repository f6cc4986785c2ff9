"""How well detections fit the predicted tracks: by their place on the ground, and by the overlap of their boxes.

A narrow object moves by more than its width in the image between two frames, so its boxes need not overlap. Its place
on the ground is predicted with the car's motion. The overlap decides between objects at almost the same place, and
alone where a place or the car's motion is unknown.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects.mosaic import corners, kinds, overlaps
from roadperc_stream.chain.stages.objects.object_track import ObjectTrack, distance_std_m
from roadperc_stream.chain.stages.objects.place import Sighting
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Float
from roadperc_stream.model import Box, Object

DISTANCE_PENALTY = 0.3
"""Share of the overlap that is subtracted if the distances contradict each other."""
GROUND_WEIGHT = 0.6
"""Weight of the place on the ground; the rest is that of the overlap."""


def similarities(
    cfg: ObjectsConfig,
    tracks: Sequence[ObjectTrack],
    items: Sequence[Object],
    boxes: Sequence[Box],
    seen: Sequence[Sighting | None],
) -> Float:
    """(tracks, items) 0 to 1: how well each detection fits each predicted track; 0 where it cannot be the same object.

    All pairs are computed at once, because a detector may report thousands of boxes.

    Args:
        cfg: thresholds.
        tracks: the tracks, predicted to this frame.
        items: the kept detections.
        boxes: their boxes within the image.
        seen: where they are seen, None without a distance.
    """
    overlap = overlap_similarities(cfg, tracks, items, boxes)
    surprise = _ground_surprises(tracks, seen)
    ours, theirs = kinds([track.detection.label for track in tracks], [item.detection.label for item in items])
    fits = (ours[:, None] == theirs) & (surprise < cfg.gate)
    overlap = np.where(np.isnan(surprise), overlap, (1.0 - GROUND_WEIGHT) * overlap)
    return np.where(fits, overlap + GROUND_WEIGHT * (1.0 - surprise / cfg.gate), overlap)


def overlap_similarities(
    cfg: ObjectsConfig, tracks: Sequence[ObjectTrack], items: Sequence[Object], boxes: Sequence[Box]
) -> Float:
    """(tracks, items) 0 to 1: how well each detection fits each predicted track in the image.

    The similarity is the overlap, reduced by up to ``DISTANCE_PENALTY`` as the distances contradict each other.
    """
    ours, theirs = kinds([track.detection.label for track in tracks], [item.detection.label for item in items])
    with np.errstate(all="ignore"):  # coordinates may overflow; NaN becomes 0
        overlap = overlaps(corners(track.box_px for track in tracks), corners(boxes))
        scores = overlap * (1.0 - DISTANCE_PENALTY * _contradictions(cfg, tracks, items))
        fits = (ours[:, None] == theirs) & (scores >= cfg.min_overlap)
    return np.where(fits, scores, 0.0)


def _ground_surprises(tracks: Sequence[ObjectTrack], seen: Sequence[Sighting | None]) -> Float:
    """(tracks, items) squared Mahalanobis distance on the ground; NaN where a place is unknown."""
    unknown = (np.nan,) * 4
    known = [track.place for track in tracks]
    ours = [p and (p.right_m.value, p.ahead_m.value, p.right_m.value_var, p.ahead_m.value_var) for p in known]
    theirs = [s and (s.point_m[0], s.point_m[2], s.right_std_m**2, s.ahead_std_m**2) for s in seen]
    rows = np.array([values or unknown for values in ours]).reshape(-1, 1, 4)
    columns = np.array([values or unknown for values in theirs]).reshape(-1, 4)
    with np.errstate(all="ignore"):  # an overflow is beyond every gate
        surprises: Float = ((rows[..., :2] - columns[:, :2]) ** 2 / (rows[..., 2:] + columns[:, 2:])).sum(axis=2)
    return surprises


def _contradictions(cfg: ObjectsConfig, tracks: Sequence[ObjectTrack], items: Sequence[Object]) -> Float:
    """(tracks, items) 0 if the distances agree or one is unknown, 1 at the gate and beyond."""
    motions = [track.distance_m for track in tracks]
    expected = np.array([np.nan if m is None else m.value for m in motions])[:, None]
    variances = np.array([np.nan if m is None else m.value_var for m in motions])[:, None]
    measured = np.array([np.nan if item.distance_m is None else item.distance_m for item in items])
    # As in RateFilter.surprise; float_power rounds like Python's **, a product does not always.
    noise = np.float_power(np.array([distance_std_m(cfg, item) for item in items]), 2.0)
    surprise = np.float_power(measured - expected, 2.0) / (variances + noise)
    unknown: NDArray[np.bool_] = np.isnan(expected) | np.isnan(measured)
    return np.where(unknown, 0.0, np.minimum(surprise / cfg.gate, 1.0))
