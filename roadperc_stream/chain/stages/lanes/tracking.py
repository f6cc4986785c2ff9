"""One boundary over time: a Kalman filter on its shape, its class, and the state of the lanes.

Where the car's motion since the last frame is known from odometry, the boundary is moved against it; else the car's
sideways motion is a random acceleration, and heading and curvature are random walks (Bar-Shalom, Li and Kirubarajan
2001, chapter 6). A measurement outside the gate is rejected; a boundary without measurements is held, then lost.
"""

import math
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from roadperc_stream.chain.stages.lanes.curves import Curve
from roadperc_stream.config import LanesConfig
from roadperc_stream.geometry import Float
from roadperc_stream.model import LaneChange, Odometry, Side, read_only
from roadperc_stream.system.time import NS_PER_S

MOST_OBSERVED = 256
"""Limit of kept observations: half a second at 500 frames per second."""
_OFFSET, _RATE, _HEADING, _CURVATURE, _SLOPE = range(5)
_MEASURED = [_OFFSET, _HEADING, _CURVATURE]
_BLOCK = np.ix_(_MEASURED, _MEASURED)
_H = np.eye(5)[_MEASURED]
_FIRST_RATE_STD_MPS = 1.0
_HEADING_WALK = 0.02
"""Radians per root second."""
_CURVATURE_WALK_PER_M = 0.003
"""Per metre and root second."""
_SIDEWAYS = np.ix_([1, 5], [1, 5])
"""y and yaw among x, y, z, roll, pitch, yaw of a step's covariance."""
_OFFSET_AND_HEADING = np.ix_([_OFFSET, _HEADING], [_OFFSET, _HEADING])
_ROUGH_OFFSET_ROOT_M = 0.002
_ROUGH_HEADING_PER_ROOT_M = 0.0008
"""Metres and radians per root metre driven: deviation of the road from its plane or height field."""
_MOVED_RATE_STD_MPS = 0.3
_CURVATURE_WALK_ROOT_M = 0.0008
"""Per metre and root metre driven: how fast roads change their curvature."""
_SLOPE_STD_PER_M2 = 1e-4
"""Standard deviation of the slope of the curvature ahead. A fit without it errs to the same side in every frame."""
_SLOPE_LENGTH_M = 15.0
_SLOPE_S = 1.0
"""Metres driven, or seconds without odometry, in which the slope's correlation falls to 1/e."""
_BLIND_M = 4.0
_BEND_M = 10.0
"""The first metres ahead are not visible. If the road bends beyond them, the curvature there may already have changed
by the slope times ``_BEND_M``."""
_AHEAD_M = 15.0
"""A reported boundary is a parabola, without a slope: its curvature is that with which it meets the track here."""
_REPORTED = _H.copy()
_REPORTED[2, _SLOPE] = _AHEAD_M / 3
_Y_AXIS_STEPS = 3
"""Fixed-point steps for the boundary's intersection with a turned y axis; each reduces the error by heading * turn."""
_CONTRADICTS = 7.81
"""Squared Mahalanobis distance above which two estimates of a boundary contradict each other (95 % of chi squared,
3 degrees)."""


@dataclass(frozen=True)
class ClassHistory:
    """The classes observed in the window that ends with the last segmented frame: stamps and names, oldest first."""

    observations: tuple[tuple[int, str], ...] = ()

    def add(self, cfg: LanesConfig, stamp_ns: int, name: str) -> "ClassHistory":
        """The history with one more class, without classes older than ``lanes.hold_s``.

        An empty name (out of sight) adds nothing; earlier observations count until they are too old. Frames without
        segmentation do not change the history.
        """
        kept = tuple(item for item in self.observations if (stamp_ns - item[0]) / NS_PER_S <= cfg.hold_s)
        return ClassHistory((*kept, (stamp_ns, name))[-MOST_OBSERVED:] if name else kept)

    @property
    def majority(self) -> str:
        """The most frequent class, the latest among equally frequent ones; empty without observations."""
        counts = Counter(name for _, name in self.observations)
        latest = {name: stamp_ns for stamp_ns, name in self.observations}
        return max(counts, key=lambda name: (counts[name], latest[name]), default="")


