"""The measured values: functions of the tables of replays.

A value function takes the ``Tables`` of one or several groups of scenarios and returns a ``Value`` or a ``Measured``.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import polars as pl
from scipy.spatial.transform import Rotation

from roadperc_stream.eval.report.consistency import FRAME_QUANTITIES, JUDGED, Consistency, added, consistency_by_run
from roadperc_stream.eval.report.sources import load, source_of_runs
from roadperc_stream.eval.runs import open_run
from tests.accuracy.bounds import Measured, Value, nothing, percent, share_of

SIDES = ("left", "right")
CROSSING_NS = 300_000_000
"""Within this time of a crossing the car's own lane is ambiguous, so frames do not count."""
RESAMPLES, LEVEL = 2000, 0.95
SLACK = 1.1
STANDS_M = 1e-4
"""Step below which a car stands."""
MOST_MPS2 = 12
"""Largest acceleration and braking of a car."""
TRACKS = 0.1
"""Largest error of a step, as a share of it, with which a frame counts as tracked."""
COURSE_PLACE_PX, COURSE_DISTANCE_M = (547, 479), 28.926553672316352
"""Position and distance of the obstacle in the public solutions of the course."""


@dataclass(frozen=True)
class Tables:
    """Replays: a row per frame, and a row per detection, with the number of the replay and its seed."""

    frames: pl.DataFrame
    objects: pl.DataFrame
    paths: tuple = ()
    """The tables of frames as files."""


def _times(factor, number):
    return None if number is None else factor * number


def _share(flags, coverage=None, detail=""):
    """The percentage of true flags."""
    return Value(_times(100, flags.mean()), coverage, detail)


# Lanes


def crossings_ns(frames):
    """The stamps of one replay's frames in which the car enters another lane."""
    return frames.filter(pl.col("true_lane_changes").diff() > 0)["stamp_ns"].to_list()


def away_from_crossings(frames):
    """The frames of one replay that are farther than ``CROSSING_NS`` from every crossing."""
    near = [(pl.col("stamp_ns") - stamp_ns).abs() <= CROSSING_NS for stamp_ns in crossings_ns(frames)]
    return frames.filter(~pl.any_horizontal(pl.lit(value=False), *near))


def boundaries(tables):
    """A row for each true boundary away from crossings: if it is measured, and its errors at the car and 10 m ahead."""
    frames = pl.concat([away_from_crossings(frames) for frames in tables.frames.partition_by("replay")])
    of_sides = [
        frames.drop_nulls(f"lane_{side}_true_offset_m").select(
            measured=pl.col(f"lane_{side}_status").eq_missing("measured"),
            at_car_m=pl.col(f"lane_{side}_offset_m") - pl.col(f"lane_{side}_true_offset_m"),
            ahead_m=pl.col(f"lane_{side}_error_m"),
        )
        for side in SIDES
    ]
    return pl.concat(of_sides)


def covered(tables):
    """Share of boundaries that are measured."""
    return _share(boundaries(tables)["measured"])


def gross(tables, place="at_car_m"):
    """Share of measured boundaries off by more than 0.3 m, at the car or 10 m ahead (``ahead_m``)."""
    rows = boundaries(tables)
    return _share(rows.filter("measured")[place].drop_nulls().abs() > 0.3, rows["measured"].mean())


def offset_error(tables, share=0.5):
    """A quantile of the errors of the measured offsets at the car, cm."""
    rows = boundaries(tables)
    error_m = rows.filter("measured")["at_car_m"].abs().quantile(share, "linear")
    return Value(_times(100, error_m), rows["measured"].mean())


def handed(tables):
    """Share of crossings soon after which both boundaries of the new lane are measured and correct."""
    right = pl.all_horizontal(
        pl.col(f"lane_{side}_status").eq_missing("measured")
        & ((pl.col(f"lane_{side}_offset_m") - pl.col(f"lane_{side}_true_offset_m")).abs() <= 0.3)
        for side in SIDES
    )
    flags = pl.Series(
        [
            bool(frames.filter(pl.col("stamp_ns").is_between(at_ns, at_ns + CROSSING_NS)).select(right.any()).item())
            for frames in tables.frames.partition_by("replay")
            for at_ns in crossings_ns(frames)
        ],
        dtype=pl.Boolean,
    )
    return _share(flags, detail=f"{flags.sum()} of {len(flags)} crossings")


