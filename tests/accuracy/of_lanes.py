"""Values of the lane figures."""

import numpy as np
import polars as pl

from tests.accuracy import measures
from tests.accuracy.values import Value


def _over_frames(replays, function):
    return np.concatenate([np.asarray(function(replay.frames), bool) for replay in replays])


def _share(flags, detail=""):
    return Value(100 * float(flags.mean()) if len(flags) else None, None, detail)


def handed(replays):
    """Share of crossings after which the new lane is measured in time."""
    flags = _over_frames(replays, measures.handed_over)
    return _share(flags, f"{flags.sum()} of {len(flags)} crossings")


def counted(replays):
    """Share of scenes with the correct number of lane changes at the end.

    Raises:
        LookupError: the chain does not count them.
    """
    if any("lane_changes" not in replay.frames.columns for replay in replays):
        raise LookupError("no column lane_changes")
    ends = pl.concat([replay.frames.select("lane_changes", "true_lane_changes").tail(1) for replay in replays])
    return _share(ends["lane_changes"].eq_missing(ends["true_lane_changes"]).to_numpy(), f"{ends.height} scenes")


def implausible(replays):
    """Share of frames whose two measured boundaries cannot be the car's lane."""
    flags = _over_frames(replays, measures.implausible)
    return Value(_share(flags).number, len(flags) / sum(replay.frames.height for replay in replays))


def points_right(replays):
    """Mean of TuSimple's accuracy over frames; a frame without lanes has 0."""
    scores = pl.concat([replay.frames["lane_tusimple_accuracy"] for replay in replays])
    return Value(float(scores.fill_null(0.0).mean()), scores.count() / len(scores))


def off_own_line(replays):
    """Distance in cm of the last frame's left boundary from the line measured in its image."""
    last = replays[0].frames.row(-1, named=True)
    return Value(100 * abs(last["lane_left_offset_m"] - last["lane_left_raw_offset_m"]))


def silent(replays):
    """Share of absent boundaries without a reason; 0 if no boundary is absent."""
    flags = _over_frames(replays, measures.absent_without_reason)
    return _share(flags, f"{len(flags)} absent") if len(flags) else Value(0.0, None, "none absent")


def covered(replays):
    """Share of boundaries that are measured."""
    coverage = measures.boundaries(replays).coverage
    return Value(None if coverage is None else 100 * coverage)


def gross(replays, place="at_car_m"):
    """Share of measured boundaries off by more than 0.3 m, at the car or 10 m ahead (``ahead_m``)."""
    found = measures.boundaries(replays)
    share = measures.share_above(getattr(found, place), 0.3)
    return Value(None if share is None else 100 * share, found.coverage)


def offset_error(replays, share=0.5):
    """A quantile of the errors of the measured offsets at the car, cm."""
    found = measures.boundaries(replays)
    error_m = measures.quantile(found.at_car_m, share)
    return Value(None if error_m is None else 100 * error_m, found.coverage)
