"""Columns of errors by hindsight: estimate minus what later frames found. They are known only at a replay's end."""

from dataclasses import dataclass
from typing import Annotated, Final

from roadperc_stream.schemas.columns.column import Better, Column, columns_of

_STD = "standard deviation of the two estimates' difference"
_SEE = "[hindsight](hindsight.md)"


def _error(meaning: str, unit: str, null: str, label: str, decimals: int, better: Better, limit: float) -> Column:
    relevant = {"object distance": 0.05, "step": 0.002}.get(label, float("nan"))
    label = f"{label} by hindsight"
    return Column(meaning, unit, null, label, decimals, better, compares_coverage=False, relevant=relevant, limit=limit)


def _lane(side: str) -> Column:
    null = "boundary lost, or not found again: a lane change, lost odometry, the log's end"
    meaning = f"y(10 m) minus the boundary found there from at most 4 m, by {_SEE}"
    return _error(meaning, "m", null, f"lane {side} at 10 m", 3, "near 0", 0.3)


@dataclass(frozen=True)
class SurfaceHindsightColumns:
    """The road ahead against the road found there."""

    hindsight_frame: Annotated[
        float | None,
        Column(
            "frame in which the place 10 m ahead is at most 4 m ahead", null="the car does not reach it, or no pose"
        ),
    ] = None
    surface_height_hindsight_m: Annotated[
        float | None,
        _error(
            "height of the road 10 m ahead minus that found there from at most 4 m",
            "m",
            "no road claimed, or not found again",
            "surface height",
            3,
            "near 0",
            0.1,
        ),
    ] = None


@dataclass(frozen=True)
class LaneHindsightColumns:
    """The boundaries ahead against those found there."""

    lane_left_hindsight_m: Annotated[float | None, _lane("left")] = None
    lane_left_hindsight_std_m: Annotated[float | None, Column(_STD, "m", "the same")] = None
    lane_right_hindsight_m: Annotated[float | None, _lane("right")] = None
    lane_right_hindsight_std_m: Annotated[float | None, Column(_STD, "m", "the same")] = None


@dataclass(frozen=True)
class ObjectHindsightColumns:
    """The objects of the frame against their tracks one second before and after."""

    object_distance_hindsight_m: Annotated[
        float | None,
        _error(
            "mean of abs(d - d of the smoothed track) over kept detections",
            "m",
            "no kept detection with both distances",
            "object distance",
            3,
            "low",
            1.0,
        ),
    ] = None
    time_to_impact_hindsight_s: Annotated[
        float | None,
        _error(
            "smallest time to impact in the path minus that of the smoothed track",
            "s",
            "either is unknown",
            "time to impact",
            3,
            "near 0",
            1.0,
        ),
    ] = None
    time_to_impact_hindsight_std_s: Annotated[float | None, Column(_STD, "s", "the same")] = None


@dataclass(frozen=True)
class OdometryHindsightColumns:
    """The step against the steps half a second before and after."""

    step_hindsight_m: Annotated[
        float | None,
        _error(
            "length of the step minus that of the smoothed speed",
            "m",
            "no step, no scale, or too few steps around it",
            "step",
            4,
            "near 0",
            0.05,
        ),
    ] = None
    step_hindsight_std_m: Annotated[float | None, Column(_STD, "m", "the same")] = None


@dataclass(frozen=True)
class FrameHindsight(OdometryHindsightColumns, ObjectHindsightColumns, LaneHindsightColumns, SurfaceHindsightColumns):
    """The columns of a frame's row by hindsight."""


_TRACK: Final = "track without a second before and after, or one that contradicts itself"


@dataclass(frozen=True)
class TrackHindsightColumns:
    """A detection against its track one second before and after."""

    object_distance_hindsight_m: Annotated[
        float | None, Column(f"`distance_m` minus that of the smoothed track, by {_SEE}", "m", _TRACK)
    ] = None
    object_distance_hindsight_std_m: Annotated[float | None, Column(_STD, "m", "the same")] = None
    closing_speed_hindsight_mps: Annotated[
        float | None, Column("`closing_speed_mps` minus that of the smoothed track", "m/s", _TRACK)
    ] = None
    closing_speed_hindsight_std_mps: Annotated[float | None, Column(_STD, "m/s", "the same")] = None
    time_to_impact_hindsight_s: Annotated[
        float | None, Column("`time_to_impact_s` minus that of the smoothed track", "s", f"{_TRACK}; or not nearing")
    ] = None
    time_to_impact_hindsight_std_s: Annotated[float | None, Column(_STD, "s", "the same")] = None


FRAME_HINDSIGHT: Final = tuple(columns_of(FrameHindsight))
TRACK_HINDSIGHT: Final = tuple(columns_of(TrackHindsightColumns))
"""Names of the columns, which follow the row in the tables and are not in its message."""
