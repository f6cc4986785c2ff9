"""A run's poses to its figures."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from typing import Final

import numpy as np

from roadperc_stream.errors import TableError
from roadperc_stream.geometry import Float

from ..options import Alignment
from .errors import Delta, ErrorStatistics, absolute_errors_m, align, pairs, path_m, relative_errors, segment_errors
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

    Each segment of the log is aligned and measured by itself; ``left_out`` says of which there are no figures, and why.
    ``driven_m`` is the length of the true paths; ``scales`` what the estimate of each segment was multiplied by.
    ``relative_m`` and ``relative_deg`` are None where no pair lies ``delta`` apart. ``stretches`` are by length,
    ``together`` over all.
    """

    run: RunPoses
    alignment: Alignment
    scales: tuple[float, ...]
    driven_m: float
    delta: Delta
    absolute_m: ErrorStatistics
    relative_m: ErrorStatistics | None
    relative_deg: ErrorStatistics | None
    every: int
    stretches: tuple[Segments, ...]
    together: Segments
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Aligned:
    """(N, 4, 4) poses of a segment of the log, the estimated ones aligned to the true ones."""

    estimated: Float
    true: Float
    scale: float


def evaluate(run: RunPoses, alignment: Alignment | None, delta: Delta) -> Evaluation:
    """Align a run's poses to the true ones, and measure; all errors are of the aligned poses.

    Args:
        run: the poses.
        alignment: None for ``se3``, and for ``sim3`` where the run is up to scale.
        delta: the relative error's pairs.

    Raises:
        TableError: there is no truth, too few frames have both poses, or they cannot be aligned.
    """
    _require_truth(run)
    chosen = alignment or ("sim3" if run.up_to_scale else "se3")
    aligned, left_out = _aligned(run, chosen)
    relative = [relative_errors(part.estimated, part.true, *pairs(part.estimated, delta)) for part in aligned]
    relative_m, relative_deg = (np.concatenate(part) for part in zip(*relative, strict=True))
    driven_m = [float(path_m(part.true)[-1]) for part in aligned]
    lengths_m, every = (KITTI_LENGTHS_M, KITTI_EVERY) if max(driven_m) > KITTI_LENGTHS_M[0] else (SHORT_LENGTHS_M, 1)
    stretches = [
        [segment_errors(part.estimated, part.true, length_m, every) for part in aligned] for length_m in lengths_m
    ]
    return Evaluation(
        run,
        chosen,
        tuple(part.scale for part in aligned),
        sum(driven_m),
        delta,
        ErrorStatistics.of(np.concatenate([absolute_errors_m(part.estimated, part.true) for part in aligned])),
        ErrorStatistics.of(relative_m) if len(relative_m) else None,
        ErrorStatistics.of(relative_deg) if len(relative_deg) else None,
        every,
        tuple(_segments(length_m, found) for length_m, found in zip(lengths_m, stretches, strict=True)),
        _segments(None, chain.from_iterable(stretches)),
        left_out,
    )


def _require_truth(run: RunPoses) -> None:
    """Check that a segment of the log has enough true poses to judge by."""
    if run.true is None:
        raise TableError(
            f"{run.source}: no figures without truth: none of its {run.frames} frames has a true pose "
            "(true_x_m to true_qw); poses can still be exported"
        )
    most = max((len(part.stamps_ns) for part in run.of_segments.values()), default=0)
    if most < _FEWEST:
        where = " in a segment" if len(run.of_segments) > 1 else ""
        raise TableError(
            f"{run.source}: no figures: expected {_FEWEST} or more frames{where} with an estimated and a true pose, "
            f"found {most} of {run.frames}"
        )


def _aligned(run: RunPoses, how: Alignment) -> tuple[list[_Aligned], tuple[str, ...]]:
    """The segments of the log that can be aligned, and why the others cannot.

    Raises:
        TableError: none can be.
    """
    aligned, refused = [], []
    for number, part in run.of_segments.items():
        try:
            aligned.append(_align_segment(part, how))
        except TableError as error:
            refused.append((number, error))
    if not aligned:
        raise TableError(f"{run.source}: {refused[0][1]}") from refused[0][1]
    return aligned, tuple(f"no figures of segment {number}: {error}" for number, error in refused)


def _align_segment(part: RunPoses, how: Alignment) -> _Aligned:
    frames = len(part.stamps_ns)
    if part.true is None or frames < _FEWEST:
        raise TableError(f"expected {_FEWEST} or more frames with an estimated and a true pose, found {frames}")
    true_S_estimated = align(part.estimated, part.true, how)
    return _Aligned(true_S_estimated.poses(part.estimated), part.true, true_S_estimated.scale)


def _segments(length_m: float | None, errors: Iterable[tuple[Float, Float]]) -> Segments:
    """Means over all stretches, as the benchmark takes them: a length counts by its number of stretches."""
    percent, deg = (np.concatenate(part) for part in zip(*errors, strict=True))
    if not len(percent):
        return Segments(length_m, 0, None, None)
    return Segments(length_m, len(percent), float(percent.mean()), float(deg.mean()))
