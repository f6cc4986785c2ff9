"""The outputs of the stages for one frame. Unknown is None in scalars and NaN in arrays, never 0 or -1."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float, Float32
from roadperc_stream.geometry.arrays import Mask, read_only
from roadperc_stream.geometry.planes import Surface
from roadperc_stream.model.inputs import Box, Detection
from roadperc_stream.model.reason import Reason

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
LaneChange = Literal["none", "left", "right"]
BoundaryStatus = Literal["measured", "held", "lost"]
ObjectStatus = Literal["measured", "tracked", "lost"]
DistanceSource = Literal["depth", "ground"]
Verdict = Literal["kept", "unverified", "dropped"]
PathSource = Literal["lane", "boundary", "odometry", "straight"]
OdometryStatus = Literal["first", "tracked", "lost"]
Line = tuple[float, float, float, float]
"""x1, y1, x2, y2 in pixels: from the image's bottom edge (y1 = height) to the road's far end."""


@dataclass(frozen=True)
class Absent:
    """A missing output of a stage, with its reason; ``isinstance(output, Absent)`` finds it."""

    reason: Reason

    def __str__(self) -> str:
        return str(self.reason)


@dataclass(frozen=True)
class StereoDepth:
    """Depth from a rectified pair in the left camera's image: (H, W) metres along z, NaN unknown.

    ``inverse_std`` is the standard deviation of 1 / depth that the pixels of an object share, 1/m.
    """

    frame_id: str
    depth_m: Float32 = field(repr=False)
    inverse_std: float = 0.0

    def __post_init__(self) -> None:
        read_only(self.depth_m, np.float32, (None, None), "depth_m")


@dataclass(frozen=True)
class Matches:
    """Features of the odometry's keyframe matched in a frame: (N, 2) pixels there and here, in whole images.

    ``inliers`` (N,) are those that agree on the motion.
    """

    key_px: Float32 = field(repr=False)
    px: Float32 = field(repr=False)
    inliers: Mask = field(repr=False)

    def __post_init__(self) -> None:
        read_only(self.key_px, np.float32, (None, 2), "key_px")
        read_only(self.px, np.float32, (len(self.key_px), 2), "px")
        read_only(self.inliers, np.bool_, (len(self.key_px),), "inliers")


@dataclass(frozen=True)
class Odometry:
    """The pose of the ego frame. ``step`` maps this frame's ego coordinates to the last one's (last_T_this).

    With ``up_to_scale`` lengths are in units of the first step, not metres. Without ``has_length`` the step only turns:
    its length is unknown, and the pose keeps the last known place. ``covariance`` is 6x6 row by row of x, y, z, roll,
    pitch, yaw of ``step`` in the ego frame's axes. ``since_ns`` is the stamp at which ``step`` begins. ``reason`` is
    why a frame is ``lost``, or the source of its scale instead of the road. A lost frame has the last known pose.
    ``matches`` are the features of the estimated motion, None without a motion.
    """

    status: OdometryStatus
    odom_T_ego: Float
    step: Float | None = None
    inliers: int = 0
    up_to_scale: bool = False
    covariance: tuple[float, ...] = field(default=(), repr=False)
    since_ns: int | None = None
    reason: Reason | None = None
    matches: Matches | None = field(default=None, repr=False)
    has_length: bool = True

    @property
    def has_pose(self) -> bool:
        """Whether the pose is this frame's, not the last known one."""
        return self.status != "lost" and self.has_length

    def __post_init__(self) -> None:
        read_only(self.odom_T_ego, np.float64, (4, 4), "odom_T_ego")
        if self.step is not None:
            read_only(self.step, np.float64, (4, 4), "step")

    def __str__(self) -> str:
        x, y, z = self.odom_T_ego[:3, 3]
        reason = "" if self.reason is None else f", {self.reason.text}"
        return (
            f"odometry: {self.status} at x {x:.2f}, y {y:.2f}, z {z:.2f}{' steps' * self.up_to_scale or ' m'}{reason}"
        )


@dataclass(frozen=True)
class Occupancy:
    """A bird's-eye grid in the ego frame: -1 unknown, 0 free, 100 occupied.

    ``cells[row, column]`` begins at x = x_min_m + column * resolution_m and y = y_min_m + row * resolution_m.
    """

    x_min_m: float
    y_min_m: float
    resolution_m: float
    cells: NDArray[np.int8] = field(repr=False)

    def __post_init__(self) -> None:
        read_only(self.cells, np.int8, (None, None), "cells")