def counted(tables):
    """Share of scenes with the correct number of lane changes at the end."""
    ends = tables.frames.group_by("replay").last()
    return _share(ends["lane_changes"].eq_missing(ends["true_lane_changes"]), detail=f"{ends.height} scenes")


def implausible(tables):
    """Share of frames whose two measured boundaries cannot be the car's lane, which is 2 to 6 m wide."""
    both = tables.frames.filter(pl.all_horizontal(pl.col(f"lane_{side}_status") == "measured" for side in SIDES))
    left, right = (both[f"lane_{side}_offset_m"] for side in SIDES)
    return _share(~((left > 0) & (right < 0) & (left - right).is_between(2.0, 6.0)), both.height / tables.frames.height)


def silent(tables):
    """Share of absent boundaries without a reason of the lane stage; 0 if no boundary is absent."""
    there = sum(pl.col(f"lane_{side}_status").is_in(["measured", "held"]).fill_null(value=False) for side in SIDES)
    told = pl.col("reason_codes").list.eval(pl.element().str.starts_with("lanes.")).list.any()
    rows = tables.frames.select(absent=len(SIDES) - there.cast(pl.Int64), told=told)
    absent = rows["absent"].sum()
    unexplained = rows.filter(~pl.col("told"))["absent"].sum()
    return Value(100 * unexplained / absent, None, f"{absent} absent") if absent else Value(0.0, None, "none absent")


def points_right(tables):
    """Mean of TuSimple's accuracy over frames; a frame without lanes has 0."""
    scores = tables.frames["lane_tusimple_accuracy"]
    return Value(scores.fill_null(0.0).mean(), scores.count() / len(scores))


def off_own_line(tables):
    """Distance in cm of the last frame's left boundary from the line measured in its image."""
    last = tables.frames.row(-1, named=True)
    return Value(100 * abs(last["lane_left_offset_m"] - last["lane_left_raw_offset_m"]))


# Surface and motion


def error_quantile(tables, column, factor=1, share=0.5):
    """A quantile of the absolute errors of a column, multiplied by a factor; its coverage is the share of frames."""
    errors = tables.frames[column]
    return Value(_times(factor, errors.abs().quantile(share, "linear")), errors.count() / len(errors))


def by_model(plane, spline, auto, column):
    """Median errors with each model; met if the chosen model is at most SLACK times worse than the better one."""
    return _compared([error_quantile(tables, column, 100) for tables in (plane, spline, auto)], "cm")


def _compared(errors, unit):
    *fixed, chosen = (error.number for error in errors)
    text = " / ".join(f"{error.number:.2f}" for error in errors)
    return Measured(f"{text} {unit}", percent(errors[-1].coverage), chosen <= SLACK * min(fixed))


def _steps(tables):
    """The steps of known length while the car moves, and their share of all such steps."""
    moving = tables.frames.filter(pl.col("true_step_m") > 0)
    known = moving.drop_nulls("step_m")
    return known, known.height / moving.height


def step_error(tables):
    """Median of the relative errors of steps, percent."""
    steps, coverage = _steps(tables)
    return Value(_times(100, (steps["step_m"] / steps["true_step_m"] - 1).abs().median()), coverage)


def length_error(tables):
    """Relative error in percent of the sum of the steps with scale."""
    steps, coverage = _steps(tables)
    return Value(100 * abs(steps["step_m"].sum() / steps["true_step_m"].sum() - 1) if coverage else None, coverage)


def with_scale(tables):
    """Share of steps with a known length, in percent."""
    return Value(100 * _steps(tables)[1])


def steps_beyond(tables):
    """Share of the steps beyond three standard deviations, in percent."""
    found = _consistency(tables, ("step_m",))
    return Value(100 * (1 - found.within(3)) if found.values else None, detail=f"{found.values} steps")


def lost(tables):
    """Share of frames without a motion, in percent."""
    return _share(tables.frames["odometry_status"].eq_missing("lost"))


def lost_where_others_track(others, chosen):
    """Number of frames that are lost although other settings give their step."""
    right = others.frames.filter(pl.col("step_error_m") < TRACKS * pl.col("true_step_m"))
    is_lost = pl.col("odometry_status").eq_missing("lost")
    missed = chosen.frames.filter(is_lost).join(right, on=["replay", "seed", "frame"], how="semi")
    shares = f"{lost(chosen).number:.1f} %, {lost(others).number:.1f} %"
    return Value(missed.height, None, f"of {right.height}; lost: {shares}")


