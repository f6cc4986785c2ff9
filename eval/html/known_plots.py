"""Plots known from other benchmarks: poses over time, error over distance, precision over recall."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.geometry import Float
from roadperc_stream.system.files import OBJECTS_SUFFIX

from ..runs import Run, collect
from .charts import Paths
from .figures import TIME_TITLE, TRUTH_COLOUR, Figure, Series, Trace, colour_of, layout, line, thinned

_AXES: Final = {"x ahead": "m", "y to the left": "m", "z up": "m", "roll": "deg", "pitch": "deg", "yaw": "deg"}
MATCHES_M: Final = (0.5, 1.0, 2.0, 4.0)
"""Largest centre distances of a match, as in nuScenes' detection benchmark."""
DRAWN_M: Final = 2.0
LEAST_RECALL: Final = 0.1
LEAST_PRECISION: Final = 0.1
"""Recalls and precisions below these are left out of the average precision, as in nuScenes."""
_OBJECT_COLUMNS: Final = ("frame", "label", "score", "kept", "is_true", "distance_m", "true_distance_m")

_SCHEMA: Final = {"label": pl.String, "score": pl.Float64, "off_m": pl.Float64}


def poses_over_time(runs: Sequence[Series], paths: Sequence[Paths]) -> Iterator[Figure]:
    """Position and rotation against the first pose over time, with the truth."""
    for at, (name, unit) in enumerate(_AXES.items()):
        traces = []
        for place, (run, found) in enumerate(zip(runs, paths, strict=True)):
            for which, poses in found.items():
                kept = thinned(poses[:, at])
                more = _look(which, place, len(runs) > 1)
                traces.append(_line(run, which, run.since_start_s[kept], poses[kept, at], len(runs) > 1, more))
        if traces:
            yield Figure(f"Pose: {name}", "Against the first pose.", traces, layout(TIME_TITLE, f"{name}, {unit}"))


def error_over_distance(runs: Sequence[Series], paths: Sequence[Paths]) -> Iterator[Figure]:
    """Distance between the estimated and the true position over the distance driven; segments follow each other."""
    traces = []
    for place, (run, found) in enumerate(zip(runs, paths, strict=True)):
        if found.keys() >= {"odom", "true"}:
            error_m, true_m = position_error_m(found), found["true"][:, :3]
            known = np.isfinite(error_m)
            steps_m = np.linalg.norm(np.diff(true_m[known], axis=0, prepend=true_m[known][:1]), axis=1)
            steps_m[np.diff(run.segments[known], prepend=run.segments[known][:1]) != 0] = 0.0
            kept = thinned(error_m[known])
            traces.append(line(run.name, np.cumsum(steps_m)[kept], error_m[known][kept], colour_of(place)))
    if traces:
        note = "Error of the position, without alignment: both paths begin at one pose."
        look = layout("distance driven, m", "position error, m", showlegend=len(runs) > 1)
        yield Figure("Position error over distance", note, traces, look)


def position_error_m(paths: Paths) -> Float:
    """(N,) distances between the estimated and the true positions; NaN where one is unknown."""
    error_m: Float = np.linalg.norm(paths["odom"][:, :3] - paths["true"][:, :3], axis=1)
    return error_m


