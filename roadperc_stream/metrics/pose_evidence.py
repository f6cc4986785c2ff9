"""Findings on odometry against the poses of the log: scale, delay, and mirrored turns.

Scale: lengths between positions some metres apart. The noise of single poses hardly changes them. Delay: yaw rates of
both, correlated over offsets in whole frames; three correlations around the best one give its fraction.
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float
from roadperc_stream.metrics.spread import Spread, spread_of
from roadperc_stream.model.finding import Finding
from roadperc_stream.schemas.columns import FrameMetrics
from roadperc_stream.system.time import NS_PER_S

_WINDOW_M: Final = 3.0
_FEWEST_WINDOWS: Final = 4
_SCALE: Final = 0.05
_STDS: Final = 3.0
_SCALES: Final = (0.01, 100.0)
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
_LEAST_DELAY: Final = 0.5
_POSES: Final = "the poses (role truth_pose)"


class PoseEvidence:
    """Odometry and poses of a log, frame by frame, in bounded memory."""

    def __init__(self) -> None:
        self._windows = Spread[tuple[float, float]]()
        self._begin: tuple[Float, Float] | None = None
        self._std_m = 0.0
        self._last: tuple[int, Float, Float] | None = None
        self._own: deque[float] = deque(maxlen=_MOST_FRAMES + 1)
        self._true: deque[float] = deque(maxlen=_MOST_FRAMES + 1)
        self._sums = np.zeros((2 * _MOST_FRAMES + 1, 6))
        self._intervals_s = Spread[float]()
        self._turned = 0.0

    def add(self, row: FrameMetrics) -> None:
        """Count a frame."""
        poses = _poses_of(row)
        if poses is None:
            self._begin = self._last = None
            self._rates(math.nan, math.nan)
            return
        own, true = poses
        self._lengths(own, true, row)
        self._turns(row.stamp_ns, own, true, is_first=row.odometry_status == "first")

    def findings(self) -> Sequence[Finding | None]:
        """Scale and delay, None if they fit or the car hardly drove or turned."""
        return odometry_scale(self._windows.values), self._delay()

    def _lengths(self, own: Float, true: Float, row: FrameMetrics) -> None:
        """End a window if the car has driven far enough; a step without a length begins a new one."""
        if self._begin is None or row.step_m is None:
            self._begin, self._std_m = (own, true), 0.0
            return
        self._std_m += row.step_std_m or 0.0
        lengths = tuple(
            float(np.linalg.norm(now[:3] - begun[:3])) for now, begun in zip((own, true), self._begin, strict=True)
        )
        if max(lengths) >= _WINDOW_M:
            least, most = _SCALES
            ratio = min(max(lengths[0] / max(lengths[1], 1e-9), least), most)
            self._windows.add((ratio, self._std_m / max(lengths[0], 1e-9)))
            self._begin, self._std_m = (own, true), 0.0

    def _turns(self, stamp_ns: int, own: Float, true: Float, *, is_first: bool) -> None:
        """Add the yaw rates since the last frame."""
        last, self._last = self._last, (stamp_ns, own, true)
        if last is None or is_first or stamp_ns <= last[0]:
            self._rates(math.nan, math.nan)
            return
        seconds = (stamp_ns - last[0]) / NS_PER_S
        turns = _turn_between(last[1], own), _turn_between(last[2], true)
        self._turned += abs(turns[1])
        self._intervals_s.add(seconds)
        self._rates(turns[0] / seconds, turns[1] / seconds)

    def _rates(self, own: float, true: float) -> None:
        """Add the pairs of a new yaw rate with earlier ones to the sums of each offset; NaN if it is unknown."""
        self._own.append(own)
        self._true.append(true)
        for back in range(len(self._own)):
            self._pair(_MOST_FRAMES - back, own, self._true[-1 - back])
            if back:
                self._pair(_MOST_FRAMES + back, self._own[-1 - back], true)

    def _pair(self, place: int, own: float, true: float) -> None:
        if not math.isnan(own + true):
            self._sums[place] += (1.0, own, true, own * own, true * true, own * true)

    def _delay(self) -> Finding | None:
        if self._turned < _LEAST_TURN:
            return None
        return pose_delay(correlations(self._sums), self._sums[:, 0], spread_of(self._intervals_s.values)[0])


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
        f"odometry drives {scale:.3g} times as far as {_POSES}, expected within {_SCALE:.0%}; camera height, field of "
        "view, depth scale, baseline or the unit of the poses is wrong: pass --height or --fov, or correct the "
        "calibration",
    )


def correlations(sums: Float) -> Float:
    """(N,) correlations of two series from (N, 6) sums: count, a, b, a a, b b, a b; NaN without scatter."""
    count, a, b, aa, bb, ab = sums.T
    with np.errstate(invalid="ignore", divide="ignore"):
        return (count * ab - a * b) / np.sqrt((count * aa - a * a) * (count * bb - b * b))


def pose_delay(found: Float, counts: Float, interval_s: float) -> Finding | None:
    """Whether turns of the poses come before or after those of the images, or to the other side.

    Args:
        found: correlations of the yaw rates at each offset, from ``-_MOST_FRAMES`` on; the poses are late in positive
            ones.
        counts: number of pairs in each.
        interval_s: time between frames.
    """
    known = np.where(counts >= _FEWEST_PAIRS, np.nan_to_num(found), 0.0)
    if known.min() <= -_ALIKE and known.max() < _ALIKE:
        return Finding(
            "pose_mirrored",
            f"{_POSES} turn left where the images turn right, correlation {known.min():.2f}; the poses are left-handed "
            "(CARLA, Unreal): convert them to x forward, y left, z up",
        )
    best = int(np.argmax(known))
    unexplained, least = 1 - known[_MOST_FRAMES] ** 2, 1 - known[best] ** 2
    if known[best] < _ALIKE or best in (0, len(known) - 1):
        return None
    if unexplained <= max(_UNEXPLAINED, _WORSE * least):
        return None
    before, at, after = known[best - 1 : best + 2]
    bend = before - 2 * at + after
    frames = best - _MOST_FRAMES + (float(before - after) / (2 * float(bend)) if bend < 0 else 0.0)
    if abs(frames) <= _LEAST_DELAY:
        return None
    late = "after" if frames > 0 else "before"
    return Finding(
        "pose_delay",
        f"{_POSES} turn {abs(frames) * interval_s:.3f} s ({abs(frames):.1f} frames) {late} the images, expected within "
        "half a frame; their stamps are those of arrival, or of another clock: correct the stamps of the poses or of "
        "the images",
    )


def _poses_of(row: FrameMetrics) -> tuple[Float, Float] | None:
    """x, y, z and quaternion x, y, z, w of odometry and of the log's pose; None if one is unknown or lost."""
    own = (row.odom_x_m, row.odom_y_m, row.odom_z_m, row.odom_qx, row.odom_qy, row.odom_qz, row.odom_qw)
    true = (row.true_x_m, row.true_y_m, row.true_z_m, row.true_qx, row.true_qy, row.true_qz, row.true_qw)
    if row.odometry_status not in ("first", "tracked") or None in own or None in true:
        return None
    return np.array(own, float), np.array(true, float)


def _turn_between(before: Float, now: Float) -> float:
    """Angle about the vehicle's z axis between two poses of position and quaternion, radians."""
    x, y, z, w = before[3:]
    a, b, c, d = now[3:]
    about_z, real = w * c - z * d - x * b + y * a, w * d + x * a + y * b + z * c
    return 2 * math.atan2(math.copysign(1.0, real) * about_z, abs(real))
