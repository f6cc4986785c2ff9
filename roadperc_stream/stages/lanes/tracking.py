"""One boundary over time: a Kalman filter on offset, heading and curvature in the ego frame.

The car's sideways motion is a random acceleration, heading and curvature wander (Bar-Shalom, Li and Kirubarajan 2001,
chapter 6). A measurement outside the gate is not taken; a boundary unseen is held, then lost.
"""

from dataclasses import dataclass

import numpy as np

from roadperc_stream.config import LanesConfig
from roadperc_stream.geometry import Float

_OFFSET, _RATE, _HEADING, _CURVATURE = range(4)
_MEASURED = [_OFFSET, _HEADING, _CURVATURE]
_H = np.eye(4)[_MEASURED]
_FIRST_RATE_STD_MPS = 1.0
_HEADING_WALK = 0.02
"""Radians per root second."""
_CURVATURE_WALK_PER_M = 0.003
"""Per metre and root second."""
_NANOSECONDS = 1e9


@dataclass(frozen=True)
class Track:
    """(4,) offset m, its rate m/s, heading rad, curvature 1/m; (4, 4) covariance; when it was last measured."""

    mean: Float
    covariance: Float
    stamp_ns: int
    measured_ns: int

    @property
    def state(self) -> Float:
        """(3,) offset, heading, curvature."""
        return self.mean[_MEASURED]

    @property
    def state_covariance(self) -> Float:
        """(3, 3) covariance of ``state``."""
        return self.covariance[np.ix_(_MEASURED, _MEASURED)]


def start(state: Float, covariance: Float, stamp_ns: int) -> Track:
    """A new track: its state equals the first measurement."""
    mean = np.zeros(4)
    mean[_MEASURED] = state
    P = np.diag([0.0, _FIRST_RATE_STD_MPS**2, 0.0, 0.0])
    P[np.ix_(_MEASURED, _MEASURED)] = covariance
    return Track(mean, P, stamp_ns, stamp_ns)


def predict(cfg: LanesConfig, track: Track, stamp_ns: int) -> Track:
    """The track at a later stamp."""
    dt = (stamp_ns - track.stamp_ns) / _NANOSECONDS
    F = np.eye(4)
    F[_OFFSET, _RATE] = dt
    Q = np.diag([0.0, 0.0, _HEADING_WALK**2 * dt, _CURVATURE_WALK_PER_M**2 * dt])
    pull = np.array([dt**2 / 2, dt])
    Q[:2, :2] = cfg.process_noise**2 * np.outer(pull, pull)
    return Track(F @ track.mean, F @ track.covariance @ F.T + Q, stamp_ns, track.measured_ns)


def update(cfg: LanesConfig, track: Track, state: Float, covariance: Float) -> Track | None:
    """The track after a measurement at its stamp; None where the measurement lies outside the gate."""
    innovation = state - _H @ track.mean
    S = _H @ track.covariance @ _H.T + covariance
    if float(innovation @ np.linalg.solve(S, innovation)) > cfg.gate:
        return None
    gain = np.linalg.solve(S, _H @ track.covariance).T
    rest = np.eye(4) - gain @ _H
    # Joseph's form keeps the covariance symmetric and positive over thousands of frames.
    P = rest @ track.covariance @ rest.T + gain @ covariance @ gain.T
    return Track(track.mean + gain @ innovation, P, track.stamp_ns, track.stamp_ns)


def expired(cfg: LanesConfig, track: Track) -> bool:
    """Whether the track was last measured longer ago than it may be held."""
    return (track.stamp_ns - track.measured_ns) / _NANOSECONDS > cfg.hold_s
