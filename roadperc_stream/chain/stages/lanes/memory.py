"""What the lanes remember from one frame to the next."""

from dataclasses import dataclass, field, replace

from roadperc_stream.chain.stages.lanes.class_history import ClassHistory
from roadperc_stream.chain.stages.lanes.tracking import BoundaryTrack
from roadperc_stream.core.datatypes import LaneChange, Side


@dataclass(frozen=True)
class TrackedBoundary:
    """A boundary that is tracked, and the classes on either side of it in the last frames."""

    track: BoundaryTrack
    reach_m: float
    inside: ClassHistory = field(default_factory=ClassHistory)
    outside: ClassHistory = field(default_factory=ClassHistory)
    is_sure: bool = True
    """Whether, when it was measured last, it was known well enough to be given."""

    @property
    def offset_m(self) -> float:
        """Lateral position at the ego origin."""
        return float(self.track.state[0])


@dataclass(frozen=True)
class LanesState:
    """Both boundaries, the lane change the car is in, and how many it has done."""

    left: TrackedBoundary | None = None
    right: TrackedBoundary | None = None
    lane_change: LaneChange = "none"
    lane_changes: int = 0

    def side(self, side: Side) -> TrackedBoundary | None:
        """The boundary of that side; None where none is tracked."""
        return self.left if side == "left" else self.right

    def with_side(self, side: Side, boundary: TrackedBoundary | None) -> "LanesState":
        """The same with another boundary on that side."""
        return replace(self, left=boundary) if side == "left" else replace(self, right=boundary)