@dataclass(frozen=True)
class Boundary:
    """One side of the ego lane. The state (offset, heading in radians, curvature) is in the ego frame at x = 0.

    ``covariance`` is the state's, 3x3 row by row. ``inside`` and ``outside`` are the classes on either side, such as
    ``road`` and ``sidewalk``, empty if unknown. ``line_ego_m`` and ``line_px`` are points of the smoothed boundary.
    ``reason`` says why a boundary is ``lost``.
    """

    side: Side
    status: BoundaryStatus
    raw_px: Line | None = None
    smoothed_px: Line | None = None
    offset_m: float | None = None
    heading: float | None = None
    curvature_per_m: float | None = None
    raw_offset_m: float | None = None
    covariance: tuple[float, ...] = field(default=(), repr=False)
    inside: str = ""
    outside: str = ""
    line_ego_m: Float = field(default_factory=lambda: np.empty((0, 3)), repr=False)
    line_px: Float = field(default_factory=lambda: np.empty((0, 2)), repr=False)
    reason: Reason | None = None

    def __post_init__(self) -> None:
        read_only(self.line_ego_m, np.float64, (None, 3), "line_ego_m")
        read_only(self.line_px, np.float64, (None, 2), "line_px")

    def __str__(self) -> str:
        where = "" if self.offset_m is None else f" at {self.offset_m:+.2f} m"
        return f"{self.side} {self.status}{where}"


@dataclass(frozen=True)
class Lanes:
    """The ego lane's two boundaries, and the lines they were chosen from as (N, 4) x1, y1, x2, y2 in pixels.

    ``edges`` are the edge pixels along which the lines were proposed, in the image or in every second row and column of
    it. None if they were not computed.
    While the car moves into another lane, ``lane_change`` is the side on which part of it is over the line.
    ``lane_changes`` counts how often its reference point has entered another lane. Both are None if unknown.
    """

    boundaries: tuple[Boundary, ...]
    proposals_px: Float = field(default_factory=lambda: np.empty((0, 4)), repr=False)
    merged_px: Float = field(default_factory=lambda: np.empty((0, 4)), repr=False)
    edges: Mask | None = field(default=None, repr=False)
    lane_change: LaneChange | None = None
    lane_changes: int | None = None

    def __post_init__(self) -> None:
        if self.edges is not None:
            read_only(self.edges, np.bool_, (None, None), "edges")
        read_only(self.proposals_px, np.float64, (None, 4), "proposals_px")
        read_only(self.merged_px, np.float64, (None, 4), "merged_px")

    def __str__(self) -> str:
        return f"lanes: {', '.join(map(str, self.boundaries)) or 'no boundary'}"

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why boundaries are lost."""
        return tuple(boundary.reason for boundary in self.boundaries if boundary.reason is not None)

    def side(self, side: Side) -> Boundary:
        """The boundary of one side; ``lost`` if the lanes do not have it."""
        return next((b for b in self.boundaries if b.side == side), Boundary(side, "lost"))


@dataclass(frozen=True)
class Object:
    """A detection filtered by the segmentation, with its distance.

    ``lateral_m`` is the position of its middle, to the left of the middle of the car's path. ``in_path``: part of it is
    in the path. ``cut_in``: it is not in the path yet, but crosses the lane's line towards it. Only objects in the path
    have a time to impact. ``distance_source`` tells where a known distance comes from: the ``depth`` of its pixels, or
    the contact of the box's lower edge with the ``ground``.
    """

    detection: Detection
    kept: bool
    class_ratio: float | None = None
    distance_m: float | None = None
    distance_std_m: float | None = None
    closing_speed_mps: float | None = None
    closing_speed_std_mps: float | None = None
    time_to_impact_s: float | None = None
    time_to_impact_std_s: float | None = None
    beyond_range: bool = False
    status: ObjectStatus = "measured"
    track_id: str = ""
    lateral_m: float | None = None
    in_path: bool | None = None
    cut_in: bool | None = None
    distance_source: DistanceSource = "depth"

    def __str__(self) -> str:
        return self.detection.label + ("" if self.distance_m is None else f" at {self.distance_m:.1f} m")

    @property
    def verdict(self) -> Verdict:
        """The filter's verdict: ``unverified`` objects are kept because there is no segmentation to verify them."""
        if not self.kept:
            return "dropped"
        return "unverified" if self.class_ratio is None else "kept"


