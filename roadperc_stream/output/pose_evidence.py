"""Findings on odometry against the poses of the log: scale, delay, and mirrored turns.

Scale: distances between positions some metres apart, which the noise of single poses hardly changes. Delay: yaw rates
of both, correlated over offsets in whole frames.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float
from roadperc_stream.model.finding import Finding
from roadperc_stream.output.spread import Spread, spread_of
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.system.text import number
from roadperc_stream.system.time import NS_PER_S

_WINDOW_M: Final = 3.0
_FEWEST_WINDOWS: Final = 4
_SCALE: Final = 0.05
_STDS: Final = 3.0
_MOST_SCALE: Final = 100.0
_MOST_TURNS: Final = 2**16
"""Frames whose turns are kept, an hour at 20 Hz."""
_MOST_FRAMES: Final = 10
"""Largest offset that is searched."""
_FEWEST_PAIRS: Final = 30
_ALIKE: Final = 0.95
"""Least correlation of yaw rates at the right offset."""
_LEAST_TURN: Final = math.radians(10)
"""Sum of all turns below which the car does not turn."""
_WORSE: Final = 4.0
"""Factor by which the unexplained share of the yaw rates without an offset exceeds that with the best one."""
_UNEXPLAINED: Final = 0.005
_POSES: Final = "the poses (role truth_pose)"
_Pair = tuple[Float, Float]
"""Pose by odometry and pose of the log: (7,) position and quaternion x, y, z, w."""


class PoseEvidence:
    """Odometry and poses of a log, frame by frame, in bounded memory."""

    def __init__(self) -> None:
        self._windows, self._std_m = Spread[tuple[float, float]](), 0.0
        self._begin: _Pair | None = None
        self._last: tuple[int, _Pair] | None = None
        self._turns: list[tuple[float, float, float]] = []

    def add(self, row: FrameMetrics) -> None:
        """Count a frame."""
        poses, turns, last = _poses_of(row), (math.nan, math.nan), self._last
        self._add_step(poses, row)
        seconds = (row.stamp_ns - last[0]) / NS_PER_S if last else 0.0
        if poses and last and row.odometry_status != "first" and seconds > 0:
            turns = _turn_between(last[1][0], poses[0]), _turn_between(last[1][1], poses[1])
        if len(self._turns) < _MOST_TURNS:
            self._turns.append((*turns, seconds))
        self._last = None if poses is None else (row.stamp_ns, poses)

    def _add_step(self, poses: _Pair | None, row: FrameMetrics) -> None:
        """End a window if the car has driven far enough; a step without a length begins a new one."""
        begin, self._std_m = self._begin, self._std_m + (row.step_std_m or 0.0)
        if poses and begin and row.step_m is not None:
            own_m, true_m = (math.dist(now[:3], then[:3]) for now, then in zip(poses, begin, strict=True))
            if max(own_m, true_m) < _WINDOW_M:
                return
            ratio = own_m / max(true_m, own_m / _MOST_SCALE)
            if math.isfinite(ratio):
                self._windows.add((ratio, self._std_m / max(own_m, true_m)))
        self._begin, self._std_m = poses, 0.0

    def findings(self) -> Sequence[Finding | None]:
        """Scale and delay; None if they fit, or if the car hardly drove or turned."""
        own, true, seconds = np.array(self._turns, float).reshape(-1, 3).T
        scale, known = odometry_scale(self._windows.values), ~np.isnan(own)
        if np.abs(true[known]).sum() < _LEAST_TURN:
            return (scale,)
        with np.errstate(invalid="ignore", divide="ignore"):
            found = correlations(own / seconds, true / seconds)
        return scale, pose_delay(found, float(np.median(seconds[known])))


def odometry_scale(windows: Sequence[tuple[float, float]]) -> Finding | None:
    """Whether odometry and poses differ in length; ``windows`` have their ratio and its relative deviation."""
    if len(windows) < _FEWEST_WINDOWS:
        return None
    scale, scatter = spread_of([ratio for ratio, _ in windows])
    claimed, _ = spread_of([std for _, std in windows])
    if abs(scale - 1) <= max(_SCALE, _STDS * claimed, _STDS * scatter / math.sqrt(len(windows))):
        return None
    return Finding(
        "odometry_scale",
        f"odometry drives {scale:.3g} times as far as {_POSES}, expected within {100 * _SCALE:g} %; camera height, "
        "field of view, scale of the depth, baseline or the unit of the poses is wrong: pass --height, --fov or "
        "--calibration, or correct the poses",
    )


def correlations(own: Float, true: Float) -> Float:
    """(2 K + 1,) correlations of two (N,) series, the second one -K to K frames later; 0 with too few known pairs."""
    found = np.zeros(2 * _MOST_FRAMES + 1)
    for place, late in enumerate(range(-_MOST_FRAMES, _MOST_FRAMES + 1)):
        count = max(len(own) - abs(late), 0)
        pairs = np.stack((own[max(-late, 0) :][:count], true[max(late, 0) :][:count]))
        pairs = pairs[:, ~np.isnan(pairs).any(axis=0)]
        if pairs.shape[1] >= _FEWEST_PAIRS and pairs.std(axis=1).min() > 0:
            found[place] = np.corrcoef(*pairs)[0, 1]
    return found


def pose_delay(found: Float, interval_s: float) -> Finding | None:
    """Whether turns of the poses come before or after those of the images, or to the other side.

    ``found`` are correlations of the yaw rates at each offset, from ``-_MOST_FRAMES`` frames of ``interval_s`` on; the
    poses are late at positive ones.
    """
    best = int(np.argmax(found))
    if found.min() <= -_ALIKE and found[best] < _ALIKE:
        return Finding(
            "pose_mirrored",
            f"{_POSES} turn left where the images turn right, correlation {found.min():.2f}; the poses are left-handed "
            "(CARLA, Unreal): convert them to x forward, y left, z up",
        )
    unexplained, least = 1 - found[_MOST_FRAMES] ** 2, 1 - found[best] ** 2
    at_end = best in (0, len(found) - 1)
    if found[best] < _ALIKE or at_end or unexplained <= max(_UNEXPLAINED, _WORSE * least):
        return None
    frames = best - _MOST_FRAMES
    apart = f"{abs(frames) * interval_s:.3f} s ({number(abs(frames), 'frame')}) {'after' if frames > 0 else 'before'}"
    return Finding(
        "pose_delay",
        f"{_POSES} turn {apart} the images, expected within half a frame; "
        "their stamps are those of arrival, or of another clock: correct the stamps",
    )


def _poses_of(row: FrameMetrics) -> _Pair | None:
    """The pose by odometry and that of the log; None if one is unknown or lost."""
    own = (row.odom_x_m, row.odom_y_m, row.odom_z_m, row.odom_qx, row.odom_qy, row.odom_qz, row.odom_qw)
    true = (row.true_x_m, row.true_y_m, row.true_z_m, row.true_qx, row.true_qy, row.true_qz, row.true_qw)
    if row.odometry_status not in ("first", "tracked") or None in own or None in true:
        return None
    return np.array(own, float), np.array(true, float)


def _turn_between(before: Float, now: Float) -> float:
    """Angle about the vehicle's z axis between two poses, radians."""
    x, y, z, w = before[3:]
    a, b, c, d = now[3:]
    about_z, real = w * c - z * d - x * b + y * a, w * d + x * a + y * b + z * c
    return 2 * math.atan2(math.copysign(1.0, real) * about_z, abs(real))
