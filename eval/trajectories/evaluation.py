"""A run's poses to its figures."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from roadperc_stream.core.geometry import Float
from roadperc_stream.errors import TableError

from ..options import Alignment
from .alignment import align
from .errors import Delta, ErrorStatistics, absolute_errors_m, pairs, path_m, relative_errors, segment_errors
from .poses import RunPoses

KITTI_LENGTHS_M: Final = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
KITTI_EVERY: Final = 10
SHORT_LENGTHS_M: Final = (5.0, 10.0, 25.0, 50.0)
"""Where no stretch of 100 m fits into the log; a stretch begins at every frame then, for there are few."""
_FEWEST: Final = 3
"""Fewer places than this lie on each other after any alignment."""


@dataclass(frozen=True)
class Segments:
    """KITTI's errors over all stretches of one length, or of all lengths together; None where none fits."""

    length_m: float | None
    count: int
    translation_percent: float | None
    rotation_deg_per_100m: float | None


@dataclass(frozen=True)
class Evaluation:
    """The figures of one run, and over how much of it they are.

    ``driven_m`` is the length of the true path; ``scale`` what the estimate was multiplied by. ``relative_m`` and
    ``relative_deg`` are None where no pair lies ``delta`` apart. ``stretches`` are by length, ``together`` over all.
    """

    run: RunPoses
    alignment: Alignment
    scale: float
    driven_m: float
    delta: Delta
    absolute_m: ErrorStatistics
    relative_m: ErrorStatistics | None
    relative_deg: ErrorStatistics | None
    every: int
    stretches: tuple[Segments, ...]
    together: Segments


def evaluate(run: RunPoses, alignment: Alignment | None, delta: Delta) -> Evaluation:
    """Align a run's poses to the true ones, and measure; all errors are of the aligned poses.

    Args:
        run: the poses.
        alignment: None for ``se3``, and for ``sim3`` where the run is up to scale.
        delta: the relative error's pairs.

    Raises:
        TableError: there is no truth, too few frames have both poses, or they cannot be aligned.
    """
    true = _truth_of(run)
    chosen = alignment or ("sim3" if run.up_to_scale else "se3")
    try:
        true_S_estimated = align(run.estimated, true, chosen)
    except TableError as error:
        raise TableError(f"{run.source}: {error}") from error
    estimated = true_S_estimated.poses(run.estimated)
    relative_m, relative_deg = relative_errors(estimated, true, *pairs(estimated, delta))
    driven_m = float(path_m(true)[-1])
    lengths_m, every = (KITTI_LENGTHS_M, KITTI_EVERY) if driven_m > KITTI_LENGTHS_M[0] else (SHORT_LENGTHS_M, 1)
    stretches = [segment_errors(estimated, true, length_m, every) for length_m in lengths_m]
    return Evaluation(
        run,
        chosen,
        true_S_estimated.scale,
        driven_m,
        delta,
        ErrorStatistics.of(absolute_errors_m(estimated, true)),
        ErrorStatistics.of(relative_m) if len(relative_m) else None,
        ErrorStatistics.of(relative_deg) if len(relative_deg) else None,
        every,
        tuple(_segments(length_m, [found]) for length_m, found in zip(lengths_m, stretches, strict=True)),
        _segments(None, stretches),
    )


def _truth_of(run: RunPoses) -> Float:
    """The true poses, if they are enough to judge by."""
    if run.true is None:
        raise TableError(
            f"{run.source}: no figures without truth: none of its {run.frames} frames has a true pose "
            "(true_x_m to true_qw); poses can still be exported"
        )
    if len(run.true) < _FEWEST:
        raise TableError(
            f"{run.source}: no figures: expected {_FEWEST} or more frames with an estimated and a true pose, "
            f"found {len(run.true)} of {run.frames}"
        )
    return run.true


def _segments(length_m: float | None, errors: Iterable[tuple[Float, Float]]) -> Segments:
    """Means over all stretches, as the benchmark takes them: a length counts by its number of stretches."""
    percent, deg = (np.concatenate(part) for part in zip(*errors, strict=True))
    if not len(percent):
        return Segments(length_m, 0, None, None)
    return Segments(length_m, len(percent), float(percent.mean()), float(deg.mean()))
