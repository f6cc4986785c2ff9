"""Regressions that are put into the tables of replays, to measure how often compare finds them."""

from dataclasses import dataclass

import numpy as np
import polars as pl

from roadperc_stream.eval.report_columns import SIDES, TRUTH
from roadperc_stream.schemas.columns import TIME_COLUMNS

TIMES = "recorded times x 1.2 (`--times`)"
_ERROR = (pl.col("distance_m") - pl.col("true_distance_m")).abs()


@dataclass(frozen=True)
class Tables:
    """The tables of one log: a row per frame, and a row per detection."""

    frames: pl.DataFrame
    objects: pl.DataFrame


_OUTPUTS = (
    *("camera_height_m", "drivable_ratio", "lane_left_offset_m", "lane_right_offset_m", "detections"),
    *("stereo_valid_ratio", "step_m"),
)
"""A column of each output."""


def _boundary_off(new, random):
    """One boundary is off by 2 m in two frames of one log: neighbours in half of the trials."""
    log, side = random.integers(len(new)), random.choice(SIDES)
    count = new[log].frames.height
    first = int(random.integers(count - 1))
    frames = [first, first + 1] if random.random() < 0.5 else random.choice(count, 2, replace=False).tolist()
    shift = random.choice([-2.0, 2.0])
    columns = [f"lane_{side}_error_m", f"lane_{side}_offset_m", f"lane_{side}_raw_offset_m"]
    at = pl.int_range(pl.len()).is_in(frames)
    return _changed(new, log, [pl.when(at).then(pl.col(name) + shift).otherwise(pl.col(name)) for name in columns])


def _distances_long(new, random):
    """The distances of one class are 5 % long."""
    label = random.choice(sorted(set().union(*(log.objects["label"].unique() for log in new))))
    factor = pl.when(pl.col("label") == label).then(1.05).otherwise(1.0)
    changed = []
    for log in new:
        objects = log.objects.with_columns(pl.col("distance_m") * factor)
        errors = objects.filter("kept").group_by("frame").agg(object_distance_error_m=_ERROR.mean())
        frames = log.frames.drop("object_distance_error_m").join(errors, on="frame", how="left", maintain_order="left")
        changed.append(Tables(frames.select(log.frames.columns), objects))
    return changed


def _coverage_lower(new, random):
    """One output is missing in 2 % of the frames of one log."""
    log, column = random.integers(len(new)), random.choice(_OUTPUTS)
    count = new[log].frames.height
    known = np.flatnonzero(new[log].frames[column].is_not_null())
    at = pl.int_range(pl.len()).is_in(random.choice(known, round(0.02 * count), replace=False).tolist())
    return _changed(new, log, [pl.when(~at).then(pl.col(column)).alias(column)])


def _jitter(new, random):
    """An error's deviation from its median is three times as large."""
    errors = [q.column for q in TRUTH if q.better != "high" and q.unit in ("m", "deg", "px")]
    known = [name for name in errors if not all(log.frames[name].is_null().all() for log in new)]
    name = random.choice(known)
    median = pl.col(name).median()
    tripled = median + 3 * (pl.col(name) - median)
    return [Tables(log.frames.with_columns(tripled), log.objects) for log in new]


def _slower(new, _):
    """The recorded times are 1.2 times as long."""
    return [Tables(log.frames.with_columns(pl.col(TIME_COLUMNS) * 1.2), log.objects) for log in new]


def _changed(logs, index, columns):
    changed = list(logs)
    changed[index] = Tables(logs[index].frames.with_columns(columns), logs[index].objects)
    return changed


INJECTIONS = {
    "one boundary off by 2 m in 2 frames": _boundary_off,
    "one class's distances 5 % long": _distances_long,
    "coverage 2 % lower in one log": _coverage_lower,
    "jitter x 3 of one error": _jitter,
    TIMES: _slower,
}
"""Regressions by the name in the table."""
