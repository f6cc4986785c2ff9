"""Plots known from other benchmarks: poses over time, error over distance, precision over recall."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.geometry import Float

from ..runs import Run, collect, reading
from .charts import Paths
from .figures import TIME_TITLE, TRUTH_COLOUR, Figure, Series, Trace, colour_of, layout, line, thinned

_AXES: Final = {"x ahead": "m", "y to the left": "m", "z up": "m", "roll": "deg", "pitch": "deg", "yaw": "deg"}
MATCHES_M: Final = (0.5, 1.0, 2.0, 4.0)
"""Largest centre distances of a match, as in nuScenes' detection benchmark."""
DRAWN_M: Final = 2.0
LEAST_RECALL: Final = 0.1
LEAST_PRECISION: Final = 0.1
"""Recalls and precisions below these are left out of the average precision, as in nuScenes."""
_ASIDE_M: Final = pl.col("lateral_m") - pl.col("true_lateral_m")
_COLUMNS: Final = {
    *("frame", "label", "score", "kept", "is_true", "distance_m", "true_distance_m", "lateral_m", "true_lateral_m")
}
_NOTE: Final = (
    f"Matches within {DRAWN_M:g} m of the true centre; AP is the mean over 0.5, 1, 2 and 4 m. "
    "Recall is among objects with a detection, kept or not, because the table lacks objects that the detector missed."
)
Mask = NDArray[np.bool_]

_SCHEMA: Final = {"label": pl.String, "score": pl.Float64, "is_true": pl.Boolean, "off_m": pl.Float64}


def poses_over_time(runs: Sequence[Series], paths: Sequence[Paths]) -> Iterator[Figure]:
    """Position and rotation against the first pose over time, with the truth."""
    several = len(runs) > 1
    for at, (name, unit) in enumerate(_AXES.items()):
        traces = []
        for place, (run, found) in enumerate(zip(runs, paths, strict=True)):
            for which, poses in found.items():
                label, dash = ("truth", "dash") if which == "true" else ("odometry", "solid")
                colour = TRUTH_COLOUR if which == "true" and not several else colour_of(place)
                label, kept = f"{run.name}: {label}" if several else label, thinned(poses[:, at])
                traces.append(line(label, run.since_start_s[kept], poses[kept, at], colour, dash=dash))
        if traces:
            yield Figure(f"Pose: {name}", "Against the first pose.", traces, layout(TIME_TITLE, f"{name}, {unit}"))


def precision_recall(runs: Sequence[Run]) -> Iterator[Figure]:
    """A chart for each class with a curve for each run, from the tables of objects.

    A detection matches if it is true and its centre is within ``DRAWN_M`` of the true one. The table has no objects
    without a detection, so recall is the share of those that the detector found.
    Source: Caesar et al., nuScenes: A multimodal dataset for autonomous driving, 2020, section 3.1.
    """
    tables = [_objects(run) for run in runs]
    for name in sorted({label for table in tables for label in table["label"].unique()}):
        found = [table.filter(pl.col("label") == name) for table in tables]
        pairs = enumerate(zip(runs, found, strict=True))
        traces = [
            _precision(run, rows, at, len(runs) > 1)
            for at, (run, rows) in pairs
            if rows.filter("is_true")["score"].count()
        ]
        if traces:
            axes = layout("recall among detected objects", "precision", hovermode="closest")
            axes["xaxis"]["range"] = axes["yaxis"]["range"] = [0, 1.03]
            yield Figure(f"Precision and recall: {name}", _NOTE, traces, axes)


def _precision(run: Run, rows: pl.DataFrame, place: int, several: bool) -> Trace:
    estimated, true = rows.drop_nulls("score"), int(rows["is_true"].sum())
    off_m, score = estimated["off_m"].to_numpy(), estimated["score"].to_numpy()
    recall, precision = curve(score, off_m <= DRAWN_M, true)
    mean = np.mean([average_precision(*curve(score, off_m <= limit, true)) for limit in MATCHES_M])
    kept = np.unique(np.linspace(0, len(recall) - 1, 200).astype(int))
    label = f"{f'{run.name}: ' if several else ''}AP {mean:.2f}, {true} true detections"
    return line(label, recall[kept], precision[kept], colour_of(place))


def curve(score: Float, matches: Mask, true: int) -> tuple[Float, Float]:
    """(N,) recall of ``true`` objects and precision over the detections in the order of falling score."""
    hits = np.cumsum(matches[np.argsort(-score, kind="stable")])
    return hits / true, hits / np.arange(1, len(hits) + 1)


def average_precision(recall: Float, precision: Float) -> float:
    """The area below the curve above the least recall and precision, from 0 to 1."""
    at = np.linspace(0, 1, 101)
    # of equal recalls the last counts, as in nuScenes' interpolation; beyond the largest recall precision is 0
    sampled = np.interp(at, recall, precision, right=0.0)[at > LEAST_RECALL]
    return float(np.clip(sampled - LEAST_PRECISION, 0, None).mean() / (1 - LEAST_PRECISION))


def _objects(run: Run) -> pl.DataFrame:
    """Class, score, ``is_true`` and ``off_m`` of the detections in logs with true objects.

    Only kept detections with a distance have a score. ``off_m`` is NaN for those that are not true, else it is the
    distance between the estimated and the true centre on the ground, or along the view without a lateral position.
    """
    off = ((pl.col("distance_m") - pl.col("true_distance_m")) ** 2 + _ASIDE_M.fill_null(0.0) ** 2).sqrt()
    off_m = pl.when(pl.col("is_true")).then(off).fill_null(float("nan")).alias("off_m")
    score = pl.when("kept", pl.col("distance_m").is_not_null()).then("score")
    parts = [pl.DataFrame(schema=_SCHEMA)]
    for table in run.tables:
        if (path := table.objects) is None:
            continue
        rows = pl.scan_parquet(path, glob=False)
        with reading(str(path)):
            columns = rows.collect_schema().names()
        if set(columns) >= _COLUMNS:
            end = pl.col("frame") < table.end_frame if table.end_frame is not None else pl.lit(value=True)
            known = rows.filter(pl.col("is_true").is_not_null(), end)
            parts.append(collect(known.select("label", score, "is_true", off_m), str(path)))
    return pl.concat(parts)
