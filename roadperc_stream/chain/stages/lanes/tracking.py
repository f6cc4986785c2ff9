"""One boundary over time: a Kalman filter on offset, heading and curvature in the ego frame.

Where the car's motion since the last frame is known from odometry, the boundary is moved against it; else the car's
sideways motion is a random acceleration, and heading and curvature are random walks (Bar-Shalom, Li and Kirubarajan
2001, chapter 6). A measurement outside the gate is rejected; a boundary without measurements is held, then lost.
"""

from dataclasses import dataclass

import numpy as np

from roadperc_stream.core.config import LanesConfig
from roadperc_stream.core.datatypes import read_only
from roadperc_stream.core.geometry import Float
from roadperc_stream.core.time import NS_PER_S

_OFFSET, _RATE, _HEADING, _CURVATURE = range(4)
_MEASURED = [_OFFSET, _HEADING, _CURVATURE]
_H = np.eye(4)[_MEASURED]
_FIRST_RATE_STD_MPS = 1.0
_HEADING_WALK = 0.02
"""Radians per root second."""
_CURVATURE_WALK_PER_M = 0.003
"""Per metre and root second."""
_STEP_STD_M = 0.005
_TURN_STD = 0.0015
"""How well a step and a turn are known, metres and radians; the road's own roughness included."""
_MOVED_RATE_STD_MPS = 0.3
_CURVATURE_WALK_ROOT_M = 0.001
"""Per metre and root metre driven: how fast roads change their curvature."""


@dataclass(frozen=True)
class BoundaryTrack:
    """(4,) offset m, its rate m/s, heading rad, curvature 1/m; (4, 4) covariance; when it was last measured."""

    mean: Float
    covariance: Float
    stamp_ns: int
    measured_ns: int

    def __post_init__(self) -> None:
        read_only(self.mean, np.float64, (4,), "mean")
        read_only(self.covariance, np.float64, (4, 4), "covariance")

    @property
    def state(self) -> Float:
        """(3,) offset, heading, curvature."""
        return self.mean[_MEASURED]

    @property
    def state_covariance(self) -> Float:
        """(3, 3) covariance of ``state``."""
        return self.covariance[np.ix_(_MEASURED, _MEASURED)]


def start(state: Float, covariance: Float, stamp_ns: int) -> BoundaryTrack:
    """A new track: its state equals the first measurement."""
    mean = np.zeros(4)
    mean[_MEASURED] = state
    P = np.zeros((4, 4))
    P[_RATE, _RATE] = _FIRST_RATE_STD_MPS**2
    P[np.ix_(_MEASURED, _MEASURED)] = covariance
    return BoundaryTrack(mean, P, stamp_ns, stamp_ns)


def predict(cfg: LanesConfig, track: BoundaryTrack, stamp_ns: int, last_T_this: Float | None) -> BoundaryTrack:
    """The track at a later stamp, by how the car moved since, or without that by its own rate.

    Args:
        cfg: noise of the sideways motion.
        track: at the last stamp.
        stamp_ns: the later one.
        last_T_this: (4, 4) motion of the ego frame between the stamps; None where it is not known.
    """
    if last_T_this is not None:
        return _moved(track, stamp_ns, last_T_this)
    dt = (stamp_ns - track.stamp_ns) / NS_PER_S
    F = np.eye(4)
    F[_OFFSET, _RATE] = dt
    pull = np.array([dt**2 / 2, dt])
    Q = np.zeros((4, 4))
    Q[:2, :2] = cfg.process_noise**2 * np.outer(pull, pull)
    Q[_HEADING, _HEADING] = _HEADING_WALK**2 * dt
    Q[_CURVATURE, _CURVATURE] = _CURVATURE_WALK_PER_M**2 * dt
    return BoundaryTrack(F @ track.mean, F @ track.covariance @ F.T + Q, stamp_ns, track.measured_ns)


def _moved(track: BoundaryTrack, stamp_ns: int, last_T_this: Float) -> BoundaryTrack:
    """The track in the frame of the moved car: to first order in the angles between car and boundary."""
    dx, dy = float(last_T_this[0, 3]), float(last_T_this[1, 3])
    turn = float(np.arctan2(last_T_this[1, 0], last_T_this[0, 0]))
    dt = (stamp_ns - track.stamp_ns) / NS_PER_S
    F = np.zeros((4, 4))
    F[_OFFSET, [_OFFSET, _HEADING, _CURVATURE]] = 1.0, dx, dx**2 / 2
    F[_HEADING, [_HEADING, _CURVATURE]] = 1.0, dx
    F[_CURVATURE, _CURVATURE] = 1.0
    mean = F @ track.mean
    mean[_OFFSET] -= dy
    mean[_HEADING] -= turn
    # Should the next motion not be known, the rate is that of this step.
    mean[_RATE] = (mean[_OFFSET] - track.mean[_OFFSET]) / dt
    walked = abs(dx)
    Q = np.diag([_STEP_STD_M**2, _MOVED_RATE_STD_MPS**2, _TURN_STD**2, _CURVATURE_WALK_ROOT_M**2 * walked])
    return BoundaryTrack(mean, F @ track.covariance @ F.T + Q, stamp_ns, track.measured_ns)


def update(cfg: LanesConfig, track: BoundaryTrack, state: Float, covariance: Float) -> BoundaryTrack | None:
    """The track after a measurement at its stamp; None where the measurement lies outside the gate."""
    innovation = state - _H @ track.mean
    S = _H @ track.covariance @ _H.T + covariance
    if float(innovation @ np.linalg.solve(S, innovation)) > cfg.gate:
        return None
    gain = np.linalg.solve(S, _H @ track.covariance).T
    rest = np.eye(4) - gain @ _H
    # Joseph's form keeps the covariance symmetric and positive over thousands of frames.
    P = rest @ track.covariance @ rest.T + gain @ covariance @ gain.T
    return BoundaryTrack(track.mean + gain @ innovation, P, track.stamp_ns, track.stamp_ns)


def expired(cfg: LanesConfig, track: BoundaryTrack) -> bool:
    """Whether the track was last measured longer ago than it may be held."""
    return (track.stamp_ns - track.measured_ns) / NS_PER_S > cfg.hold_s