def as_exact(other, chosen):
    """Median errors of steps; met if those of the chosen settings are at most SLACK times those of the other ones."""
    return _compared([step_error(other), step_error(chosen)], "%")


def end_error(tables):
    """Distance of the last pose from the true one, in percent of the path; the mean of several replays."""
    return Value(100 * float(np.mean(_end_errors(tables, [0, 1, 2]))))


def height_error(tables):
    """Largest error of the last pose's height, in percent of the path."""
    return Value(100 * max(_end_errors(tables, [2])))


def _standing(tables):
    """Each replay's frames in order, with the number of moving frames before them, and if the car stands in them."""
    for frames in tables.frames.partition_by("replay"):
        stands = pl.col("true_step_m") < STANDS_M
        yield frames.sort("stamp_ns").with_columns(stretch=(~stands.fill_null(value=False)).cum_sum(), stands=stands)


def standing_drift(tables):
    """Largest distance in cm of a standing car's poses from the first one since it stands."""
    drifts_m, known, total = [], 0, 0
    for frames in _standing(tables):
        standing = frames.filter("stands")
        total += standing.height
        for stretch in standing.drop_nulls("odom_x_m").partition_by("stretch"):
            poses_m = stretch.select(f"odom_{axis}_m" for axis in "xyz").to_numpy()
            drifts_m.append(np.linalg.norm(poses_m - poses_m[0], axis=1).max())
            known += len(poses_m)
    detail = f"{total} standing frames"
    return Value(_times(100, max(drifts_m, default=None)), known / total if total else None, detail)


def impossible_steps(tables):
    """Number of steps whose speed differs from that of the last known one by more than ``MOST_MPS2`` allows."""
    count = total = 0
    for frames in tables.frames.partition_by("replay"):
        timed = frames.sort("stamp_ns").with_columns(time_s=pl.col("stamp_ns") / 1e9)
        timed = timed.with_columns(speed_mps=pl.col("step_m") / pl.col("time_s").diff()).drop_nulls("speed_mps")
        jumps = timed.select(pl.col("speed_mps").diff().abs() > MOST_MPS2 * pl.col("time_s").diff()).to_series()
        count, total = count + jumps.sum(), total + len(jumps)
    return Value(float(count), total / tables.frames.height, f"of {total}")


def _end_errors(tables, axes):
    """The error of each replay's last pose along some axes, as a share of the path."""
    errors = []
    for frames in tables.frames.drop_nulls("odom_x_m").partition_by("replay", maintain_order=True):
        found_m, true_m = (_from_first(frames, of) for of in ("odom", "true"))
        off_m = np.take(found_m[-1] - true_m[-1], axes)
        errors.append(np.linalg.norm(off_m) / np.linalg.norm(np.diff(true_m, axis=0), axis=1).sum())
    return errors


def _from_first(frames, of):
    """(N, 3) positions in the ego frame of the first row, metres."""
    positions_m = frames.select(f"{of}_{axis}_m" for axis in "xyz").to_numpy()
    first = Rotation.from_quat(frames.select(f"{of}_q{part}" for part in "xyzw").to_numpy()[0])
    return first.inv().apply(positions_m - positions_m[0])


# Objects

DISTANCE_ERROR = (pl.col("distance_m") - pl.col("true_distance_m")).abs()


def off_by_a_metre(tables, nearest_m, farthest_m):
    """Share of kept true detections in a range with a distance error above 1 m, with its interval."""
    rows = _kept_true(tables, nearest_m, farthest_m)
    known = rows.drop_nulls("distance_m")
    if not known.height:
        return Value(None)
    objects = known.select(pl.format("{} {}", pl.col("replay").cast(str).str.zfill(6), pl.col("track_id")))
    share, low, high, count = share_by_object(known.select(DISTANCE_ERROR > 1.0).to_series(), objects.to_series())
    return Value(100 * share, known.height / rows.height, f"{100 * low:.1f} to {100 * high:.1f}, {count} objects")


def _kept_true(tables, nearest_m, farthest_m):
    distance_m = pl.col("true_distance_m")
    rows = tables.objects.filter("kept", distance_m >= nearest_m, distance_m < farthest_m)
    return rows.with_columns(pl.col("track_id").fill_null("none"))


