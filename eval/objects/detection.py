"""Average precision and true-positive errors, as the detection benchmark of nuScenes defines them.

Source: Caesar et al., nuScenes: A multimodal dataset for autonomous driving, 2020, section 3.1. The functions agree
with those of ``nuscenes-devkit``.
"""

from typing import Final

import numpy as np

from roadperc_stream.geometry import Float

from .matching import Mask

LEAST_RECALL: Final = 0.1
LEAST_PRECISION: Final = 0.1
"""Recalls and precisions below these do not count."""
RECALLS: Final = np.linspace(0.0, 1.0, 101)
_FIRST: Final = round(100 * LEAST_RECALL) + 1


def curves(score: Float, hit: Mask, truths: int) -> tuple[Float, Float]:
    """(101,) precision and score at each of ``RECALLS``; 0 beyond the largest recall.

    Args:
        score: (N,) falling scores of the detections.
        hit: (N,) whether each hits a true object.
        truths: the number of true objects.
    """
    if not truths or not hit.any():
        return np.zeros_like(RECALLS), np.zeros_like(RECALLS)
    hits = np.cumsum(hit)
    precision = hits / np.arange(1, len(hits) + 1)
    at_recall = [np.interp(RECALLS, hits / truths, values, right=0.0) for values in (precision, score)]
    return at_recall[0], at_recall[1]


def average_precision(precision: Float) -> float:
    """The area below the (101,) precision above the least recall and precision, from 0 to 1."""
    return float(np.clip(precision[_FIRST:] - LEAST_PRECISION, 0.0, None).mean() / (1.0 - LEAST_PRECISION))


def mean_error(error: Float, score: Float, confidence: Float) -> float:
    """The mean over the recalls of the mean error down to the score there; 1 if no recall is above the least one.

    Args:
        error: (H,) error of each hit, NaN if unknown.
        score: (H,) its score, falling.
        confidence: (101,) score at each recall.
    """
    reached, known = np.flatnonzero(confidence), ~np.isnan(error)
    if not len(reached) or reached[-1] < _FIRST or not known.any():
        return 1.0
    sums, counts = np.cumsum(np.where(known, error, 0.0)), np.cumsum(known)
    mean = np.divide(sums, counts, out=np.zeros_like(sums), where=counts > 0)
    at_recall = np.interp(confidence[::-1], score[::-1], mean[::-1])[::-1]
    return float(at_recall[_FIRST : reached[-1] + 1].mean())
