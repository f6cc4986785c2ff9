"""Values of the object figures."""

import numpy as np
import polars as pl

from tests.accuracy import measures
from tests.accuracy.values import Value

COURSE_PLACE_PX, COURSE_DISTANCE_M = (547, 479), 28.926553672316352
"""Position and distance of the obstacle in the public solutions of the course."""


def off_by_a_metre(replays, nearest_m, farthest_m):
    """Share of kept true detections in a range with a distance error above 1 m, with its interval."""
    rows = measures.kept_true(replays, nearest_m, farthest_m)
    known = rows.drop_nulls("distance_m")
    wrong = ((known["distance_m"] - known["true_distance_m"]).abs() > 1.0).to_numpy()
    found = measures.share_by_object(wrong, known["object"].to_numpy())
    if found is None:
        return Value(None)
    share, low, high = (100 * part for part in found)
    detail = f"{low:.1f} to {high:.1f}, {known['object'].n_unique()} objects"
    return Value(share, known.height / rows.height, detail)


def sure_though_hidden(replays, least_visible=0.3, share=0.1):
    """Share in percent of the true detections, visible to a least share, with a deviation below a share.

    Args:
        replays: of boxes of visible parts, then as many of the same scenes with boxes of whole objects.
        least_visible: least area of the visible part's box as a share of the whole object's.
        share: largest deviation as a share of the distance.
    """
    rows = measures.with_visible_share(replays).filter(pl.col("visible") >= least_visible)
    is_sure = (pl.col("distance_std_m") < share * pl.col("distance_m")).fill_null(value=False)
    return Value(100 * rows.select(is_sure.mean()).item() if rows.height else None, None, f"{rows.height} detections")


def hidden_people_off(replays, most_visible=0.5):
    """Share in percent of the distances of people, at most half visible, that are off by more than 1 m.

    Args:
        replays: of boxes of visible parts, then as many of the same scenes with boxes of whole objects.
        most_visible: largest area of the visible part's box as a share of the whole object's.
    """
    hidden = (pl.col("visible") < most_visible) & (pl.col("label") == "Pedestrian")
    rows = measures.with_visible_share(replays).filter(hidden)
    known = rows.drop_nulls("distance_m")
    wrong = (pl.col("distance_m") - pl.col("true_distance_m")).abs() > 1.0
    share = 100 * known.select(wrong.mean()).item() if known.height else None
    return Value(share, known.height / rows.height if rows.height else None, f"{known.height} distances")


def right_or_unsure(replays):
    """Share in percent of the true detections' distances within 1 m or two standard deviations."""
    known, coverage = measures.true_distances(replays)
    limit_m = pl.max_horizontal(1.0, 2 * pl.col("distance_std_m").fill_null(0.0))
    right = (pl.col("distance_m") - pl.col("true_distance_m")).abs() <= limit_m
    share = 100 * known.select(right.mean()).item() if known.height else None
    return Value(share, coverage, f"{known.height} distances")


def sure(replays, share=0.15):
    """Share in percent of the true detections' distances with a deviation below a share of the distance."""
    known, coverage = measures.true_distances(replays)
    is_sure = pl.col("distance_std_m") < share * pl.col("distance_m")
    return Value(100 * known.select(is_sure.mean()).item() if known.height else None, coverage)


def distance_error(replays, nearest_m, farthest_m):
    """Median absolute error in percent of the distances of kept true detections in a range."""
    rows = measures.kept_true(replays, nearest_m, farthest_m)
    known = rows.drop_nulls("distance_m")
    errors = (known["distance_m"] / known["true_distance_m"] - 1.0).to_numpy()
    return Value(100 * measures.quantile(errors, 0.5) if len(errors) else None, known.height / rows.height)


def obstacle_off(replays):
    """Distance error in mm of the course's obstacle; the detail gives its position."""
    found = _obstacle(replays)
    place = f"at ({found['x_min_px']:.0f}, {found['y_min_px']:.0f}), {found['distance_m']:.4f} m"
    return Value(1000 * abs(found["distance_m"] - COURSE_DISTANCE_M), None, place)


def obstacle_place_off(replays):
    """Error in pixels of the obstacle's position in the image."""
    found = _obstacle(replays)
    return Value(max(abs(found["x_min_px"] - COURSE_PLACE_PX[0]), abs(found["y_min_px"] - COURSE_PLACE_PX[1])))


def _obstacle(replays):
    return pl.concat([replay.objects for replay in replays]).filter(pl.col("label") == "template").row(0, named=True)


def _counts(replays):
    names = ("filter_tp", "filter_fp", "filter_fn")
    frames = pl.concat([replay.frames.select(names) for replay in replays])
    coverage = frames["filter_tp"].count() / frames.height
    return *(int(frames[name].sum()) for name in names), coverage


def precision(replays):
    """True kept detections / kept detections."""
    tp, fp, _, coverage = _counts(replays)
    return Value(tp / (tp + fp) if tp + fp else None, coverage)


def recall(replays):
    """True kept detections / true detections."""
    tp, _, fn, coverage = _counts(replays)
    return Value(tp / (tp + fn) if tp + fn else None, coverage)


def false_alarms(replays):
    """Number of frames with a false alarm."""
    flags = np.concatenate([measures.false_alarms(replay.frames) for replay in replays])
    return Value(float(flags.sum()), None, f"of {len(flags)}")


def impact_known(replays, first=0):
    """Share in percent of the frames before a true impact, from frame ``first`` on, that have a time to impact."""
    times_s = measures.impacts(replays, first=first)
    return Value(
        100 * float(np.isfinite(times_s[:, 0]).mean()) if len(times_s) else None, None, f"{len(times_s)} frames"
    )


def impact_error(replays, share=0.5):
    """A quantile of the absolute errors of the time to impact, in seconds."""
    times_s = measures.impacts(replays)
    errors_s = (times_s[:, 0] - times_s[:, 1])[np.isfinite(times_s[:, 0])]
    return Value(measures.quantile(errors_s, share), len(errors_s) / len(times_s) if len(times_s) else None)