@dataclass(frozen=True)
class BoundaryTrack:
    """Mean (5,): offset m, its rate m/s, heading rad, curvature 1/m, slope of the curvature 1/m². Covariance (5, 5).

    ``stamp_ns`` is that of the state, ``measured_ns`` that of the last measurement.
    """

    mean: Float
    covariance: Float
    stamp_ns: int
    measured_ns: int

    def __post_init__(self) -> None:
        read_only(self.mean, np.float64, (5,), "mean")
        read_only(self.covariance, np.float64, (5, 5), "covariance")

    @property
    def state(self) -> Float:
        """(3,) offset, heading, curvature."""
        return self.mean[_MEASURED]

    @property
    def rate_mps(self) -> float:
        """Rate of the offset, m/s."""
        return float(self.mean[_RATE])

    @property
    def state_covariance(self) -> Float:
        """(3, 3) covariance of ``state``."""
        return self.covariance[_BLOCK]

    @property
    def reported_state(self) -> Float:
        """``state``, with a curvature that describes the first metres ahead."""
        return _REPORTED @ self.mean

    @property
    def reported_covariance(self) -> Float:
        """That of ``reported_state``, enlarged by a bend that may have begun in the part not seen.

        Only the part of the slope beyond its own deviation counts.
        """
        slope_variance = max(float(self.mean[_SLOPE] ** 2 - self.covariance[_SLOPE, _SLOPE]), 0.0)
        by_bend = slope_variance * _BEND_M**2 / _BLIND_M * _curvature_walk(_BLIND_M, -1.0)
        return _REPORTED @ self.covariance @ _REPORTED.T + by_bend


@dataclass(frozen=True)
class TrackedBoundary:
    """A tracked boundary, and the classes on either side of it in the last frames."""

    track: BoundaryTrack
    reach_m: float
    inside: ClassHistory = field(default_factory=ClassHistory)
    outside: ClassHistory = field(default_factory=ClassHistory)
    hidden_m: float = 0.0
    """Distance ahead up to which a bonnet hid the road in its last measurement."""
    is_sure: bool = True
    """Whether its last measurement left it certain enough to be used."""
    is_clear: bool = True
    """Whether the edges of its last measurement were as close to it as those of clean tags."""

    @property
    def offset_m(self) -> float:
        """Lateral position at the ego origin."""
        return float(self.track.state[0])


@dataclass(frozen=True)
class LanesState:
    """Both boundaries, the current lane change, and the number of lane changes.

    ``left_certain`` and ``right_certain`` are the last certain boundaries, moved to the last frame.
    """

    left: TrackedBoundary | None = None
    right: TrackedBoundary | None = None
    left_certain: TrackedBoundary | None = None
    right_certain: TrackedBoundary | None = None
    lane_change: LaneChange = "none"
    lane_changes: int = 0

    def side(self, side: Side) -> TrackedBoundary | None:
        """The boundary of one side; None if it is not tracked."""
        return self.left if side == "left" else self.right

    def with_side(self, side: Side, boundary: TrackedBoundary | None) -> "LanesState":
        """A copy of the state with another boundary on one side."""
        return replace(self, left=boundary) if side == "left" else replace(self, right=boundary)


def start(curve: Curve, stamp_ns: int) -> BoundaryTrack:
    """A new track: its state equals the first measurement."""
    mean = np.zeros(5)
    mean[_MEASURED] = curve.state
    P = np.zeros((5, 5))
    P[_RATE, _RATE] = _FIRST_RATE_STD_MPS**2
    P[_SLOPE, _SLOPE] = _SLOPE_STD_PER_M2**2
    P[_MEASURED, _SLOPE] = P[_SLOPE, _MEASURED] = -curve.per_slope * _SLOPE_STD_PER_M2**2
    by_slope = np.outer(curve.per_slope, curve.per_slope) * _SLOPE_STD_PER_M2**2
    P[_BLOCK] = curve.covariance + by_slope
    return BoundaryTrack(mean, P, stamp_ns, stamp_ns)


