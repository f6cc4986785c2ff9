"""Values of the surface and odometry figures, and quantiles of error columns."""

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation

from tests.accuracy import measures
from tests.accuracy.scenarios import BY_MODEL, MODELS
from tests.accuracy.values import Measured, Value, percent

SLACK = 1.1


def errors(replays, column):
    """The known errors of a column, and the share of frames that have one."""
    values = pl.concat([replay.frames[column] for replay in replays])
    return values.drop_nulls().to_numpy().astype(float), values.count() / len(values)


def error_quantile(replays, column, factor, share):
    """A quantile of the absolute errors of a column, multiplied by a factor."""
    found, coverage = errors(replays, column)
    size = measures.quantile(found, share)
    return Value(None if size is None else factor * size, coverage)


def by_model(road, column, results):
    """Median errors with each model; met if the chosen model is at most SLACK times worse than the better one."""
    texts, found = [], {}
    for model in MODELS:
        try:
            found[model] = error_quantile(results.of(BY_MODEL[road, model]), column, 100, 0.5)
            texts.append(f"{found[model].number:.2f}")
        except LookupError:
            texts.append("absent")
    if "auto" not in found:
        return Measured(f"{' / '.join(texts)} cm", percent(found["plane"].coverage if found else None), None)
    best = min(found[model].number for model in MODELS[:2])
    return Measured(f"{' / '.join(texts)} cm", percent(found["auto"].coverage), found["auto"].number <= SLACK * best)


def _steps(replays):
    rows = pl.concat([replay.frames.select("step_m", "true_step_m") for replay in replays])
    truly = rows.filter(pl.col("true_step_m") > 0)
    return truly.drop_nulls(), truly.height


def step_error(replays):
    """Median of the relative errors of steps, percent."""
    steps, total = _steps(replays)
    if not steps.height:
        return Value(None, 0.0)
    relative = (steps["step_m"] / steps["true_step_m"] - 1).abs().median()
    return Value(100 * relative, steps.height / total)


def length_error(replays):
    """Relative error in percent of the sum of the steps with scale."""
    steps, total = _steps(replays)
    if not steps.height:
        return Value(None, 0.0)
    return Value(100 * abs(steps["step_m"].sum() / steps["true_step_m"].sum() - 1), steps.height / total)


def with_scale(replays):
    """Share of steps with a known length, in percent."""
    steps, total = _steps(replays)
    return Value(100 * steps.height / total)


def lost(replays):
    """Share of frames without a motion, in percent."""
    statuses = pl.concat([replay.frames["odometry_status"] for replay in replays])
    return Value(100 * float(statuses.eq_missing("lost").mean()))


def end_error(replays):
    """Distance of the last pose from the true one, in percent of the path; the mean of several replays."""
    return Value(100 * float(np.mean([_end_error(replay.frames) for replay in replays])))


TRACKS = 0.1
"""Largest error of a step, as a share of it, with which a frame counts as tracked."""


def lost_where_others_track(scenarios, others, results):
    """Frames that are lost although other settings give their step; met if there are none."""
    pairs = [
        sorted(results.of(chosen), key=lambda replay: (replay.scenario, replay.seed)) for chosen in (scenarios, others)
    ]
    lost, tracked = (pl.concat([replay.frames for replay in replays]) for replays in pairs)
    right = (tracked["step_error_m"] < TRACKS * tracked["true_step_m"]).fill_null(value=False)
    missed = int((lost["odometry_status"].eq_missing("lost") & right).sum())
    both = [100 * float(frames["odometry_status"].eq_missing("lost").mean()) for frames in (lost, tracked)]
    return Measured(f"{missed} of {right.sum()} frames (lost: {both[0]:.1f} %, {both[1]:.1f} %)", "", missed == 0)


def as_exact(scenarios, others, results):
    """Median errors of steps with both settings; met if the first one is at most SLACK times the second."""
    own, other = (step_error(results.of(chosen)) for chosen in (scenarios, others))
    met = own.number <= SLACK * other.number
    return Measured(f"{own.number:.2f} / {other.number:.2f} %", percent(own.coverage), met)


def height_error(replays):
    """Largest error of the last pose's height, in percent of the path."""
    return Value(100 * max(_end_error(replay.frames, axes=[2]) for replay in replays))


def _end_error(frames, axes=(0, 1, 2)):
    placed = frames.filter(pl.col("odom_x_m").is_not_null())
    found_m, true_m = (_from_first(placed, of) for of in ("odom", "true"))
    off_m = np.take(found_m[-1] - true_m[-1], axes)
    return np.linalg.norm(off_m) / np.linalg.norm(np.diff(true_m, axis=0), axis=1).sum()


def _from_first(frames, of):
    """(N, 3) positions in the ego frame of the first row, metres."""
    positions_m = frames.select(f"{of}_{axis}_m" for axis in "xyz").to_numpy()
    first = Rotation.from_quat(frames.select(f"{of}_q{part}" for part in "xyzw").to_numpy()[0])
    return first.inv().apply(positions_m - positions_m[0])
