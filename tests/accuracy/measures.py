"""Pure functions that compute the figures from the tables of replays."""

from dataclasses import dataclass

import numpy as np
import polars as pl

SIDES = ("left", "right")
CROSSING_S = 0.3
"""Within this time of a crossing the car's own lane is ambiguous, so frames do not count."""
RESAMPLES = 2000
LEVEL = 0.95


@dataclass(frozen=True)
class Boundaries:
    """Boundaries with truth, both sides of all frames: ``measured`` (N,) bool, and errors of measured ones, metres."""

    measured: np.ndarray
    at_car_m: np.ndarray
    ahead_m: np.ndarray

    @property
    def coverage(self):
        """The measured share."""
        return float(self.measured.mean()) if len(self.measured) else None


def crossings_ns(frames):
    """Stamps of the frames in which the car enters another lane."""
    if frames["true_lane_changes"].null_count() == frames.height:
        return np.array([], np.int64)
    steps = np.diff(frames["true_lane_changes"].to_numpy())
    return frames["stamp_ns"].to_numpy()[1:][steps > 0]


def away_from(stamps_ns, instants_ns, margin_s=CROSSING_S):
    """(N,) bool: the stamp is farther than the margin from every instant."""
    away = np.ones(len(stamps_ns), bool)
    for instant in instants_ns:
        away &= np.abs(stamps_ns - instant) > round(margin_s * 1e9)
    return away


