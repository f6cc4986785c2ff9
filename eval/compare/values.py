"""Reads the values of every metric in the common frames of two runs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.geometry import Float

from ..runs import Run, collect, reading
from ..scan import scan
from .agreement import Overlap
from .metrics import FRAMES, METRICS, Metric, of_class
from .pairing import KEY, NEW, STAMP, RunPair, numbered
from .verdicts import Place

_FRAME: Final = "frame"
_OBJECT_COLUMNS: Final = frozenset({_FRAME, "label", "kept", "distance_m", "true_distance_m"})


@dataclass(frozen=True)
class LogValues:
    """A metric's values in the common frames of a pair: (N,) float64 each, the frames' numbers and stamps beside them.

    ``base`` and ``new`` are signed. ``frames`` are the new run's.
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

    def place(self) -> Place | None:
        """The frame in which the new run is worse by most; None if no frame is worse, or its number is unknown."""
        at = int(self.rises.argmax())
        if self.rises[at] <= 0 or self.frames[at] < 0:
            return None
        base, new = (self.metric.shown(float(side[at])) for side in self.judged)
        return Place(self.pair, int(self.frames[at]), int(self.stamps_ns[at]), base, new)


def values_of(pairs: Sequence[RunPair], overlaps: Sequence[Overlap]) -> list[list[LogValues]]:
    """For each metric with a value in any pair, its values in the pairs that have one.

    Raises:
        TableError: a table's data cannot be read.
    """
    joined = [_joined(pair) for pair in pairs]
    labels = sorted(set[str]().union(*(found for _, found in joined)))
    metrics = [*METRICS, *map(of_class, labels)]
    every = [[_kept(pair, found) for pair, found in zip(pairs, overlaps, strict=True)]]
    every += [[_values(metric, *one) for one in zip(pairs, joined, strict=True)] for metric in metrics]
    known = ([log for log in logs if log.base.size] for logs in every)
    return [logs for logs in known if logs]


def _joined(pair: RunPair) -> tuple[pl.DataFrame, set[str]]:
    """The metrics of the common frames, and the classes of objects with known distances in both runs."""
    (ours, first), (theirs, second) = (_measured(run, pair.by_segment) for run in (pair.base, pair.new))
    return ours.join(theirs, on=KEY, suffix=NEW).sort(KEY), first & second


def _measured(run: Run, by_segment: bool) -> tuple[pl.DataFrame, set[str]]:
    values = [metric.value.alias(metric.name) for metric in METRICS]
    frames = collect(numbered(scan(run), by_segment).select(*KEY, _FRAME, *values), run.source_name)
    classes = _class_errors(run)
    if classes is None:
        return frames, set()
    labels = set(classes.columns) - {_FRAME}
    named = classes.rename({label: of_class(label).name for label in labels})
    return frames.join(named, on=_FRAME, how="left", maintain_order="left"), labels


def _class_errors(run: Run) -> pl.DataFrame | None:
    """Mean absolute error of the distance per frame, a column for each class; None without tables of objects."""
    parts = []
    for table in run.tables:
        if (path := table.objects) is None:
            continue
        rows = pl.scan_parquet(path, glob=False)
        with reading(str(path)):
            present = rows.collect_schema().names()
        if not _OBJECT_COLUMNS.issubset(present):
            continue
        if table.end_frame is not None:
            rows = rows.filter(pl.col(_FRAME) < table.end_frame)
        error = (pl.col("distance_m") - pl.col("true_distance_m")).abs()
        known = rows.filter(pl.col("kept"), error.is_finite())
        parts.append(collect(known.group_by(pl.col(_FRAME).cast(pl.Int64), "label").agg(error.mean()), str(path)))
    whole = pl.concat(parts) if parts else None
    return whole.pivot("label", index=_FRAME, values="distance_m") if whole is not None and whole.height else None


def _values(metric: Metric, pair: RunPair, joined: tuple[pl.DataFrame, set[str]]) -> LogValues:
    table = joined[0]
    if not {metric.name, metric.name + NEW} <= set(table.columns):
        table = table.head(0).with_columns(pl.lit(0.0).alias(metric.name), pl.lit(0.0).alias(metric.name + NEW))
    known = table.select(_FRAME + NEW, STAMP, metric.name, metric.name + NEW).drop_nulls()
    base, new = (known[name].cast(pl.Float64).to_numpy() for name in (metric.name, metric.name + NEW))
    return LogValues(metric, pair, known[_FRAME + NEW].to_numpy(), known[STAMP].to_numpy(), base, new)


def _kept(pair: RunPair, found: Overlap) -> LogValues:
    """The base's frames as 1, and whether the new run has them; without their numbers."""
    unknown = np.full(found.common + found.only_base, -1)
    kept = np.repeat([1.0, 0.0], found[:2])
    return LogValues(FRAMES, pair, unknown, unknown, np.ones(unknown.size), kept)
