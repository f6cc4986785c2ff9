"""The path that the car is going to take: its lane where that is known, else the circle on which it drives.

A collision is foreseen with what is in the path alone: forward collision warning knows an obstacle vehicle on the
subject vehicle's trajectory, not one beside it (ISO 15623; GB/T 33577-2017, which has its terms).
"""

from dataclasses import dataclass
from math import atan2, cos, exp, fsum, hypot, sin

from roadperc_stream.core.config import ObjectsConfig
from roadperc_stream.core.datatypes import SIDES, Boundary, Lanes, PathSource
from roadperc_stream.core.geometry import Float

_TURNING_FROM_M = 1e-3
"""A shorter step says nothing of the direction in which the car drives."""
_STRAIGHT_M = 0.1
"""Less way than this says nothing of a curvature."""


@dataclass(frozen=True)
class EgoPath:
    """The middle of the path, a circle in the ego frame: where it is at x = 0, its heading there and its curvature.

    ``lane_half_m`` is half the lane's width, None where no lane is known; ``lane_changes`` tells one lane from the
    next.
    """

    source: PathSource
    offset_m: float = 0.0
    heading: float = 0.0
    curvature_per_m: float = 0.0
    lane_half_m: float | None = None
    lane_changes: int | None = None

    def goes_on(self, before: "EgoPath") -> bool:
        """Whether it is the path of the frame before, so that places beside it can be compared."""
        return (self.source, self.lane_changes) == (before.source, before.lane_changes)

    @property
    def circle(self) -> tuple[float, float, float, float]:
        """Its place at x = 0, cosine and sine of its heading there, and its curvature."""
        return self.offset_m, cos(self.heading), sin(self.heading), self.curvature_per_m


@dataclass(frozen=True)
class DrivenArc:
    """How far the car has turned (radians, to the left) over which way, the latest metres counting most."""

    turned: float = 0.0
    driven_m: float = 0.0

    def after(self, cfg: ObjectsConfig, last_T_this: Float | None) -> "DrivenArc":
        """After a step, by metres, not by time: a car that stands still keeps what its wheels point at."""
        if last_T_this is None:
            return self
        way_m = hypot(last_T_this[0, 3], last_T_this[1, 3])
        if way_m < _TURNING_FROM_M:
            return self
        fading = exp(-way_m / cfg.path_memory_m)
        turn = atan2(last_T_this[1, 0], last_T_this[0, 0])
        return DrivenArc(fading * self.turned + turn, fading * self.driven_m + way_m)

    @property
    def curvature_per_m(self) -> float | None:
        """Yaw rate over speed; None where the car has hardly moved."""
        return self.turned / self.driven_m if self.driven_m >= _STRAIGHT_M else None


def path_of(cfg: ObjectsConfig, lanes: Lanes | None, arc: DrivenArc) -> EgoPath:
    """The lane's middle; along a boundary where the lane is not known; the circle the car drives on; straight ahead.

    Args:
        cfg: which widths a lane may have.
        lanes: the frame's, None where they were not looked for or could not be found.
        arc: what odometry says of the last metres.
    """
    known = [] if lanes is None else [line for side in SIDES if (line := _known(lanes.side(side))) is not None]
    width_m = known[0][0] - known[1][0] if len(known) == len(SIDES) else None
    if known and (width_m is None or width_m >= cfg.lane_width_min_m):
        offset, heading, curvature = (fsum(values) / len(values) for values in zip(*known, strict=True))
        changes = None if lanes is None else lanes.lane_changes
        if width_m is None or width_m > cfg.lane_width_max_m:
            return EgoPath("boundary", 0.0, heading, curvature, None, changes)
        return EgoPath("lane", offset, heading, curvature, width_m / 2, changes)
    curvature_per_m = arc.curvature_per_m
    if curvature_per_m is None:
        return EgoPath("straight")
    return EgoPath("odometry", curvature_per_m=curvature_per_m)


def _known(boundary: Boundary) -> tuple[float, float, float] | None:
    """Offset, heading and curvature of a boundary that is measured or held."""
    if boundary.status == "lost" or boundary.offset_m is None or boundary.heading is None:
        return None
    return boundary.offset_m, boundary.heading, boundary.curvature_per_m or 0.0
