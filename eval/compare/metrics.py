"""The metrics on which two runs are judged, and their values in the common frames of two runs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.geometry import Float
from roadperc_stream.model.tag_tables import LABEL_CLASSES
from roadperc_stream.schemas.columns import RATIO, FrameMetrics, columns_of
from roadperc_stream.schemas.columns.hindsight import FrameHindsight

from ..objects.figures import BANDS_S, RINGS_M, frame_values, parts_of
from ..report_columns import ERRORS, JITTERS, NUMBERS, OFFSETS, SEEN, SIDES, STAGE_TIMES, TRUTH_OF, Quantity
from ..runs import Run, collect
from ..scan import objects_of, scan
from .fields import Overlap
from .pairing import KEY, NEW, STAMP, RunPair, numbered

COVERAGE_RELEVANT: Final = 0.005
TIME_RELEVANT: Final = 0.1
"""Smallest relevant change of a time, as a ratio."""
_SHORTEST_MS: Final = 0.1
"""Shorter times count as this time."""
_FRAME: Final = "frame"
CLASSES: Final = tuple(dict.fromkeys(first for first, *_ in LABEL_CLASSES.values()))
_DISTANCE: Final = "object_distance_error_m"
_JITTER: Final = "second_difference", "jitter"
"""Part of a derived column's name, and of its metric's."""
_LABELS: Final = {
    **{quantity.column.replace(*_JITTER): quantity.name for quantity in NUMBERS},
    "objects_ap": "objects AP",
    "objects_ate_m": "objects ATE",
    "objects_ave_mps": "objects AVE",
    **{f"tracks_{name}": f"tracks {name.upper()}" for name in ("hota", "mota", "idf1")},
    "tracks_deta": "tracks DetA",
    "tracks_assa": "tracks AssA",
    "objects_recall": "recall of objects in the path at",
}


@dataclass(frozen=True)
class Metric:
    """A number per frame, null where unknown.

    ``--ignore`` matches ``name``. The judged number is the absolute value, or the value itself if high is better. With
    ``share`` the values are booleans. With ``timed`` it is a time in ms, which depends on the machine and is judged on
    request only; ``relevant`` is then a ratio. With ``whole`` it is a figure of all frames together: the values are
    what each frame contributes, and only their mean is judged. Metrics of one ``group`` restate one cause.
    """

    name: str
    value: pl.Expr
    group: str
    unit: str = RATIO
    higher_is_better: bool = False
    share: bool = False
    timed: bool = False
    whole: bool = False
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
        return values if self.higher_is_better or self.whole else np.abs(values)

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
_DECLARED: Final = {**columns_of(FrameMetrics), **columns_of(FrameHindsight)}
_COVERING: Final = (
    ("surface_source", "surface"),
    *((q.column, q.stage) for q in (*SEEN, *OFFSETS, *ERRORS) if _DECLARED[q.column].compares_coverage),
)


def _whole(name: str, group: str, relevant: float, unit: str = RATIO) -> Metric:
    return Metric(name, pl.lit(None, pl.Float64), group, unit, unit == RATIO, whole=True, relevant=relevant)


OF_OBJECTS: Final = (
    *(
        _whole(name, "object detection", 0.01)
        for name in ("objects_ap", *(f"objects_ap.{of}" for of in (*CLASSES, *filter(None, RINGS_M))))
    ),
    _whole("objects_ate_m", "object detection", 0.05, "m"),
    _whole("objects_ave_mps", "object detection", 0.1, "m/s"),
    *(_whole(f"objects_recall.{band}", "objects in the path", 0.01) for band in BANDS_S),
    *(_whole(f"tracks_{name}", "object tracks", 0.01) for name in ("hota", "deta", "assa", "mota", "idf1")),
)
"""The figures of ``eval/objects/``, which need all true objects."""
METRICS: Final = (
    *map(_error, (*ERRORS, *JITTERS)),
    *(_share(f"{name}.{best}", stage, (pl.col(name) == best).fill_null(False)) for name, best, stage in _BEST_STATES),
    *(_share(f"{name}.coverage", stage, pl.col(name).is_not_null()) for name, stage in _COVERING),
    *map(_time, STAGE_TIMES),
    *OF_OBJECTS,
)
"""The metrics on which two runs are judged.

Errors and the jitter of lane boundaries are judged over the frames in which both runs have a value; errors by
hindsight only without the truth of the same output.
States and coverage are judged over all common frames, as 1 or 0. A frame covers the time to impact by hindsight if a
smoothed track confirms that the object nears. For outputs without truth (camera height, lane width,
inliers) neither side is better, so only the comparison of fields shows them.
"""
FRAMES: Final = _share("frames.coverage", "frames", pl.lit(value=True))
"""Share of the base's frames that the new run has."""


def _of_class(label: str) -> Metric:
    """The error of the distances of one class of objects; a table of objects has its values."""
    (whole,) = (metric for metric in METRICS if metric.name == _DISTANCE)
    return replace(whole, name=f"{_DISTANCE}.{label}")


