"""Plots known from other benchmarks: poses over time, error over distance, precision over recall."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from roadperc_stream.geometry import Float
from roadperc_stream.metrics.objects import same_kind
from roadperc_stream.system.text import number

from ..runs import Run, collect, reading
from ..scan import rows_of
from .charts import Paths, without_scale
from .figures import TIME_TITLE, TRUTH_COLOUR, Figure, Series, Trace, colour_of, layout, line, thinned

_AXES: Final = {"x ahead": "m", "y to the left": "m", "z up": "m", "roll": "deg", "pitch": "deg", "yaw": "deg"}
MATCHES_M: Final = (0.5, 1.0, 2.0, 4.0)
"""Largest centre distances of a match, as in nuScenes' detection benchmark."""
DRAWN_M: Final = 2.0
LEAST_RECALL: Final = 0.1
LEAST_PRECISION: Final = 0.1
"""Recalls and precisions below these are left out of the average precision, as in nuScenes."""
_PLACE: Final = ("distance_m", "lateral_m")
_COLUMNS: Final = {"frame", "label", "score", "kept", "true_lateral_m", *_PLACE}
_TRUTH: Final = ("true_object_labels", "true_object_distances_m", "true_object_laterals_m")
_NOTE: Final = (
    f"Matches within {DRAWN_M:g} m of the true place; AP is the mean over 0.5, 1, 2 and 4 m. "
    "Recall is among all true objects, also those without a detection."
)
_PLACED: Final = {"frame": pl.Int64, "label": pl.String, **dict.fromkeys(_PLACE, pl.Float64)}
Mask = NDArray[np.bool_]


def poses_over_time(runs: Sequence[Series], paths: Sequence[Paths]) -> Iterator[Figure]:
    """Position and rotation against the first pose over time, with the truth."""
    several, scaled = len(runs) > 1, not any(map(without_scale, runs))
    for at, (name, unit) in enumerate(_AXES.items()):
        traces = []
        for place, (run, found) in enumerate(zip(runs, paths, strict=True)):
            for which, poses in found.items():
                label, dash = ("truth", "dash") if which == "true" else ("odometry", "solid")
                colour = TRUTH_COLOUR if which == "true" and not several else colour_of(place)
                label, kept = f"{run.name}: {label}" if several else label, thinned(poses[:, at])
                more = {"dash": dash, "showlegend": dash == "solid" or not several}
                traces.append(line(label, run.since_start_s[kept], poses[kept, at], colour, **more))
        if traces:
            note = "Against the first pose. The truth is dashed."
            yield Figure(
                f"Pose: {name}",
                note,
                traces,
                layout(TIME_TITLE, f"{name}, {unit if scaled or unit == 'deg' else 'no scale'}"),
            )


def precision_recall(runs: Sequence[Run]) -> Iterator[Figure]:
    """A chart for each class with a curve for each run, over all true objects.

    Kept detections with a distance are matched in the order of falling score: each with the nearest free true object
    of its kind.
    Source: Caesar et al., nuScenes: A multimodal dataset for autonomous driving, 2020, section 3.1.
    """
    tables = [(run, _detections(run), _true_objects(run)) for run in runs]
    found = sorted({label for _, detections, _ in tables for label in detections["label"]})
    missed = {label for *_, true in tables for label in true["label"] if not any(same_kind(label, a) for a in found)}
    for name in sorted({*found, *missed}):
        of_kind = [pl.col("label").map_elements(partial(same_kind, name), pl.Boolean)]
        traces = [
            _precision(run, place, detections.filter(label=name), true.filter(of_kind), several=len(runs) > 1)
            for place, (run, detections, true) in enumerate(tables)
            if true.filter(of_kind).height
        ]
        if traces:
            axes = layout("recall", "precision", hovermode="closest")
            axes["xaxis"]["range"] = axes["yaxis"]["range"] = [0, 1.03]
            yield Figure(f"Precision and recall: {name}", _NOTE, traces, axes)


