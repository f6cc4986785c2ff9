"""Errors by hindsight: what the chain claimed, against what it found later, nearer or with more frames.

The place 10 m ahead is claimed in each frame. A few frames later the car is there, and the chain measures the same
place far better; the odometry carries the place from one frame to the other. Distances, closing speeds and steps are
compared with those before and after them. No truth is needed. docs/hindsight.md has the limits.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float
from roadperc_stream.geometry.arrays import Mask
from roadperc_stream.geometry.ground import height_at
from roadperc_stream.geometry.rotations import rotations_from_quaternions
from roadperc_stream.metrics.lanes import LANE_ERROR_AT_M
from roadperc_stream.metrics.smoothing import JITTER_NS, Smoothed, smoothed
from roadperc_stream.model import SIDES, Absent, Boundary, FrameResult, Lanes
from roadperc_stream.system.time import NS_PER_S

Rows = Mapping[str, NDArray[Any]]
"""Columns of a table by name, (N,) each; unknown numbers are NaN."""
_FOUND_M: Final = (-3.0, 4.0)
"""Distance ahead (ego x) at which a place is found again: nearer than any claim, and not much behind the axle."""
_OTHER_LINE_M: Final = 1.75
"""A boundary that was lost and found again farther off than half a lane is another line."""
_LATEST_NS: Final = 20 * NS_PER_S
"""A place that the car reaches later than this is not compared."""
_STATE: Final = 3
_SIDE: Final = _STATE + _STATE * (_STATE + 1) // 2
_UPPER: Final = np.triu_indices(_STATE)
CLAIMS: Final = 2 * _SIDE + 4
"""Numbers that a frame keeps beside its row: 176 bytes."""
REACH_S: Final = 1.0
"""Time before and after a detection, in which its track judges it."""
_SPEED_NOISE: Final = 1.5
"""Standard deviation of the change of a closing speed within a second, m/s: the default of the chain's filter. The
judge does not change with a setting under test."""
_STEP_REACH_S: Final = 0.5
_JERK_NOISE: Final = 0.5
"""Standard deviation of the change of a car's acceleration within a second, m/s2. Harder braking has no answer."""
_POSE: Final = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
FRAME_COLUMNS: Final = (
    *("frame", "stamp_ns", "segment", "lane_change", "lane_changes", "lane_left_status", "lane_right_status"),
    *("surface_source", "odometry_status", "step_m", "step_std_m", "turn_std_deg"),
    *(f"odom_{name}" for name in _POSE),
)
OBJECT_COLUMNS: Final = (
    *("frame", "stamp_ns", "track_id", "kept", "distance_m", "distance_std_m", "closing_speed_mps"),
    *("closing_speed_std_mps", "time_to_impact_s", "time_to_impact_std_s"),
)


def claims_of(result: FrameResult) -> tuple[float, ...]:
    """What a frame claims beyond its row, NaN if unknown.

    Offset, heading, curvature and the upper half of their covariance for each side, then the road: its heights 10 m
    ahead, at the ego origin and ``_FOUND_M`` ahead, and its slope to the left.
    """
    found = [_boundary(result.lanes.side(side)) if isinstance(result.lanes, Lanes) else () for side in SIDES]
    numbers = [number for side in found for number in (side or (np.nan,) * _SIDE)]
    if isinstance(result.surface, Absent) or result.surface.source == "assumed":
        return (*numbers, *(np.nan,) * 4)
    x_m = np.array((LANE_ERROR_AT_M, 0.0, _FOUND_M[1]))
    heights_m = height_at(result.surface, x_m, np.zeros_like(x_m))
    return (*numbers, *heights_m.tolist(), -result.surface.abd[1])


def _boundary(boundary: Boundary) -> tuple[float, ...]:
    state = (boundary.offset_m, boundary.heading, boundary.curvature_per_m)
    if any(value is None for value in state) or not boundary.covariance:
        return ()
    covariance = np.reshape(boundary.covariance, (_STATE, _STATE))
    return (*(float(value) for value in state if value is not None), *(float(v) for v in covariance[_UPPER]))