@dataclass(frozen=True)
class Correlation:
    """How well a template fits an image, by the position of its first pixel.

    ``scores[row, column]``, -1 to 1, is the score with the template's first pixel at (x_px + column, y_px + row); it is
    -inf where the image has no texture. ``template_px`` are the columns and rows of the template.
    """

    x_px: int
    y_px: int
    template_px: tuple[int, int]
    scores: Float32 = field(repr=False)

    def __post_init__(self) -> None:
        read_only(self.scores, np.float32, (None, None), "scores")

    @property
    def peak(self) -> tuple[Box, float]:
        """The box where the template fits best, and its score."""
        row, column = np.unravel_index(int(np.argmax(self.scores)), self.scores.shape)
        left, top = float(self.x_px + column), float(self.y_px + row)
        box_px = Box(left, top, left + self.template_px[0], top + self.template_px[1])
        return box_px, min(float(self.scores[row, column]), 1.0)

    def match(self, min_score: float) -> tuple[Box, float] | None:
        """The peak if it reaches a score, else None; None if the image has no texture."""
        box_px, score = self.peak
        return None if score < min_score or not np.isfinite(score) else (box_px, score)


@dataclass(frozen=True)
class Objects:
    """All detections of a frame, kept and dropped, in the detector's order, then objects tracked only by template.

    ``searches`` are the correlations of the template matching. ``path_source`` is the source of the path: the
    ``lane``, a single ``boundary``, the circle driven by ``odometry``, or ``straight`` ahead without any of them.
    """

    objects: tuple[Object, ...]
    searches: tuple[Correlation, ...] = field(default=(), repr=False)
    path_source: PathSource | None = None

    def __str__(self) -> str:
        near = self.nearest
        nearest = "" if near is None else f", nearest: {near}"
        return f"objects: {sum(item.kept for item in self.objects)} of {len(self.objects)} kept{nearest}"

    @property
    def nearest(self) -> Object | None:
        """The nearest kept object; None if no distance is known."""
        return self._first_kept([item.distance_m for item in self.objects])

    @property
    def most_urgent(self) -> Object | None:
        """The kept object with the shortest time to impact; None if no such time is known."""
        return self._first_kept([item.time_to_impact_s for item in self.objects])

    def _first_kept(self, values: Sequence[float | None]) -> Object | None:
        """The kept object with the smallest value; the first one if several are equal."""
        known = {k: value for k, value in enumerate(values) if value is not None and self.objects[k].kept}
        return self.objects[min(known, key=known.__getitem__)] if known else None


@dataclass(frozen=True)
class FrameResult:
    """The result of the chain for one frame.

    ``problems`` are the unusable inputs and their consequences.
    """

    stamp_ns: int
    frame_id: str
    surface: Surface | Absent
    drivable: Mask | Absent
    lanes: Lanes | Absent
    objects: Objects | Absent
    problems: tuple[Reason, ...] = ()
    stereo: StereoDepth | Absent = Absent(Reason("stereo", "not_run"))
    odometry: Odometry | Absent = Absent(Reason("odometry", "not_run"))
    occupancy: Occupancy | Absent = Absent(Reason("occupancy", "not_run"))
    front_surface: Surface | Absent = Absent(Reason("surface", "not_run"))
    """``surface`` with its plane in the frame of the front camera."""

    def __post_init__(self) -> None:
        if not isinstance(self.drivable, Absent):
            read_only(self.drivable, np.bool_, (None, None), "drivable")

    def __str__(self) -> str:
        return f"{self.stamp_ns} ns: {self.surface}; {self.lanes}; {self.objects}; {self.odometry}"

    def _repr_html_(self) -> str:
        """The lines that a notebook shows."""
        shown = (self.surface, self.lanes, self.objects, self.odometry, *self.problems)
        return "".join(f"<div>{escape(str(line))}</div>" for line in (f"{self.stamp_ns} ns", *shown))

    def reasons(self) -> tuple[Reason, ...]:
        """The reasons of absent outputs, and the problems of the input."""
        motion, lanes = self.odometry, self.lanes
        stages = (self.stereo, self.surface, self.drivable, motion, lanes, self.objects, self.occupancy)
        found = [out.reason for out in stages if isinstance(out, Absent)]
        if isinstance(motion, Odometry) and motion.reason is not None:
            lost = motion.status == "lost"
            found.append(Reason("odometry", "lost", cause=motion.reason) if lost else motion.reason)
        if isinstance(lanes, Lanes):
            found += lanes.reasons
        return (*found, *self.problems)
