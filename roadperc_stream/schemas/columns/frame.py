"""The row of a frame: the groups of columns, in the table's order from the last base to the first."""

from dataclasses import dataclass
from typing import Annotated, Final

from roadperc_stream.schemas.columns import errors, estimates
from roadperc_stream.schemas.columns.column import Column

TIMED_STAGES: Final = (
    *("read", "decode", "surface", "lanes", "objects", "stereo", "odometry", "occupancy"),
    *("metrics", "copy", "encode", "write", "total"),
)
"""The parts of a frame's time, and their sum: reading its messages from the log, decoding its pixels, the chain's
stages, its row, the copy of the input's messages up to it, the making of its own messages and their writing."""
TIME_COLUMNS: Final = tuple(f"{stage}_ms" for stage in TIMED_STAGES)
"""Milliseconds of each; null where it did not run. They stand in Parquet alone, behind the row."""


@dataclass(frozen=True)
class FrameKey:
    """Which frame of which log."""

    log_id: Annotated[str, Column("first 16 hexadecimal digits of the digest of the input's messages")]
    frame: Annotated[int, Column("number of the frame in the replay, from 0")]
    stamp_ns: Annotated[int, Column("time stamp of the frame", "ns")]


@dataclass(frozen=True)
class InputColumns:
    """What of the input was at hand."""

    segment: Annotated[
        int, Column("how often the stamps before the frame began anew: another recording, or one played in a loop")
    ] = 0
    sync_skew_ms: Annotated[
        float | None,
        Column(
            "largest distance of a sensor's stamp from the frame's",
            "ms",
            "no other sensor has a message for the frame",
            label="sync skew",
            decimals=1,
        ),
    ] = None
    missing: Annotated[tuple[str, ...], Column("roles of the log without a message for the frame")] = ()
    reasons: Annotated[tuple[str, ...], Column("why an output is missing or incomplete, in words")] = ()


@dataclass(frozen=True)
class FrameMetrics(
    InputColumns,
    errors.TruePoseColumns,
    errors.OdometryErrorColumns,
    errors.StereoErrorColumns,
    errors.TrueImpactColumns,
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
    """The row of a frame, the times excepted."""
