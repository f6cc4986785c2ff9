"""Evaluates the poses of a run against truth."""

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
"""Lengths for logs shorter than 100 m; a stretch then begins at every frame."""
_FEWEST: Final = 3
"""Fewest poses to align."""


@dataclass(frozen=True)
class Segments:
    """KITTI's errors over all stretches of one length, or of all lengths; None without stretches."""

    length_m: float | None
    count: int
    translation_percent: float | None
    rotation_deg_per_100m: float | None


@dataclass(frozen=True)
class Evaluation:
    """Trajectory errors of one run.

    Each segment of the log is aligned separately; ``left_out`` names those without figures.
    ``driven_m`` is the length of the true paths, ``scales`` the factor applied to the estimate of each segment.
    ``relative_m`` and ``relative_deg`` are None if no pair of poses is ``delta`` apart. ``stretches`` has KITTI errors
    by length, ``together`` over all lengths.
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


def evaluate(run: RunPoses, alignment: Alignment | None, delta: Delta) -> Evaluation:
    """Errors of a run's poses after alignment to the true ones.

    The default ``alignment`` is ``se3``, or ``sim3`` if the run is up to scale. ``delta`` is for the relative error.

    Raises:
        TableError: there is no truth, too few frames have both poses, or they cannot be aligned.
    """
    if run.true is None:
        raise TableError(
            f"{run.source}: no errors without truth: none of {run.frames} frames has a true pose "
            "(true_x_m to true_qw); poses can still be exported"
        )
    chosen = alignment or ("sim3" if run.up_to_scale else "se3")
    paths, scales, left_out = _aligned(run, chosen)
    relative = [relative_errors(*path, *pairs(path[0], delta)) for path in paths]
    relative_m, relative_deg = (np.concatenate(part) for part in zip(*relative, strict=True))
    driven_m = [float(path_m(true)[-1]) for _, true in paths]
    lengths_m, every = (KITTI_LENGTHS_M, KITTI_EVERY) if max(driven_m) > KITTI_LENGTHS_M[0] else (SHORT_LENGTHS_M, 1)
    stretches = [[segment_errors(*path, length_m, every) for path in paths] for length_m in lengths_m]
    return Evaluation(
        run,
        chosen,
        scales,
        sum(driven_m),
        delta,
        ErrorStatistics.of(np.concatenate([absolute_errors_m(*path) for path in paths])),
        ErrorStatistics.of(relative_m) if len(relative_m) else None,
        ErrorStatistics.of(relative_deg) if len(relative_deg) else None,
        every,
        tuple(_segments(length_m, found) for length_m, found in zip(lengths_m, stretches, strict=True)),
        _segments(None, chain.from_iterable(stretches)),
        left_out,
    )


def _aligned(
    run: RunPoses, alignment: Alignment
) -> tuple[list[tuple[Float, Float]], tuple[float, ...], tuple[str, ...]]:
    """(N, 4, 4) aligned and true poses of each segment, their scales, and notes on segments that cannot be aligned.

    Raises:
        TableError: no segment can be aligned.
    """
    paths, scales, refused = [], [], {}
    for number, part in run.of_segments.items():
        try:
            if part.true is None or len(part.true) < _FEWEST:
                found = f"found {len(part.stamps_ns)}"
                raise TableError(f"expected {_FEWEST} or more frames with an estimated and a true pose, {found}")  # noqa: TRY301
            true_S_estimated = align(part.estimated, part.true, alignment)
        except TableError as error:
            refused[number] = str(error)
        else:
            paths.append((true_S_estimated.poses(part.estimated), part.true))
            scales.append(true_S_estimated.scale)
    if not paths:
        why = next(iter(refused.values()), f"no frame of {run.frames} has an estimated and a true pose")
        raise TableError(f"{run.source}: {why}")
    return paths, tuple(scales), tuple(f"no errors of segment {number}: {why}" for number, why in refused.items())


def _segments(length_m: float | None, errors: Iterable[tuple[Float, Float]]) -> Segments:
    """Means over all stretches; as in the benchmark, each stretch has the same weight."""
    percent, deg = (np.concatenate(part) for part in zip(*errors, strict=True))
    if not len(percent):
        return Segments(length_m, 0, None, None)
    return Segments(length_m, len(percent), float(percent.mean()), float(deg.mean()))
