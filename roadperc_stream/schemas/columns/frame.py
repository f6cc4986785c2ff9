"""The rows of a frame and of a detection: groups of columns, ordered from the last base class to the first."""

from dataclasses import dataclass
from typing import Annotated, Any, Final

from roadperc_stream.model.reason import Reason
from roadperc_stream.schemas.columns import errors, estimates
from roadperc_stream.schemas.columns.column import RATIO, Column
from roadperc_stream.schemas.columns.hindsight import FRAME_HINDSIGHT

TIMED_STAGES: Final = (
    *("read", "decode", "surface", "lanes", "objects", "stereo", "odometry", "occupancy"),
    *("metrics", "copy", "encode", "write", "total"),
)
"""Timed steps of a frame: reading its messages, decoding its pixels, the chain's stages, its metrics, copying the input
up to it, encoding its results, writing them, and the sum."""
TIME_COLUMNS: Final = tuple(f"{stage}_ms" for stage in TIMED_STAGES)
"""Milliseconds of each step, null if it did not run."""
EXTRA_COLUMNS: Final = (*FRAME_HINDSIGHT, *TIME_COLUMNS)
"""Columns that are only in the Parquet table, after the row."""


@dataclass(frozen=True)
class FrameKey:
    """The identity of a frame."""

    log_id: Annotated[str, Column("digest of the input's messages, 16 digits")]
    frame: Annotated[int, Column("number of the frame in the replay, from 0")]
    stamp_ns: Annotated[int, Column("time stamp of the frame", "ns")]


@dataclass(frozen=True)
class InputColumns:
    """The input of a frame."""

    segment: Annotated[
        int, Column("number of the [segment](recordings.md#late-messages-and-other-recordings-in-one-file), from 0")
    ] = 0
    sync_skew_ms: Annotated[
        float | None,
        Column(
            "largest difference of a sensor's stamp",
            "ms",
            "no other sensor in the frame",
            label="sync skew",
            decimals=1,
        ),
    ] = None
    missing: Annotated[tuple[str, ...], Column("roles of the log without a message for the frame")] = ()
    reasons: Annotated[
        tuple[Reason, ...],
        Column("why an output is missing or incomplete: see [reasons](#reasons)"),
    ] = ()
    reason_codes: Annotated[tuple[str, ...], Column("source and code of each reason, as `lanes.no_surface`")] = ()


@dataclass(frozen=True)
class FrameMetrics(
    InputColumns,
    errors.TruePoseColumns,
    errors.OdometryErrorColumns,
    errors.StereoErrorColumns,
    errors.TrueImpactColumns,
    errors.TrueObjectColumns,
    errors.ObjectErrorColumns,
    errors.LaneScoreColumns,
    errors.TrueLaneColumns,
    errors.LaneErrorColumns,
    errors.SurfaceErrorColumns,
    estimates.OdometryColumns,
    estimates.StereoColumns,
    estimates.ObjectColumns,
    estimates.LaneColumns,
    estimates.SurfaceColumns,
    FrameKey,
):
    """The row of a frame without its times."""


def cells(row: Any) -> dict[str, Any]:
    """Return the values of a row by column, as tables and messages store them."""
    values: dict[str, Any] = vars(row)
    return values | {"reasons": [reason.stored for reason in values["reasons"]]} if "reasons" in values else values


_NOT_TRACKED = "too few distances, or contradicting ones"
_NO_PLACE = "not tracked, or no distance"
_NO_TRUTH = "no true object"


@dataclass(frozen=True)
class ObjectMetrics(FrameKey):
    """A filtered and tracked detection, and the true object that it matches."""

    track_id: Annotated[str | None, Column("the object's track through the log", null="not tracked")]
    label: Annotated[str, Column("class by the detector")]
    score: Annotated[float, Column("the detector's confidence, 0 to 1")]
    x_min_px: Annotated[float, Column("box: upper left corner", "px")]
    y_min_px: Annotated[float, Column("box: upper left corner", "px")]
    x_max_px: Annotated[float, Column("box: lower right corner, exclusive", "px")]
    y_max_px: Annotated[float, Column("box: lower right corner, exclusive", "px")]
    class_ratio: Annotated[
        float | None,
        Column("share of the box's pixels with the label's classes", RATIO, "no tags, or an unknown label"),
    ]
    kept: Annotated[bool, Column("passed the filter")]
    distance_m: Annotated[
        float | None,
        Column(
            "straight-line distance from the camera",
            "m",
            "no depth there, beyond its range, or too uncertain",
        ),
    ]
    distance_std_m: Annotated[float | None, Column("its standard deviation", "m", "the same")]
    distance_source: Annotated[
        str | None,
        Column("`depth`, or `ground`: where the box meets the road", null="no distance"),
    ]
    closing_speed_mps: Annotated[float | None, Column("positive when approaching", "m/s", _NOT_TRACKED)]
    closing_speed_std_mps: Annotated[float | None, Column("its standard deviation", "m/s", "the same")]
    time_to_impact_s: Annotated[
        float | None,
        Column("distance over closing speed", "s", "not in the path, does not come nearer, or no closing speed"),
    ]
    time_to_impact_std_s: Annotated[float | None, Column("its standard deviation", "s", "the same")]
    lateral_m: Annotated[
        float | None, Column("distance of its middle from the path, positive to the left", "m", _NO_PLACE)
    ]
    in_path: Annotated[bool | None, Column("any of it is in the path", null=_NO_PLACE)]
    cut_in: Annotated[
        bool | None,
        Column("it moves into the path, over the lane's line", null="the same, or no lane"),
    ]
    status: Annotated[str, Column("`measured`, `tracked` (found without a detection) or `lost`")]
    beyond_range: Annotated[bool, Column("the depth saturates there")]
    is_true: Annotated[bool | None, Column("matches a true object", null="the log has no true objects")]
    true_distance_m: Annotated[float | None, Column("distance of that object", "m", _NO_TRUTH)]
    true_closing_speed_mps: Annotated[float | None, Column("its closing speed", "m/s", _NO_TRUTH)]
    true_time_to_impact_s: Annotated[
        float | None,
        Column(
            "the recorded value, else distance / closing speed",
            "s",
            "no true object, not nearing, or beside the path",
        ),
    ]
    true_lateral_m: Annotated[
        float | None,
        Column("true `lateral_m`", "m", "the log has no such truth"),
    ]
    true_in_path: Annotated[bool | None, Column("true `in_path`", null="the log has no such truth")]