def predict(cfg: LanesConfig, track: BoundaryTrack, stamp_ns: int, moved: Odometry | None) -> BoundaryTrack:
    """The track at a later stamp: by the car's motion since the last one, else by its own rate.

    ``moved`` is in metres and has a covariance; None if it is unknown. The noise is that of continuous random walks, so
    the number of steps does not matter.
    """
    dt = (stamp_ns - track.stamp_ns) / NS_PER_S
    if moved is not None and moved.step is not None:
        return _moved(track, stamp_ns, dt, moved.step, np.reshape(moved.covariance, (6, 6)))
    F = np.eye(5)
    F[_OFFSET, _RATE] = dt
    Q = np.zeros((5, 5))
    _forget_slope(F, Q, dt / _SLOPE_S)
    Q[:2, :2] = cfg.process_noise**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    Q[_HEADING, _HEADING] = _HEADING_WALK**2 * dt
    Q[_CURVATURE, _CURVATURE] = _CURVATURE_WALK_PER_M**2 * dt
    return BoundaryTrack(F @ track.mean, F @ track.covariance @ F.T + Q, stamp_ns, track.measured_ns)


def _moved(track: BoundaryTrack, stamp_ns: int, dt: float, last_T_this: Float, step_covariance: Float) -> BoundaryTrack:
    """The track in the frame of the moved car; its covariance to first order in the angles between car and boundary."""
    dx, dy = float(last_T_this[0, 3]), float(last_T_this[1, 3])
    turn = float(np.arctan2(last_T_this[1, 0], last_T_this[0, 0]))
    F = np.zeros((5, 5))
    F[_OFFSET, [_OFFSET, _HEADING, _CURVATURE]] = 1.0, dx, dx**2 / 2
    F[_HEADING, [_HEADING, _CURVATURE]] = 1.0, dx
    F[_CURVATURE, _CURVATURE] = 1.0
    Q = np.zeros((5, 5))
    _forget_slope(F, Q, abs(dx) / _SLOPE_LENGTH_M)
    mean = track.mean.copy()
    mean[_MEASURED] = _seen_from(track.state, dx, dy, turn)
    mean[_SLOPE] *= F[_SLOPE, _SLOPE]
    # If the next motion is unknown, the prediction uses the rate of this step.
    mean[_RATE] = (mean[_OFFSET] - track.mean[_OFFSET]) / dt
    Q[_RATE, _RATE] = _MOVED_RATE_STD_MPS**2
    Q[_BLOCK] = _road_ahead(abs(dx), np.sign(dx))
    Q[_OFFSET_AND_HEADING] += step_covariance[_SIDEWAYS]
    return BoundaryTrack(mean, F @ track.covariance @ F.T + Q, stamp_ns, track.measured_ns)


def _forget_slope(F: Float, Q: Float, passed: float) -> None:
    """Write the slope's decay, and the noise that keeps its deviation, to a step's (5, 5) matrices."""
    F[_SLOPE, _SLOPE] = np.exp(-passed)
    Q[_SLOPE, _SLOPE] = _SLOPE_STD_PER_M2**2 * (1 - np.exp(-2 * passed))


def _seen_from(state: Float, dx: float, dy: float, turn: float) -> Float:
    """(3,) offset, heading and curvature in a frame at dx, dy turned by ``turn``: where its y axis meets the boundary.

    A first-order formula would err by offset * heading * turn: 2 mm per frame in a lane change, always to one side.
    """
    offset, heading, curvature = state
    x = dx
    for _ in range(_Y_AXIS_STEPS):
        aside = offset + heading * x + curvature * x**2 / 2 - dy
        x = dx - np.tan(turn) * aside
    return np.array([aside / np.cos(turn), np.tan(np.arctan(heading + curvature * x) - turn), curvature])