def share_by_object(wrong, objects, seed=20):
    """A share of rows, its interval at LEVEL, and the number of objects.

    The interval is that of resampled objects, because the rows of one object are not independent.
    """
    _, places = np.unique(objects.to_numpy().astype(str), return_inverse=True)
    sums, counts = np.bincount(places, wrong.to_numpy()), np.bincount(places)
    picks = np.random.default_rng(seed).integers(len(counts), size=(RESAMPLES, len(counts)))
    shares = sums[picks].sum(axis=1) / counts[picks].sum(axis=1)
    low, high = np.quantile(shares, ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return wrong.mean(), float(low), float(high), len(counts)


def distance_error(tables, nearest_m, farthest_m):
    """Median absolute error in percent of the distances of kept true detections in a range."""
    rows = _kept_true(tables, nearest_m, farthest_m)
    known = rows.drop_nulls("distance_m")
    errors = known["distance_m"] / known["true_distance_m"] - 1.0
    return Value(_times(100, errors.abs().median()), known.height / rows.height)


def with_visible_share(seen, whole):
    """Rows of true detections by boxes of visible parts, with the area as a share of that of the whole object's box.

    Both have the same random numbers. Objects are the same if their true distances are.
    """
    keys = ["seed", "frame", "true_distance_m"]
    area = (pl.col("x_max_px") - pl.col("x_min_px")) * (pl.col("y_max_px") - pl.col("y_min_px"))
    rows, others = (tables.objects.drop_nulls("true_distance_m").with_columns(area=area) for tables in (seen, whole))
    both = rows.join(others.select(*keys, whole="area").unique(keys), on=keys)
    return both.with_columns(visible=pl.col("area") / pl.col("whole"))


def sure_though_hidden(seen, whole):
    """Share of the true detections, visible to 30 % or more, with a deviation below 10 %."""
    rows = with_visible_share(seen, whole).filter(pl.col("visible") >= 0.3)
    sure = rows.select((pl.col("distance_std_m") < 0.1 * pl.col("distance_m")).fill_null(value=False)).to_series()
    return _share(sure, detail=f"{rows.height} detections")


def hidden_people_off(seen, whole):
    """Share of the distances of people, at most half visible, that are off by more than 1 m."""
    rows = with_visible_share(seen, whole).filter(pl.col("visible") < 0.5, pl.col("label") == "Pedestrian")
    return _share_of_distances(rows, DISTANCE_ERROR > 1.0)


def right_or_unsure(tables):
    """Share of the true detections' distances within 1 m or two standard deviations."""
    limit_m = pl.max_horizontal(1.0, 2 * pl.col("distance_std_m").fill_null(0.0))
    return _share_of_distances(tables.objects.drop_nulls("true_distance_m"), DISTANCE_ERROR.le(limit_m))


def sure(tables):
    """Share of the true detections' distances with a deviation below 15 %."""
    is_sure = pl.col("distance_std_m") < 0.15 * pl.col("distance_m")
    found = _share_of_distances(tables.objects.drop_nulls("true_distance_m"), is_sure)
    return Value(found.number, found.coverage)


def _share_of_distances(rows, flag):
    known = rows.drop_nulls("distance_m")
    coverage = known.height / rows.height if rows.height else None
    return _share(known.select(flag).to_series(), coverage, f"{known.height} distances")


def precision(tables):
    """True kept detections / kept detections."""
    return _ratio(tables, "filter_fp")


def recall(tables):
    """True kept detections / true detections."""
    return _ratio(tables, "filter_fn")


def _ratio(tables, wrong):
    right, wrong = tables.frames["filter_tp"], tables.frames[wrong]
    total = right.sum() + wrong.sum()
    return Value(right.sum() / total if total else None, right.count() / len(right))


def false_alarms(tables):
    """Number of frames with a time to impact below 1.5 s although the true one is above 2 s or absent."""
    true_s = pl.col("true_time_to_impact_s")
    calm = tables.frames.filter(true_s.is_null() | (true_s > 2.0))
    return Value(float((calm["time_to_impact_s"] < 1.5).sum()), None, f"of {calm.height}")


def _impacts(tables, first=0):
    """The frames from 0.5 to 3 s before a true impact; frames before number ``first`` of a log do not count."""
    return tables.frames.filter(pl.col("true_time_to_impact_s").is_between(0.5, 3.0), pl.col("frame") >= first)


def impact_known(tables, first=0):
    """Share in percent of the frames before a true impact, from frame ``first`` on, that have a time to impact."""
    times_s = _impacts(tables, first)["time_to_impact_s"]
    return _share(times_s.is_not_null(), detail=f"{len(times_s)} frames")


def impact_error(tables, share=0.5):
    """A quantile of the absolute errors of the time to impact, in seconds."""
    rows = _impacts(tables)
    errors_s = (rows["time_to_impact_s"] - rows["true_time_to_impact_s"]).abs()
    return Value(errors_s.quantile(share, "linear"), errors_s.count() / len(errors_s) if len(errors_s) else None)


def _obstacle(tables):
    return tables.objects.filter(pl.col("label") == "template").row(0, named=True)


def obstacle_place_off(tables):
    """Error in pixels of the position of the course's obstacle in the image."""
    found = _obstacle(tables)
    return Value(max(abs(found[name] - at) for name, at in zip(("x_min_px", "y_min_px"), COURSE_PLACE_PX, strict=True)))


def obstacle_off(tables):
    """Distance error in mm of the course's obstacle; the detail gives its position."""
    found = _obstacle(tables)
    place = f"at ({found['x_min_px']:.0f}, {found['y_min_px']:.0f}), {found['distance_m']:.4f} m"
    return Value(1000 * abs(found["distance_m"] - COURSE_DISTANCE_M), None, place)


# Uncertainty

QUANTITIES = {
    "lane offset": (2, ("lane_left_offset_m", "lane_right_offset_m")),
    "lane heading": (2, ("lane_heading_deg",)),
    "step": (2, ("step_m",)),
    "turn": (2, ("turn_deg",)),
    "distance": (4, ("distance_m",)),
    "closing speed": (4, ("closing_speed_mps",)),
    "time to impact": (4, ("time_to_impact_s",)),
}
"""The maximum share in percent beyond three standard deviations, and the columns."""
UNITS = {
    "lane offset": "m",
    "lane heading": "°",
    "distance": "m",
    "closing speed": "m/s",
    "time to impact": "s",
}


@cache
def _of_replay(path):
    (found,) = consistency_by_run(load(source_of_runs([open_run(path, path.name)])))
    return found


def _consistency(tables, columns):
    total = added(_of_replay(path) for path in tables.paths)
    return sum((total.get(name, Consistency()) for name in columns), Consistency())


def deviations(tables, quantity):
    """Shares within one and two standard deviations and beyond three, with NEES, pooled over replays."""
    most_beyond, columns = QUANTITIES[quantity]
    found = _consistency(tables, columns)
    if not found.values:
        return nothing("no standard deviation in the tables" if found.errors else "no truth")
    within_1, within_2, beyond_3 = found.within(1), found.within(2), 1 - found.within(3)
    interval = found.nees_interval
    nees = f"NEES {found.nees:.3g}" + (f", {interval[0]:.3g} to {interval[1]:.3g}" if interval else "")
    met = 0.5 <= within_1 <= 0.85 and within_2 >= 0.9 and 100 * beyond_3 <= most_beyond
    text = f"{100 * within_1:.1f} / {100 * within_2:.1f} / {100 * beyond_3:.1f} % ({nees})"
    return Measured(text, percent(found.values / found.errors), met, share_of(100 * beyond_3, most_beyond))


def beyond(tables, quantity):
    """Share in percent of the errors beyond three standard deviations; the detail has the median deviation.

    The coverage is the share of the true values that have an estimate with a deviation.
    """
    found = []
    for judged in (one for one in JUDGED if one.estimate in QUANTITIES[quantity][1]):
        rows = tables.frames if judged in FRAME_QUANTITIES else tables.objects.filter("kept")
        columns = {"off": (pl.col(judged.estimate) - pl.col(judged.truth)).abs(), "std": judged.std}
        found.append(rows.drop_nulls(judged.truth).select(**columns))
    rows = pl.concat(found)
    known = rows.drop_nulls().filter(pl.col("std") > 0)
    if not known.height:
        return Value(None)
    detail = f"{known.height} values, median deviation {known['std'].median():.2g} {UNITS[quantity]}"
    share = known.select(pl.col("off") > 3 * pl.col("std")).to_series().mean()
    return Value(100 * share, known.height / rows.height, detail)
