"""A frame and its truth, kept apart so that truth cannot leak into perception."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float
from roadperc_stream.geometry.arrays import read_only
from roadperc_stream.geometry.planes import Surface
from roadperc_stream.model.frame import Frame
from roadperc_stream.model.inputs import DepthImage, TagImage
from roadperc_stream.model.reason import Reason
from roadperc_stream.model.results import Absent, FrameResult, Lanes, Objects


@dataclass(frozen=True)
class Truth:
    """The truth of a frame; the chain never sees it."""

    odom_T_ego: Float | None = None
    surface: Surface | None = None
    lanes: Lanes | None = None
    objects: Objects | None = None
    depth: DepthImage | None = None
    segmentation: TagImage | None = None

    def __post_init__(self) -> None:
        if self.odom_T_ego is not None:
            read_only(self.odom_T_ego, np.float64, (4, 4), "odom_T_ego")


EGO, ODOM = "ego", "odom"
"""The coordinate frames of the results: the car, and the origin of its trajectory."""
OWN_ODOM: Final = "perception_odom"
"""Name of odom if the log has a frame ``odom`` or places the car itself."""


@dataclass(frozen=True)
class FrameAnchor:
    """The frame of the log's transform tree that ego and odom are attached to; no frame gets a second parent."""

    frame_id: str = ""
    """The log's frame that ego is attached to; empty if the log itself has a frame ``ego``."""
    ego_T_frame: Float = field(default_factory=lambda: np.eye(4))
    placed: bool = False
    """Whether that frame has a parent in the log: then ego is its child, and odom is a child of ego."""
    odom: str = ODOM


LAST_ROS_STAMP_NS: Final = 2**31 * 10**9 - 1
"""The largest stamp of ROS 2 messages: the int32 seconds of builtin_interfaces/Time end on 2038-01-19."""
UNWRITTEN: Final = -1
"""Index of a sample that only warms up the chain; its results are not written."""


@dataclass(frozen=True)
class EarlierTruth:
    """The stamp and true pose of the previous frame, for the metrics of the next one."""

    stamp_ns: int
    odom_T_ego: Float | None

    def __post_init__(self) -> None:
        if self.odom_T_ego is not None:
            read_only(self.odom_T_ego, np.float64, (4, 4), "odom_T_ego")


@dataclass(frozen=True)
class SettledFrame:
    """A frame of a replay that no later message can change; a later log continues the replay after the last one.

    ``arrived_ns`` is the log time of its message, ``log_time_ns`` that of its results. A continued replay reads the
    log again from ``since_ns``: the earliest log time of the messages of this frame, and of those that later frames
    may take.
    """

    number: int
    stamp_ns: int
    arrived_ns: int
    log_time_ns: int
    segment: int
    since_ns: int


@dataclass(frozen=True)
class Sample:
    """The synchronised inputs of one instant of a log."""

    index: int
    log_time_ns: int
    frame: Frame
    truth: Truth
    missing: tuple[str, ...] = ()
    skew_ns: int | None = None
    anchor: FrameAnchor = field(default_factory=FrameAnchor)
    segment: int = 0
    """Number of restarts of the stamps before it."""
    lost: Reason | None = None
    """Reason if damage lost messages since the previous frame, else None."""
    settled: SettledFrame | None = None
    """Set if no later message can change this frame, and a later log may continue the replay after it."""

    @property
    def is_written(self) -> bool:
        """Whether its results are written; else it only warms up the chain."""
        return self.index != UNWRITTEN

    @property
    def as_earlier(self) -> EarlierTruth:
        """The stamp and true pose, for the metrics of the next frame."""
        return EarlierTruth(self.frame.stamp_ns, self.truth.odom_T_ego)


def frame_reasons(sample: Sample, result: FrameResult) -> tuple[Reason, ...]:
    """Why data of a frame is missing: lost messages, missing messages, reports of the stages, results not written."""
    lost = () if sample.lost is None else (sample.lost,)
    missing = (Reason(role, "no_message") for role in sample.missing)
    with_ros_schemas = {"stereo": result.stereo, "occupancy": result.occupancy}
    present = [stage for stage, output in with_ros_schemas.items() if not isinstance(output, Absent)]
    unwritten = present if result.stamp_ns > LAST_ROS_STAMP_NS else []
    not_written = (Reason(stage, "not_written", (LAST_ROS_STAMP_NS,)) for stage in unwritten)
    return (*lost, *missing, *result.reasons(), *not_written)