@dataclass(frozen=True)
class LogValues:
    """A metric's values in the common frames of a pair: (N,) float64 each, the frames' numbers and stamps beside them.

    ``base`` and ``new`` are signed. ``frames`` are the new run's, -1 if unknown.
    """

    metric: Metric
    pair: RunPair
    frames: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    base: Float
    new: Float

    @property
    def judged(self) -> tuple[Float, Float]:
        """Base and new by which frames are judged, see ``Metric.judged``."""
        return self.metric.judged(self.base), self.metric.judged(self.new)

    @property
    def differences(self) -> Float:
        """New minus base of the judged values, (N,)."""
        base, new = self.judged
        return new - base

    @property
    def rises(self) -> Float:
        """Amount by which each frame became worse, (N,)."""
        return self.metric.sign * self.differences


def values_of(pairs: Sequence[RunPair], overlaps: Sequence[Overlap]) -> list[list[LogValues]]:
    """For each metric with a value in any pair, its values in the pairs that have one.

    Raises:
        TableError: a table's data cannot be read.
    """
    joined = [_joined(pair, parts_of(len(pairs))) for pair in pairs]
    labels = sorted(set[str]().union(*(found for _, found in joined)))
    every = [[_kept(pair, found) for pair, found in zip(pairs, overlaps, strict=True)]]
    every += [
        [_values(metric, pair, table) for pair, (table, _) in zip(pairs, joined, strict=True)]
        for metric in (*METRICS, *map(_of_class, labels))
    ]
    known = [logs for found in every if (logs := [log for log in found if log.base.size]) and _has_output(logs)]
    names = {logs[0].metric.name for logs in known}
    return [logs for logs in known if _of_truth(logs[0].metric.name) not in names]


def _has_output(logs: Sequence[LogValues]) -> bool:
    """Whether any run has the output: a share of 0 in both runs means that neither has it."""
    return not logs[0].metric.share or any(log.base.any() or log.new.any() for log in logs)


def _of_truth(name: str) -> str:
    """The metric against truth of a metric by hindsight; empty for other metrics."""
    column, dot, of = name.partition(".")
    return f"{TRUTH_OF[column]}{dot}{of}" if column in TRUTH_OF else ""


def _joined(pair: RunPair, parts: int) -> tuple[pl.DataFrame, set[str]]:
    """The metrics of the common frames, and the classes of objects with known distances in both runs."""
    (ours, first), (theirs, second) = (_measured(run, pair.by_segment) for run in (pair.base, pair.new))
    joined = ours.join(theirs, on=KEY, suffix=NEW).sort(KEY)
    for run, side in ((pair.base, ""), (pair.new, NEW)):
        values = frame_values(run, joined[_FRAME + side].to_numpy(), parts)
        joined = joined.with_columns(pl.Series(name + side, of) for name, of in values.items())
    return joined, first & second


def _measured(run: Run, by_segment: bool) -> tuple[pl.DataFrame, set[str]]:
    values = [metric.value.alias(metric.name) for metric in METRICS if not metric.whole]
    frames = collect(numbered(scan(run), by_segment).select(*KEY, _FRAME, *values), run.source_name)
    classes = _class_errors(run)
    if classes is None:
        return frames, set()
    labels = set(classes.columns) - {_FRAME}
    named = classes.rename({label: _of_class(label).name for label in labels})
    return frames.join(named, on=_FRAME, how="left", maintain_order="left"), labels


def _class_errors(run: Run) -> pl.DataFrame | None:
    """Mean absolute error of the distance per frame, a column for each class; None without tables of objects."""
    parts = []
    for table in run.tables:
        if (path := table.objects) is None:
            continue
        error = (pl.col("distance_m") - pl.col("true_distance_m")).abs()
        known = objects_of(run.name, table, path).filter(pl.col("kept"), error.is_finite())
        parts.append(collect(known.group_by(pl.col(_FRAME).cast(pl.Int64), "label").agg(error.mean()), str(path)))
    whole = pl.concat(parts) if parts else None
    return whole.pivot("label", index=_FRAME, values="distance_m") if whole is not None and whole.height else None


def _values(metric: Metric, pair: RunPair, table: pl.DataFrame) -> LogValues:
    names = metric.name, metric.name + NEW
    if not set(names) <= set(table.columns):
        table = table.head(0).with_columns(pl.lit(0.0).alias(name) for name in names)
    known = table.select(_FRAME + NEW, STAMP, *names).drop_nulls()
    base, new = (known[name].cast(pl.Float64).to_numpy() for name in names)
    return LogValues(metric, pair, known[_FRAME + NEW].to_numpy(), known[STAMP].to_numpy(), base, new)


def _kept(pair: RunPair, found: Overlap) -> LogValues:
    """The base's frames as 1, and whether the new run has them; without their numbers."""
    unknown = np.full(found.common + found.only_base, -1)
    kept = np.repeat([1.0, 0.0], found[:2])
    return LogValues(FRAMES, pair, unknown, unknown, np.ones(unknown.size), kept)