@dataclass(frozen=True)
class _Drive:
    """(N,) frames of a replay with their poses; odometry joins those with equal ``piece``."""

    stamp_ns: NDArray[np.int64]
    rotation: Float
    place_m: Float
    piece: Float
    """NaN for frames without a pose."""
    turn_var: Float


def frame_hindsight(rows: Rows, claims: Float) -> dict[str, Float]:
    """The columns of a table of frames by hindsight, (N,) each, NaN without an answer.

    Args:
        rows: ``FRAME_COLUMNS`` of the table.
        claims: (N, CLAIMS) what ``claims_of`` gave for each frame.
    """
    drive = _drive(rows)
    lane = np.where(rows["lane_change"] == "none", rows["lane_changes"].astype(float), np.nan)
    found: dict[str, Float] = {}
    for number, side in enumerate(SIDES):
        state = claims[:, _SIDE * number : _SIDE * (number + 1)]
        status = rows[f"lane_{side}_status"]
        measured = (status == "measured") & np.isfinite(state[:, 0])
        errors = _lane(drive, state, measured, lane, np.cumsum(status == "lost"))
        names = (f"lane_{side}_hindsight_{what}" for what in ("m", "std_m", "frame"))
        found |= zip(names, (*errors[:2], _frames(rows, errors[2])), strict=True)
    surface = claims[:, 2 * _SIDE :]
    measured = np.isfinite(surface[:, 0]) & ~np.isin(rows["surface_source"], ("held", "estimated"))
    found["surface_height_hindsight_m"], at = _height(drive, surface, measured)
    found["surface_height_hindsight_frame"] = _frames(rows, at)
    return found | _steps(rows)


def _drive(rows: Rows) -> _Drive:
    pose = np.stack([rows[f"odom_{name}"].astype(float) for name in _POSE], axis=1)
    posed = np.isin(rows["odometry_status"], ("tracked", "first")) & np.isfinite(pose[:, 0])
    begins = ~posed | (rows["odometry_status"] == "first")
    begins[1:] |= rows["segment"][1:] != rows["segment"][:-1]
    turn_std = np.radians(rows["turn_std_deg"].astype(float))
    return _Drive(
        rows["stamp_ns"],
        rotations_from_quaternions(pose[:, 3:]),
        pose[:, :3],
        np.where(posed, np.cumsum(begins), np.nan),
        np.nan_to_num(turn_std) ** 2,
    )


def _found_again(drive: _Drive, ahead: Float, measured: Mask) -> Iterator[tuple[NDArray[Any], ...]]:
    """Where each frame's place ahead is found again.

    Yields:
        claiming and finding frames, (M,) each; the place in the finding frame, (M, 3); and the variance across the path
        that the turns between them add, (M,) square metres.
    """
    open_ = np.flatnonzero(np.isfinite(ahead).all(axis=1) & np.isfinite(drive.piece))
    world = np.einsum("nij,nj->ni", drive.rotation[open_], ahead[open_]) + drive.place_m[open_]
    turned = np.zeros(len(open_))
    for lag in range(1, len(drive.stamp_ns)):
        joined = open_ + lag < len(drive.stamp_ns)
        open_, world, turned = open_[joined], world[joined], turned[joined]
        later = open_ + lag
        joined = drive.piece[later] == drive.piece[open_]
        joined &= drive.stamp_ns[later] - drive.stamp_ns[open_] <= _LATEST_NS
        open_, later, world, turned = open_[joined], later[joined], world[joined], turned[joined]
        if not len(open_):
            return
        place = np.einsum("nji,nj->ni", drive.rotation[later], world - drive.place_m[later])
        turned = turned + drive.turn_var[later] * place[:, 0] ** 2
        passed = place[:, 0] < _FOUND_M[0]
        found = (place[:, 0] < _FOUND_M[1]) & measured[later] & ~passed
        yield open_[found], later[found], place[found], turned[found]
        open_, world, turned = open_[~(found | passed)], world[~(found | passed)], turned[~(found | passed)]