def boundaries(replays):
    """The boundaries of several replays, without frames near a crossing."""
    parts = [_boundaries(replay.frames, side) for replay in replays for side in SIDES]
    return Boundaries(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _boundaries(frames, side):
    away = away_from(frames["stamp_ns"].to_numpy(), crossings_ns(frames))
    rows = frames.filter(pl.Series(away) & pl.col(f"lane_{side}_true_offset_m").is_not_null())
    measured = rows[f"lane_{side}_status"].eq_missing("measured").to_numpy()
    found = rows.filter(pl.Series(measured, dtype=pl.Boolean))
    at_car_m = found[f"lane_{side}_offset_m"] - found[f"lane_{side}_true_offset_m"]
    return measured, _known(at_car_m), _known(found[f"lane_{side}_error_m"])


def share_above(errors, limit):
    """Share of absolute errors above a limit; None without errors."""
    return float(np.mean(np.abs(errors) > limit)) if len(errors) else None


def quantile(errors, share):
    """Quantile of the absolute errors; None without errors."""
    return float(np.quantile(np.abs(errors), share)) if len(errors) else None


def handed_over(frames, within_s=CROSSING_S, tolerance_m=0.3):
    """For each crossing, True if both boundaries of the new lane are soon measured and correct."""
    stamps_ns = frames["stamp_ns"].to_numpy()
    right = np.ones(frames.height, bool)
    for side in SIDES:
        error_m = (frames[f"lane_{side}_offset_m"] - frames[f"lane_{side}_true_offset_m"]).to_numpy().astype(float)
        measured = frames[f"lane_{side}_status"].eq_missing("measured").to_numpy()
        right &= measured & (np.abs(np.nan_to_num(error_m, nan=np.inf)) <= tolerance_m)
    return [
        bool(right[(stamps_ns >= instant) & (stamps_ns <= instant + round(within_s * 1e9))].any())
        for instant in crossings_ns(frames)
    ]


def implausible(frames, narrowest_m=2.0, widest_m=6.0):
    """(N,) bool for frames with two measured boundaries: they cannot be those of the car's lane."""
    both = frames.filter(pl.all_horizontal(pl.col(f"lane_{side}_status") == "measured" for side in SIDES))
    left, right = (both[f"lane_{side}_offset_m"].to_numpy() for side in SIDES)
    width_m = left - right
    return ~((left > 0) & (right < 0) & (width_m >= narrowest_m) & (width_m <= widest_m))


def absent_without_reason(frames):
    """(N,) bool for absent boundaries: their frame has no reason of the lane stage."""
    statuses = [frames[f"lane_{side}_status"].is_in(["measured", "held"]) for side in SIDES]
    there = sum(found.fill_null(value=False).to_numpy().astype(int) for found in statuses)
    silent = [not any(code.startswith("lanes.") for code in codes) for codes in frames["reason_codes"].to_list()]
    return np.repeat(np.array(silent, bool), len(SIDES) - there)


def share_by_object(wrong, objects, seed=20):
    """A share of rows with its interval, by resampling objects, as the rows of one object are not independent.

    Args:
        wrong: (N,) bool.
        objects: (N,) the object number of each row.
        seed: of the resampling.

    Returns:
        The share and its interval at LEVEL; None without rows.
    """
    if not len(wrong):
        return None
    _, places = np.unique(objects, return_inverse=True)
    sums, counts = np.bincount(places, wrong), np.bincount(places)
    picks = np.random.default_rng(seed).integers(len(counts), size=(RESAMPLES, len(counts)))
    shares = sums[picks].sum(axis=1) / counts[picks].sum(axis=1)
    low, high = np.quantile(shares, ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return float(np.mean(wrong)), float(low), float(high)


def kept_true(replays, nearest_m, farthest_m):
    """Rows of kept true detections at a distance, with an object number that is unique over all replays."""
    parts, total = [], 0
    for replay in replays:
        rows = replay.objects.filter(
            pl.col("kept"), pl.col("true_distance_m") >= nearest_m, pl.col("true_distance_m") < farthest_m
        )
        names = rows["track_id"].fill_null("none").to_numpy() if rows.height else np.array([], str)
        numbers = total + np.unique(names, return_inverse=True)[1].reshape(-1)
        total += len(set(names))
        parts.append(
            rows.select("distance_m", "distance_std_m", "true_distance_m").with_columns(
                object=pl.Series(numbers, dtype=pl.Int64)
            )
        )
    return pl.concat(parts)


def with_visible_share(replays):
    """Rows of true detections by boxes of visible parts, with the area as a share of that of the whole object's box.

    The second half of the replays has the boxes of whole objects, with the same random numbers. Objects are the same if
    their true distances are.
    """
    half = len(replays) // 2
    keys, area = (
        ["frame", "true_distance_m"],
        (pl.col("x_max_px") - pl.col("x_min_px")) * (pl.col("y_max_px") - pl.col("y_min_px")),
    )
    parts = []
    for seen, whole in zip(replays[:half], replays[half:], strict=True):
        areas = [replay.objects.drop_nulls("true_distance_m").with_columns(area=area) for replay in (seen, whole)]
        both = areas[0].join(areas[1].select(*keys, whole="area").unique(keys), on=keys)
        parts.append(both.with_columns(visible=pl.col("area") / pl.col("whole")))
    return pl.concat(parts)


def true_distances(replays):
    """Rows of true detections with a distance, and their share of all true detections."""
    true = pl.concat([replay.objects for replay in replays]).drop_nulls("true_distance_m")
    known = true.drop_nulls("distance_m")
    return known, known.height / true.height if true.height else None


def false_alarms(frames, alarm_s=1.5, calm_s=2.0):
    """(N,) bool for frames without a true impact before ``calm_s``: the estimate is below ``alarm_s``."""
    calm = frames.filter(pl.col("true_time_to_impact_s").is_null() | (pl.col("true_time_to_impact_s") > calm_s))
    return (calm["time_to_impact_s"] < alarm_s).fill_null(value=False).to_numpy()


def impacts(replays, soonest_s=0.5, latest_s=3.0, first=0):
    """(N, 2) estimated (NaN if absent) and true time to impact, of frames whose true one is in the range.

    Frames before number ``first`` of a log do not count.
    """
    columns = "time_to_impact_s", "true_time_to_impact_s"
    rows = pl.concat([replay.frames[first:].select(columns) for replay in replays])
    near = rows.filter(pl.col("true_time_to_impact_s").is_between(soonest_s, latest_s))
    return near.to_numpy().astype(float)


def _known(values):
    return values.drop_nulls().to_numpy().astype(float)
