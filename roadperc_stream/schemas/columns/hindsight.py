"""Columns of errors by hindsight: estimate minus what later frames found. They are known only at a replay's end."""

from dataclasses import dataclass
from math import nan
from typing import Annotated, Final

from roadperc_stream.schemas.columns.column import Column, columns_of

_STD = "standard deviation of the two estimates' difference"
_SEE = "[hindsight](hindsight.md)"


def _error(
    meaning: str,
    null: str,
    label: str,
    limit: float,
    relevant: float = nan,
    unit: str = "m",
    decimals: int = 3,
    *,
    compares_coverage: bool = False,
) -> Column:
    label = f"{label} by hindsight"
    return Column(meaning, unit, null, label, decimals, "near 0", compares_coverage, relevant, limit)


def _lane(side: str) -> Column:
    null = "boundary lost, or not found again: a lane change, lost odometry, the log's end"
    meaning = f"y(10 m) minus the boundary found there from at most 4 m, by {_SEE}"
    return _error(meaning, null, f"lane {side} at 10 m", 0.3)


_FOUND = Column("frame that found it", null="no error by hindsight")
_OVER_ROAD = "height of the road 10 m ahead minus that found there from at most 4 m"
_OF_OBJECTS = "mean of abs(d - d of the smoothed track) over kept detections"
_OF_IMPACT = "smallest time to impact in the path minus that of the smoothed track"
_OF_STEP = "length of the step minus that of the smoothed speed"


@dataclass(frozen=True)
class SurfaceHindsightColumns:
    """The road ahead against the road found there."""

    surface_height_hindsight_m: Annotated[
        float | None, _error(_OVER_ROAD, "no road measured or held, or not found again", "surface height", 0.1)
    ] = None
    surface_height_hindsight_frame: Annotated[float | None, _FOUND] = None


@dataclass(frozen=True)
class LaneHindsightColumns:
    """The boundaries ahead against those found there."""

    lane_left_hindsight_m: Annotated[float | None, _lane("left")] = None
    lane_left_hindsight_std_m: Annotated[float | None, Column(_STD, "m", "the same")] = None
    lane_left_hindsight_frame: Annotated[float | None, _FOUND] = None
    lane_right_hindsight_m: Annotated[float | None, _lane("right")] = None
    lane_right_hindsight_std_m: Annotated[float | None, Column(_STD, "m", "the same")] = None
    lane_right_hindsight_frame: Annotated[float | None, _FOUND] = None


@dataclass(frozen=True)
class ObjectHindsightColumns:
    """The objects of the frame against their tracks one second before and after."""

    object_distance_hindsight_m: Annotated[
        float | None,
        _error(_OF_OBJECTS, "no kept detection with both distances, or the last second", "object distance", 1.0, 0.05),
    ] = None
    time_to_impact_hindsight_s: Annotated[
        float | None,
        _error(_OF_IMPACT, "either is unknown", "time to impact", 1.0, unit="s", compares_coverage=True),
    ] = None


@dataclass(frozen=True)
class OdometryHindsightColumns:
    """The step against the steps half a second before and after."""

    step_hindsight_m: Annotated[
        float | None,
        _error(_OF_STEP, "no step, no scale, or no better known speed around it", "step", 0.05, 0.002, decimals=4),
    ] = None
    step_hindsight_std_m: Annotated[float | None, Column(_STD, "m", "the same")] = None


@dataclass(frozen=True)
class FrameHindsight(OdometryHindsightColumns, ObjectHindsightColumns, LaneHindsightColumns, SurfaceHindsightColumns):
    """The columns of a frame's row by hindsight."""


_TRACK: Final = "no second of the track after it, too little before it, or a track that contradicts itself"


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
