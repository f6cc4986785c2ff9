"""Where the cars went, seen from above."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.geometry import Float
from roadperc_stream.core.rotations import rotation_from_quaternion

from .figures import TRUTH_COLOUR, Figure, Trace, axis, colour_of, layout, line
from .series import BUCKETS, Series

_PLACE: Final = tuple(f"{{}}_{name}_m" for name in "xyz")
_TURN: Final = tuple(f"{{}}_q{name}" for name in "xyzw")
COLUMNS: Final = tuple(name.format(which) for which in ("odom", "true") for name in (*_PLACE, *_TURN))
"""What this chart needs of a table, where it has them."""


def trajectory(runs: Sequence[Series]) -> Figure | None:
    """Odometry's path and the true one in the ego frame of each run's first pose; None where no run has a pose."""
    traces = [trace for place, run in enumerate(runs) for trace in _traces(run, place, len(runs) > 1)]
    if not traces:
        return None
    note = "From above: ahead of the first frame is up, left is left; both axes to one scale, in metres."
    if any(np.ptp(run.segments) for run in runs):
        note += " Each segment of a log begins at the origin."
    if any(trace["line"]["dash"] != "solid" for trace in traces):
        note += " The true path is dashed."
    left = axis("y to the left, m", autorange="reversed")
    ahead = axis("x ahead, m", scaleanchor="x", scaleratio=1)
    return Figure("Trajectory", note, traces, layout("", "", hovermode="closest", height=440, xaxis=left, yaxis=ahead))


def paths(run: Series) -> dict[str, Float]:
    """(N, 3) metres of odometry's path (``odom``) and the true one (``true``), those there are, NaN where unknown.

    Whichever frame the poses are given in, the pose of the first frame that has all of them becomes the origin, x
    ahead: odometry's path and the truth are compared from the same start. Each segment of the log has its own start,
    for its odometry begins anew.
    """
    poses = {which: found for which in ("odom", "true") if (found := _poses(run, which)) is not None}
    known = np.all([_usable(found) for found in poses.values()], axis=0) if poses else np.zeros(1, bool)
    if not known.any():
        return {}
    return {which: _from_starts(found, known, run.segments) for which, found in poses.items()}


def _poses(run: Series, which: str) -> Float | None:
    """(N, 7) x, y, z and quaternion; None where the table has them not."""
    names = [name.format(which) for name in (*_PLACE, *_TURN)]
    if not all(name in run.values for name in names):
        return None
    return np.stack([run.values[name] for name in names], axis=-1)


def _usable(poses: Float) -> NDArray[np.bool_]:
    """(N,) poses that are known and have an orientation."""
    return np.asarray(np.isfinite(poses).all(axis=1) & (np.abs(poses[:, 3:]).max(axis=1) > 0))


def _from_starts(poses: Float, known: NDArray[np.bool_], segments: NDArray[np.int64]) -> Float:
    """(N, 3) positions of (N, 7) poses in the frame of the first known one of their segment; NaN in one without any."""
    points_m = np.full((len(poses), 3), np.nan)
    for segment in np.unique(segments[known]):
        these = segments == segment
        points_m[these] = _from_pose(poses[these], int(np.argmax(known[these])))
    return points_m


def _from_pose(poses: Float, first: int) -> Float:
    """(N, 3) positions in the frame of the ``first`` of (N, 7) poses."""
    qx, qy, qz, qw = (float(value) for value in poses[first, 3:])
    rotation = rotation_from_quaternion(qx, qy, qz, qw)
    return np.asarray((poses[:, :3] - poses[first, :3]) @ rotation, float)


def _traces(run: Series, place: int, several: bool) -> list[Trace]:
    names = {"odom": run.name if several else "odometry", "true": f"{run.name}: truth" if several else "truth"}
    looks = {
        "odom": (colour_of(place), {"width": 2.2, "dash": "solid"}),
        "true": (colour_of(place) if several else TRUTH_COLOUR, {"width": 1.6, "dash": "dash"}),
    }
    traces = []
    for which, points_m in paths(run).items():
        evenly = np.linspace(0, len(points_m) - 1, 3 * BUCKETS).astype(int)
        kept = np.union1d(evenly, np.flatnonzero(np.diff(run.segments)))
        colour, look = looks[which]
        traces.append(line(names[which], points_m[kept, 1], points_m[kept, 0], colour, **look))
    return traces