def _road_ahead(walked_m: float, direction: float) -> Float:
    """(3, 3) covariance of offset, heading and curvature after a random walk of all three along the road."""
    w, d = walked_m, direction
    rough = np.zeros((3, 3))
    rough[:2, :2] = _ROUGH_HEADING_PER_ROOT_M**2 * np.array([[w**3 / 3, d * w**2 / 2], [d * w**2 / 2, w]])
    rough[0, 0] += _ROUGH_OFFSET_ROOT_M**2 * w
    result: Float = _CURVATURE_WALK_ROOT_M**2 * _curvature_walk(w, d) + rough
    return result


def _curvature_walk(walked_m: float, direction: float) -> Float:
    """(3, 3) covariance of offset, heading and curvature after a random walk of the curvature: 1 per metre."""
    w, d = walked_m, direction
    return np.array(
        [
            [w**5 / 20, d * w**4 / 8, w**3 / 6],
            [d * w**4 / 8, w**3 / 3, d * w**2 / 2],
            [w**3 / 6, d * w**2 / 2, w],
        ]
    )


def update(cfg: LanesConfig, track: BoundaryTrack, curve: Curve) -> BoundaryTrack | None:
    """The track after a measurement at its stamp; None if the measurement is outside the gate.

    If prediction and measurement disagree, the covariance grows with their squared Mahalanobis distance (Birge, "The
    Calculation of Errors by the Method of Least Squares", Physical Review 40, 1932).
    """
    H = _H.copy()
    H[:, _SLOPE] = curve.per_slope
    innovation = curve.state - H @ track.mean
    S = H @ track.covariance @ H.T + curve.covariance
    distance = float(innovation @ np.linalg.solve(S, innovation))
    if distance > cfg.gate:
        return None
    gain = np.linalg.solve(S, H @ track.covariance).T
    rest = np.eye(5) - gain @ H
    # The Joseph form keeps the covariance symmetric and positive over thousands of frames.
    P = (rest @ track.covariance @ rest.T + gain @ curve.covariance @ gain.T) * max(distance / _CONTRADICTS, 1.0)
    return BoundaryTrack(track.mean + gain @ innovation, P, track.stamp_ns, track.stamp_ns)


def agree(one: BoundaryTrack, other: BoundaryTrack) -> bool:
    """Whether two tracks can be of the same boundary."""
    apart = other.state - one.state
    return float(apart @ np.linalg.solve(one.state_covariance + other.state_covariance, apart)) <= _CONTRADICTS


def shifted(track: BoundaryTrack, aside_m: float, std_m: float) -> BoundaryTrack:
    """The track moved to the left by a distance with a standard deviation."""
    mean, covariance = track.mean.copy(), track.covariance.copy()
    mean[_OFFSET] += aside_m
    covariance[_OFFSET, _OFFSET] += std_m**2
    return BoundaryTrack(mean, covariance, track.stamp_ns, track.measured_ns)


def lateral_at(track: BoundaryTrack, x_m: Float) -> Float:
    """Lateral positions (N,) at (N,) distances ahead, metres."""
    offset, _, heading, curvature, slope = track.mean.tolist()
    result: Float = offset + heading * x_m + curvature * x_m**2 / 2 + slope * x_m**3 / 6
    return result


def std_at(track: BoundaryTrack, x_m: float) -> float:
    """Standard deviation of the lateral position ``x_m`` ahead, metres."""
    design = np.array([1.0, 0.0, x_m, x_m**2 / 2, x_m**3 / 6])
    return math.sqrt(max(design @ track.covariance @ design, 0.0))  # rounding may make it negative


def expired(cfg: LanesConfig, track: BoundaryTrack) -> bool:
    """Whether the last measurement is older than ``lanes.hold_s``."""
    return (track.stamp_ns - track.measured_ns) / NS_PER_S > cfg.hold_s