def _lane(
    drive: _Drive, state: Float, measured: Mask, lane: Float, losses: NDArray[np.intp]
) -> tuple[Float, Float, Float]:
    """Error of a boundary 10 m ahead, its standard deviation, and the row that found it.

    ``lane`` numbers the lanes, NaN over a line; ``losses`` counts the frames in which the boundary was lost.
    """
    error, std, at = np.full((3, len(state)), np.nan)
    x = np.full(len(state), LANE_ERROR_AT_M)
    ahead = np.stack([x, _lateral(state, x), np.zeros(len(state))], axis=1)
    for found in _found_again(drive, ahead, measured):
        same = lane[found[0]] == lane[found[1]]
        here, later, place, turned = (part[same] for part in found)
        off_m = place[:, 1] - _lateral(state[later], place[:, 0])
        off_m[(np.abs(off_m) > _OTHER_LINE_M) & (losses[here] != losses[later])] = np.nan
        error[here], at[here] = off_m, later
        std[here] = np.sqrt(_lateral_var(state[here], x[here]) + _lateral_var(state[later], place[:, 0]) + turned)
    return error, *np.where(np.isfinite(error), [std, at], np.nan)


def _lateral(state: Float, x: Float) -> Float:
    return state[:, 0] + state[:, 1] * x + 0.5 * state[:, 2] * x**2


def _lateral_var(state: Float, x: Float) -> Float:
    """Variance of a boundary's lateral position at ego x."""
    weights = np.stack([np.ones_like(x), x, 0.5 * x**2], axis=1)
    first, second = _UPPER
    twice = np.where(first == second, 1.0, 2.0)
    variance: Float = (state[:, _STATE:_SIDE] * weights[:, first] * weights[:, second] * twice).sum(axis=1)
    return variance


def _height(drive: _Drive, surface: Float, measured: Mask) -> tuple[Float, Float]:
    """Error of the road's height 10 m ahead, and the row that found it."""
    error, at = np.full((2, len(surface)), np.nan)
    x = np.full(len(surface), LANE_ERROR_AT_M)
    for here, later, place, _ in _found_again(drive, np.stack([x, np.zeros_like(x), surface[:, 0]], axis=1), measured):
        here_m, ahead_m, slope = surface[later, 1:].T
        found_m = here_m + (ahead_m - here_m) * place[:, 0] / _FOUND_M[1] + slope * place[:, 1]
        error[here], at[here] = place[:, 2] - found_m, later
    return error, at


def _frames(rows: Rows, at: Float) -> Float:
    """The frame of each row ``at``, NaN if unknown."""
    known = np.isfinite(at)
    frames = np.full(len(at), np.nan)
    frames[known] = rows["frame"][at[known].astype(int)]
    return frames


def _steps(rows: Rows) -> dict[str, Float]:
    """Errors of the steps by those before and after them, as speeds over the time of each."""
    stamp_ns, step_m, std_m = rows["stamp_ns"], rows["step_m"].astype(float), rows["step_std_m"].astype(float)
    error, std = np.full((2, len(stamp_ns)), np.nan)
    took_s = np.diff(stamp_ns, prepend=stamp_ns[:1]) / NS_PER_S
    tracked = rows["odometry_status"] == "tracked"
    # After lost frames a step covers their time, too.
    follows = np.append(False, tracked[:-1] | (rows["odometry_status"][:-1] == "first"))
    known = tracked & follows & np.isfinite(step_m) & (std_m > 0) & (took_s > 0)
    for segment in np.unique(rows["segment"]):
        own = np.flatnonzero(known & (rows["segment"] == segment))
        speed_mps, speed_std_mps = step_m[own] / took_s[own], std_m[own] / took_s[own]
        speed = smoothed(stamp_ns[own], speed_mps, speed_std_mps, _JERK_NOISE, _STEP_REACH_S)
        better = speed.value_std <= speed_std_mps
        error[own] = np.where(better, step_m[own] - speed.value * took_s[own], np.nan)
        std[own] = np.where(better, np.hypot(std_m[own], speed.value_std * took_s[own]), np.nan)
    return {"step_hindsight_m": error, "step_hindsight_std_m": std}