def _precision(run: Run, place: int, found: pl.DataFrame, true: pl.DataFrame, *, several: bool) -> Trace:
    curves = [curve(found["score"].to_numpy(), matched(found, true, limit_m), true.height) for limit_m in MATCHES_M]
    recall, precision = curves[MATCHES_M.index(DRAWN_M)]
    mean = np.mean([average_precision(*item) for item in curves])
    kept = np.unique(np.linspace(0, len(recall) - 1, 200).astype(int))
    label = f"{f'{run.name}: ' if several else ''}AP {mean:.2f}, {number(true.height, 'true object')}"
    return line(label, recall[kept], precision[kept], colour_of(place))


def matched(found: pl.DataFrame, true: pl.DataFrame, limit_m: float) -> Mask:
    """(N,) True for each detection that is the first, by falling score, within ``limit_m`` of a free true object.

    Both tables have ``_PLACED`` columns, ``found`` also ``score``. Unknown lateral positions count as equal.
    """
    pairs = found.with_row_index("one").join(true.with_row_index("other"), on="frame", suffix="_true")
    off_m = sum(((pl.col(name) - pl.col(f"{name}_true")) ** 2).fill_null(0.0) for name in _PLACE) ** 0.5
    near = pairs.with_columns(off_m=off_m).filter(pl.col("off_m") < limit_m)
    ranked = near.sort("score", "one", "off_m", descending=[True, False, False])
    hits, taken = np.zeros(found.height, bool), np.zeros(true.height, bool)
    for one, other in ranked.select("one", "other").iter_rows():
        if not hits[one] and not taken[other]:
            hits[one] = taken[other] = True
    return hits


def curve(score: Float, matches: Mask, true: int) -> tuple[Float, Float]:
    """(N,) recall of ``true`` objects and precision over the detections by falling score; 0 without any."""
    if not len(score):
        return np.zeros(1), np.zeros(1)
    hits = np.cumsum(matches[np.argsort(-score, kind="stable")])
    return hits / true, hits / np.arange(1, len(hits) + 1)


def average_precision(recall: Float, precision: Float) -> float:
    """The area below the curve above the least recall and precision, from 0 to 1."""
    at = np.linspace(0, 1, 101)
    # of equal recalls the last counts, as in nuScenes' interpolation; beyond the largest recall precision is 0
    sampled = np.interp(at, recall, precision, right=0.0)[at > LEAST_RECALL]
    return float(np.clip(sampled - LEAST_PRECISION, 0, None).mean() / (1 - LEAST_PRECISION))


def _detections(run: Run) -> pl.DataFrame:
    """Class, place and score of the kept detections with a distance.

    An unknown lateral position is that of the true object whose box overlaps.
    """
    parts = [pl.DataFrame(schema=_PLACED | {"score": pl.Float64})]
    for table in run.tables:
        if (path := table.objects) is None:
            continue
        rows = pl.scan_parquet(path, glob=False)
        with reading(str(path)):
            columns = rows.collect_schema().names()
        if set(columns) >= _COLUMNS:
            end = pl.col("frame") < table.end_frame if table.end_frame is not None else pl.lit(value=True)
            seen = rows.filter("kept", pl.col("distance_m").is_not_null(), end)
            lateral_m = pl.coalesce("lateral_m", "true_lateral_m").cast(pl.Float64)
            parts.append(collect(seen.select("frame", "label", "distance_m", lateral_m, "score"), str(path)))
    return pl.concat(parts)


def _true_objects(run: Run) -> pl.DataFrame:
    """Class and place of all true objects."""
    labels, *places = (pl.col(name) for name in _TRUTH)
    each = rows_of(run).select("frame", *_TRUTH, at=pl.int_ranges(labels.list.len())).explode("at").drop_nulls("at")
    at = (column.list.get(pl.col("at"), null_on_oob=True) for column in (labels, *places))
    return collect(
        each.select("frame", *(a.alias(b) for a, b in zip(at, ("label", *_PLACE), strict=True))), run.source_name
    )
