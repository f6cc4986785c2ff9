"""Differences of two runs of one log, frame by frame, from the metrics in their logs."""

from dataclasses import dataclass

import numpy as np

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.geometry import Float
from roadperc_stream.input.stream import Problems
from roadperc_stream.schemas.columns import Column, FrameMetrics, columns_of
from roadperc_stream.view.frame_times import Stop
from roadperc_stream.view.result_frames import read_rows


@dataclass(frozen=True)
class MetricDifference:
    """The new run minus the base in a column, of absolute values if values near 0 are better.

    ``times_ns`` (N,) int64 are log times of the base, ``values`` (N,) the differences. ``worst`` is the frame in which
    the new run is worse by most, ``worsening`` by how much, in smallest relevant effects, and ``text`` a line with both
    values. ``worst`` is None if the new run is nowhere worse by a relevant effect.
    """

    name: str
    column: Column
    times_ns: "np.ndarray[tuple[int], np.dtype[np.int64]]"
    values: Float
    worst: Stop | None
    worsening: float
    text: str


def find_differences(base: log.AnyLog, new: log.AnyLog) -> list[MetricDifference]:
    """The columns with a relevant difference, the largest worsening first. Frames pair by their stamps.

    Raises:
        LogError: a log cannot be read, or no frame of the base is in the new run.
    """
    problems = Problems()
    theirs = {row.stamp_ns: row for _, row in read_rows(log.summarise(new), problems)}
    ours = read_rows(log.summarise(base), problems)
    pairs = [(time_ns, row, theirs[row.stamp_ns]) for time_ns, row in ours if row.stamp_ns in theirs]
    if not pairs:
        raise LogError(f"{base} and {new}: no frame has the same stamp in both runs; expected runs of one log")
    columns = {name: column for name, column in columns_of(FrameMetrics).items() if column.better and column.relevant}
    differences = (_difference(name, column, pairs) for name, column in columns.items())
    return sorted((found for found in differences if found is not None), key=lambda found: -found.worsening)


def _difference(
    name: str, column: Column, pairs: list[tuple[int, FrameMetrics, FrameMetrics]]
) -> MetricDifference | None:
    """The difference in a column; None if it is nowhere relevant."""
    rows = [(t, row, getattr(row, name), getattr(other, name)) for t, row, other in pairs]
    known = [row for row in rows if row[2] is not None and row[3] is not None]
    if not known:
        return None
    base, new = (np.array([row[side] for row in known], float) for side in (2, 3))
    values = np.abs(new) - np.abs(base) if column.better == "near 0" else new - base
    effects = (-values if column.better == "high" else values) / column.relevant
    if np.abs(effects).max() < 1:
        return None
    at = int(effects.argmax())
    time_ns, row, *_ = known[at]
    worst = Stop(row.frame, time_ns, row.stamp_ns) if effects[at] >= 1 else None
    text = f"frame {row.frame}: {name} {base[at]:.4g} to {new[at]:.4g}"
    times_ns = np.array([row[0] for row in known], np.int64)
    return MetricDifference(name, column, times_ns, values, worst, float(effects[at]), text)