def object_hindsight(rows: Rows) -> dict[str, Float]:
    """The columns of a table of objects by hindsight, (N,) each, NaN without an answer.

    Args:
        rows: ``OBJECT_COLUMNS`` of the table.
    """
    number = {name: rows[name].astype(float) for name in OBJECT_COLUMNS[4:]}
    names = ("object_distance", "m"), ("closing_speed", "mps"), ("time_to_impact", "s")
    found = {
        f"{name}_hindsight_{kind}{unit}": np.full(len(rows["frame"]), np.nan)
        for name, unit in names
        for kind in ("", "std_")
    }
    usable = rows["kept"].astype(bool) & (rows["track_id"] != "") & (number["distance_std_m"] > 0)
    usable &= np.isfinite(number["distance_m"])
    order = np.flatnonzero(usable)[np.argsort(rows["track_id"][usable], kind="stable")]
    tracks = np.split(order, np.flatnonzero(rows["track_id"][order][1:] != rows["track_id"][order][:-1]) + 1)
    for own in tracks:
        stamp_ns = rows["stamp_ns"][own]
        if (np.diff(stamp_ns) <= 0).any():
            continue
        distance_m, std_m = number["distance_m"][own], number["distance_std_m"][own]
        at = smoothed(stamp_ns, distance_m, std_m, _SPEED_NOISE, REACH_S)
        better = at.value_std <= std_m
        for name, values in _of_track({key: values[own] for key, values in number.items()}, at).items():
            found[name][own[better]] = values[better]
    return found


def _of_track(claimed: Mapping[str, Float], at: Smoothed) -> dict[str, Float]:
    """Errors and deviations of one track's claims."""
    speed_mps = -at.rate
    nears = speed_mps > 2 * at.rate_std
    with np.errstate(divide="ignore", invalid="ignore"):
        impact_s = np.where(nears, at.value / speed_mps, np.nan)
        impact_std_s = np.hypot(at.value_std, impact_s * at.rate_std) / speed_mps
    return {
        "object_distance_hindsight_m": claimed["distance_m"] - at.value,
        "object_distance_hindsight_std_m": np.hypot(claimed["distance_std_m"], at.value_std),
        "closing_speed_hindsight_mps": claimed["closing_speed_mps"] - speed_mps,
        "closing_speed_hindsight_std_mps": np.hypot(claimed["closing_speed_std_mps"], at.rate_std),
        "time_to_impact_hindsight_s": claimed["time_to_impact_s"] - impact_s,
        "time_to_impact_hindsight_std_s": np.hypot(claimed["time_to_impact_std_s"], impact_std_s),
    }


def objects_in_frames(frames: Rows, rows: Rows, found: Mapping[str, Float]) -> dict[str, Float]:
    """The columns of a table of frames that objects give.

    They are the mean absolute error of the distances, and the error of the shortest time to impact. The last second has
    none: tracks that go on there are open.

    Args:
        frames: ``FRAME_COLUMNS`` of the table.
        rows: ``OBJECT_COLUMNS`` of the table of objects.
        found: what ``object_hindsight`` gave.
    """
    count, stamp_ns = len(frames["frame"]), frames["stamp_ns"]
    row = np.searchsorted(frames["frame"], rows["frame"])
    closed = stamp_ns + REACH_S * NS_PER_S <= stamp_ns[-1:] + JITTER_NS
    error_m = np.abs(found["object_distance_hindsight_m"])
    known = np.isfinite(error_m)
    counts = np.bincount(row[known], minlength=count)
    sums_m = np.bincount(row[known], error_m[known], minlength=count)
    mean_m = np.where(closed & (counts > 0), sums_m / np.maximum(counts, 1), np.nan)
    impact_s = np.where(rows["kept"].astype(bool), rows["time_to_impact_s"].astype(float), np.nan)
    later_first = np.lexsort((-impact_s, row))  # the last of a frame's is its shortest
    later_first = later_first[np.isfinite(impact_s[later_first])]
    shortest_s = np.full(count, np.nan)
    shortest_s[row[later_first]] = found["time_to_impact_hindsight_s"][later_first]
    return {"object_distance_hindsight_m": mean_m, "time_to_impact_hindsight_s": shortest_s}
