"""Differences of two runs of one log, frame by frame, from the metrics in their logs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from roadperc_stream import log
from roadperc_stream.errors import LogError
from roadperc_stream.geometry import Float
from roadperc_stream.input.stream import Problems
from roadperc_stream.schemas.columns import UNITLESS, Column, FrameMetrics, columns_of
from roadperc_stream.system.text import number
from roadperc_stream.view.frame_times import Stop, timed_rows

_JUDGED: Final[Mapping[str, Column]] = {name: c for name, c in columns_of(FrameMetrics).items() if c.better}


@dataclass(frozen=True)
class MetricDifference:
    """The new run minus the base in a column, of absolute values if values near 0 are better.

    ``times_ns`` (N,) int64 are log times of the base, ``values`` (N,) the differences. ``worst`` is the frame in which
    the new run is worse by most, with both values; None if it is nowhere worse by a relevant effect.
    """

    name: str
    times_ns: "np.ndarray[tuple[int], np.dtype[np.int64]]"
    values: Float
    worst: Stop | None
    base: float = 0.0
    new: float = 0.0

    @property
    def unit(self) -> str:
        """The unit of the values."""
        return _JUDGED[self.name].unit

    @property
    def weight(self) -> float:
        """The largest difference, as a multiple of the smallest relevant one."""
        return float(np.abs(self.values).max()) / (_JUDGED[self.name].relevant or 1.0)

    @property
    def worst_weight(self) -> float:
        """By how much the new run is worse in its worst frame, as a multiple of the smallest relevant effect."""
        return abs(abs(self.new) - abs(self.base)) / (_JUDGED[self.name].relevant or 1.0)

    @property
    def text(self) -> str:
        """The worst difference, as a row of a Markdown table."""
        unit = "" if self.unit in UNITLESS else f" {self.unit}"
        return f"| {self.worst and self.worst.frame} | {self.name} | {self.base:.4g}{unit} | {self.new:.4g}{unit} |"


def find_differences(base: Path, new: Path) -> list[MetricDifference]:
    """The columns with a relevant difference, the largest worsening first. Frames pair by their stamps.

    Raises:
        LogError: a log cannot be read, or no frame of the base is in the new run.
    """
    problems = Problems()
    theirs = {row.stamp_ns: row for _, row in timed_rows(log.summarise(new), problems)}
    ours = list(timed_rows(log.summarise(base), problems))
    pairs = [(time_ns, row, theirs[row.stamp_ns]) for time_ns, row in ours if row.stamp_ns in theirs]
    if not pairs:
        found = f"{number(len(ours), 'frame')} and {number(len(theirs), 'frame')}"
        raise LogError(
            f"{base} and {new}: no frame has the same stamp in both runs ({found}); expected runs of one log"
        )
    differences = (_difference(name, column, pairs) for name, column in _JUDGED.items())
    relevant = [found for found in differences if found is not None]
    return sorted(relevant, key=lambda found: (-found.worst_weight, -found.weight))


def _difference(
    name: str, column: Column, pairs: list[tuple[int, FrameMetrics, FrameMetrics]]
) -> MetricDifference | None:
    """The difference in a column; None if it is nowhere relevant."""
    rows = [(t, row.frame, getattr(row, name), getattr(other, name)) for t, row, other in pairs]
    known = [row for row in rows if row[2] is not None and row[3] is not None]
    if not known:
        return None
    base, new = (np.array([row[side] for row in known], float) for side in (2, 3))
    values = np.abs(new) - np.abs(base) if column.better == "near 0" else new - base
    if not np.abs(values).max() >= max(column.relevant, 1e-12):
        return None
    worse = -values if column.better == "high" else values
    at = int(worse.argmax())
    times_ns = np.array([row[0] for row in known], np.int64)
    if worse[at] < max(column.relevant, 1e-12):
        return MetricDifference(name, times_ns, values, None)
    return MetricDifference(name, times_ns, values, Stop(known[at][1], known[at][0]), float(base[at]), float(new[at]))
