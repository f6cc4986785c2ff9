"""The metrics on which two runs are judged: errors against truth, jitter, states, coverage and times."""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import polars as pl

from roadperc_stream.geometry import Float
from roadperc_stream.schemas.columns import RATIO, FrameMetrics, columns_of

from ..report_columns import JITTERS, NUMBERS, OFFSETS, SEEN, SIDES, STAGE_TIMES, TRUTH, Quantity

COVERAGE_RELEVANT: Final = 0.005
TIME_RELEVANT: Final = 0.1
"""Smallest relevant change of a time, as a ratio."""
_SHORTEST_MS: Final = 0.1
"""Shorter times count as this time."""
_DISTANCE: Final = "object_distance_error_m"
_JITTER: Final = "second_difference", "jitter"
"""Part of a derived column's name, and of its metric's."""
_LABELS: Final = {quantity.column.replace(*_JITTER): quantity.name for quantity in NUMBERS}


@dataclass(frozen=True)
class Metric:
    """A number per frame, null where unknown.

    ``--ignore`` matches ``name``. The judged number is the absolute value, or the value itself if high is better. With
    ``share`` the values are booleans. With ``timed`` it is a time in ms, which depends on the machine and is judged on
    request only; ``relevant`` is then a ratio. Metrics of one ``group`` restate one cause.
    """

    name: str
    value: pl.Expr
    group: str
    unit: str = RATIO
    higher_is_better: bool = False
    share: bool = False
    timed: bool = False
    relevant: float = COVERAGE_RELEVANT
    limit: float | None = None

    @property
    def label(self) -> str:
        """The name in words: the label of its column, then the state, the class or ``coverage`` if it has one."""
        column, _, of = self.name.partition(".")
        return f"{_LABELS.get(column, column.replace('_', ' '))} {of}".strip()

    @property
    def sign(self) -> int:
        """1 if a larger judged number is worse, else -1."""
        return -1 if self.higher_is_better else 1

    def judged(self, values: Float) -> Float:
        """The judged numbers of (N,) values; of a time its logarithm, so that one slow frame weighs as any other."""
        if self.timed:
            return np.log(np.maximum(values, _SHORTEST_MS))
        return values if self.higher_is_better else np.abs(values)

    def shown(self, judged: float) -> float:
        """A judged number, or a mean of them, in the metric's unit; of times this is the geometric mean."""
        return math.exp(judged) if self.timed else judged


def _error(quantity: Quantity) -> Metric:
    return Metric(
        quantity.column.replace(*_JITTER),
        pl.col(quantity.column),
        f"{quantity.stage} error",
        quantity.unit,
        quantity.better == "high",
        relevant=quantity.relevant,
        limit=quantity.limit,
    )


def _time(quantity: Quantity) -> Metric:
    value = pl.col(quantity.column)
    return Metric(quantity.column, value, "times", quantity.unit, timed=True, relevant=TIME_RELEVANT)


def _share(name: str, stage: str, holds: pl.Expr) -> Metric:
    return Metric(name, holds, f"{stage} coverage", higher_is_better=True, share=True)


_BEST_STATES: Final = (
    ("surface_source", "depth", "surface"),
    *((f"lane_{side}_status", "measured", "lanes") for side in SIDES),
    ("odometry_status", "tracked", "odometry"),
)
_COVERING: Final = (
    ("surface_source", "surface"),
    *((q.column, q.stage) for q in (*SEEN, *OFFSETS, *TRUTH) if columns_of(FrameMetrics)[q.column].compares_coverage),
)
METRICS: Final = (
    *map(_error, (*TRUTH, *JITTERS)),
    *(_share(f"{name}.{best}", stage, (pl.col(name) == best).fill_null(False)) for name, best, stage in _BEST_STATES),
    *(_share(f"{name}.coverage", stage, pl.col(name).is_not_null()) for name, stage in _COVERING),
    *map(_time, STAGE_TIMES),
)
"""The metrics on which two runs are judged.

Errors against truth and the jitter of lane boundaries are judged over the frames in which both runs have a value.
States and coverage are judged over all common frames, as 1 or 0. For outputs without truth (camera height, lane width,
inliers) neither side is better, so only the comparison of fields shows them.
"""
FRAMES: Final = _share("frames.coverage", "frames", pl.lit(value=True))
"""Share of the base's frames that the new run has."""


def of_class(label: str) -> Metric:
    """The error of the distances of one class of objects; a table of objects has its values."""
    (whole,) = (metric for metric in METRICS if metric.name == _DISTANCE)
    return replace(whole, name=f"{_DISTANCE}.{label}")