def precision_recall(runs: Sequence[Run]) -> Iterator[Figure]:
    """A chart for each class with a curve for each run, from the tables of objects.

    A detection matches if it is true and its centre is within ``DRAWN_M`` of the true one. The table has no objects
    without a detection, so recall is the share of those that the detector found.
    Source: Caesar et al., nuScenes: A multimodal dataset for autonomous driving, 2020, section 3.1.
    """
    tables = [_objects(run) for run in runs]
    labels = sorted({label for table in tables for label in table["label"].unique()})
    for name in labels:
        traces = []
        for place, (run, table) in enumerate(zip(runs, tables, strict=True)):
            rows = table.filter(pl.col("label") == name)
            off_m, score = rows["off_m"].to_numpy(), rows["score"].to_numpy()
            found = int(np.isfinite(off_m).sum())
            if found:
                recall, precision = curve(score, off_m <= DRAWN_M, found)
                kept = np.unique(np.linspace(0, len(recall) - 1, 200).astype(int))
                precisions = [average_precision(*curve(score, off_m <= limit, found)) for limit in MATCHES_M]
                label = f"{run.name}: " if len(runs) > 1 else ""
                label += f"AP {np.mean(precisions):.2f} over {found} true detections"
                traces.append(line(label, recall[kept], precision[kept], colour_of(place)))
        if traces:
            note = f"Matches within {DRAWN_M:g} m of the true centre; AP is the mean over 0.5, 1, 2 and 4 m. "
            note += "Recall is among objects with a detection: the table lacks objects that the detector missed."
            axes = layout("recall among detected objects", "precision", hovermode="closest")
            for one in ("xaxis", "yaxis"):
                axes[one]["range"] = [0, 1.03]
            yield Figure(f"Precision and recall: {name}", note, traces, axes)


def curve(score: Float, matches: NDArray[np.bool_], found: int) -> tuple[Float, Float]:
    """(N,) recall and precision over the detections in the order of falling score; ``found`` true ones in all."""
    hits = np.cumsum(matches[np.argsort(-score, kind="stable")])
    return hits / found, hits / np.arange(1, len(hits) + 1)


def average_precision(recall: Float, precision: Float) -> float:
    """The area below the curve above the least recall and precision, from 0 to 1."""
    at = np.linspace(0, 1, 101)
    # of equal recalls the last counts, as in nuScenes' interpolation; beyond the largest recall precision is 0
    sampled = np.interp(at, recall, precision, right=0.0)[at > LEAST_RECALL]
    return float(np.clip(sampled - LEAST_PRECISION, 0, None).mean() / (1 - LEAST_PRECISION))


def _objects(run: Run) -> pl.DataFrame:
    """Class, score and ``off_m`` of the kept detections with a distance; NaN as ``off_m`` of those that are not true.

    ``off_m`` is the distance between the estimated and the true centre on the ground, or along the view if the lateral
    position is unknown.
    """
    parts = []
    for table in run.tables:
        path = table.beside(OBJECTS_SUFFIX)
        if path.is_file():
            rows = pl.scan_parquet(path, glob=False)
            columns = rows.collect_schema().names()
            if set(_OBJECT_COLUMNS) <= set(columns):
                lateral = ["lateral_m", "true_lateral_m"]
                aside = pl.col(lateral[0]) - pl.col(lateral[1]) if set(lateral) <= set(columns) else pl.lit(0.0)
                off = ((pl.col("distance_m") - pl.col("true_distance_m")) ** 2 + aside.fill_null(0.0) ** 2).sqrt()
                rows = rows.filter(pl.col("kept"), pl.col("distance_m").is_not_null(), pl.col("score").is_not_null())
                if table.end_frame is not None:
                    rows = rows.filter(pl.col("frame") < table.end_frame)
                true = pl.when(pl.col("is_true")).then(off).fill_null(float("nan")).cast(pl.Float64)
                parts.append(collect(rows.select("label", "score", true.alias("off_m")), str(path)))
    return (
        pl.concat(parts)
        if parts
        else pl.DataFrame(schema={"label": pl.String, "score": pl.Float64, "off_m": pl.Float64})
    )


def _look(which: str, place: int, several: bool) -> tuple[str, str]:
    """Colour and dash of a path."""
    truth = which == "true"
    return TRUTH_COLOUR if truth and not several else colour_of(place), "dash" if truth else "solid"


def _line(run: Series, which: str, x: Float, y: Float, several: bool, look: tuple[str, str]) -> Trace:
    name = {"odom": "odometry", "true": "truth"}[which]
    name = f"{run.name}: {name}" if several else name
    return line(name, x, y, look[0], dash=look[1], width=1.6)
