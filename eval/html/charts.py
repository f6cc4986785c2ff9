"""Charts without a time axis: distributions of the errors, and the trajectories from above."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from roadperc_stream.geometry import Float

from ..report.full_tables import better
from ..report_columns import ERRORS
from ..trajectory.poses import ESTIMATED_COLUMNS, TRUE_COLUMNS, known_poses
from .figures import TRUTH_COLOUR, Figure, Series, Trace, axis, colour_of, layout, line, numbers, thinned, wider

_POINTS: Final = 900
"""Most points of a path."""
_SHARES: Final = np.linspace(0, 1, 201)
ERROR_COLUMNS: Final = tuple(quantity.column for quantity in ERRORS)
"""Columns of the distributions."""
POSE_COLUMNS: Final = (*ESTIMATED_COLUMNS, *TRUE_COLUMNS)
"""Columns of the trajectory."""
SCALE_COLUMNS: Final = ("turn_deg", "step_m")
"""A step without scale has only the first of these."""
Paths = dict[str, Float]
"""(N, 6) poses by path, from ``paths``."""


def distributions(runs: Sequence[Series]) -> Iterator[Figure]:
    """The cumulative distribution of each error that has values, the runs over each other."""
    for quantity in ERRORS:
        traces = [
            line(
                run.name,
                np.nanquantile(run.values[quantity.column], _SHARES),
                100 * _SHARES,
                colour_of(place),
                wider=wider(runs, place, quantity.column),
            )
            for place, run in enumerate(runs)
            if quantity.column in run.values
        ]
        if traces:
            look = layout(quantity.label, "frames up to here, %", height=230, showlegend=len(runs) > 1)
            yield Figure(quantity.label, f"{quantity.column}; {better(quantity)}", traces, look)


def trajectory(runs: Sequence[Series], found: Sequence[Paths]) -> Iterator[Figure]:
    """Odometry's path and the true path from above, in the frame of each run's first pose, and the position error.

    The path of a single run has the colours of its error. Nothing is drawn if no run has a pose.
    """
    pairs = [*enumerate(zip(runs, found, strict=True))]
    traces = [trace for at, (run, path) in pairs for trace in _traces(run, path, at, len(runs) > 1)]
    if not traces:
        return
    unit = "no scale" if any(map(without_scale, runs)) else "m"
    note = "From above: ahead of the first frame is up, left is left; both axes have one scale."
    if any(np.ptp(run.segments) for run in runs):
        note += " Each segment of a log begins at the origin."
    if any(trace["line"]["dash"] != "solid" for trace in traces):
        note += " The true path is dashed."
    both = [(at, run, path) for at, (run, path) in pairs if path.keys() >= {"odom", "true"}]
    errors = [(at, run, path) for at, run, path in both if not without_scale(run)]
    if len(runs) == 1 and errors:
        traces.append(_coloured_by_error(runs[0], found[0]))
    left = axis(f"y to the left, {unit}", autorange="reversed")
    ahead = axis(f"x ahead, {unit}", scaleanchor="x", scaleratio=1)
    yield Figure("Trajectory", note, traces, layout("", "", hovermode="closest", height=440, xaxis=left, yaxis=ahead))
    if errors:
        look = layout("distance driven, m", "position error, m", showlegend=len(runs) > 1)
        lines = [_over_distance(run, path, at) for at, run, path in errors]
        yield Figure("Position error over distance", "Without alignment: both paths begin at one pose.", lines, look)


def without_scale(run: Series) -> bool:
    """Whether most steps of a run have no scale, so that its path is not in metres."""
    turned, metric = (int(np.isfinite(run.values.get(name, np.zeros(0))).sum()) for name in SCALE_COLUMNS)
    return 2 * metric < turned


def _over_distance(run: Series, found: Paths, at: int) -> Trace:
    """The position error over the distance driven; segments follow each other."""
    error_m = _position_error_m(found)
    known = np.isfinite(error_m)
    true_m, segments, error_m = found["true"][known, :3], run.segments[known], error_m[known]
    steps_m = np.linalg.norm(np.diff(true_m, axis=0, prepend=true_m[:1]), axis=1)
    driven_m = np.cumsum(np.where(np.diff(segments, prepend=segments[:1]) == 0, steps_m, 0.0))
    kept = thinned(error_m)
    return line(run.name, driven_m[kept], error_m[kept], colour_of(at))


def _position_error_m(found: Paths) -> Float:
    """(N,) distances between the estimated and the true positions; NaN where one is unknown."""
    error_m: Float = np.linalg.norm(found["odom"][:, :3] - found["true"][:, :3], axis=1)
    return error_m


def _coloured_by_error(run: Series, found: Paths) -> Trace:
    kept = _evenly(run)
    poses, error_m = found["odom"][kept], _position_error_m(found)[kept]
    bar = {"title": {"text": "position error, m"}, "thickness": 12, "exponentformat": "none"}
    marker = {"color": numbers(error_m), "colorscale": "Portland", "size": 5, "colorbar": bar}
    points = {"mode": "markers", "showlegend": False, "hovertemplate": "error %{marker.color} m<extra></extra>"}
    return {**line("error", poses[:, 1], poses[:, 0], TRUTH_COLOUR), **points, "marker": marker}


def _evenly(run: Series) -> NDArray[np.intp]:
    evenly = np.linspace(0, len(run.segments) - 1, _POINTS).astype(int)
    return np.union1d(evenly, np.flatnonzero(np.diff(run.segments)))


def paths(run: Series) -> Paths:
    """(N, 6) poses of odometry's path (``odom``) and the true path (``true``), if present, NaN if unknown.

    A pose is x, y, z in metres and roll, pitch, yaw in degrees. The pose of the first frame with all poses becomes the
    origin, with x ahead, so that both paths have the same start. Each segment has a separate start, because its
    odometry restarts.
    """
    poses = {  # (N, 7) x, y, z and quaternion
        which: np.stack([run.values[name] for name in columns], axis=-1)
        for which, columns in (("odom", ESTIMATED_COLUMNS), ("true", TRUE_COLUMNS))
        if all(name in run.values for name in columns)
    }
    known = np.all([known_poses(found) for found in poses.values()], axis=0) if poses else np.zeros(1, bool)
    if not known.any():
        return {}
    return {which: _from_starts(found, known, run.segments) for which, found in poses.items()}


def _from_starts(poses: Float, known: NDArray[np.bool_], segments: NDArray[np.int64]) -> Float:
    """(N, 6) poses of (N, 7) ones in the frame of their segment's first known pose; NaN without a known pose."""
    found = np.full((len(poses), 6), np.nan)
    own = known_poses(poses)
    for segment in np.unique(segments[known]):
        these = (segments == segment) & own
        start = poses[np.flatnonzero((segments == segment) & known)[0]]
        rotation = Rotation.from_quat(start[3:])
        found[these, :3] = (poses[these, :3] - start[:3]) @ rotation.as_matrix()
        angles = (rotation.inv() * Rotation.from_quat(poses[these, 3:])).as_euler("ZYX", degrees=True)
        found[these, 3:] = angles[:, ::-1]
    return found


def _traces(run: Series, found: Paths, place: int, several: bool) -> list[Trace]:
    names = {"odom": run.name, "true": f"{run.name}: truth"} if several else {"odom": "odometry", "true": "truth"}
    looks = {
        "odom": (colour_of(place), {"width": 2.2, "dash": "solid"}),
        "true": (colour_of(place) if several else TRUTH_COLOUR, {"width": 1.6, "dash": "dash"}),
    }
    traces = []
    for which, poses in found.items():
        kept = _evenly(run)
        colour, look = looks[which]
        keyed = which == "odom" or not several
        traces.append(line(names[which], poses[kept, 1], poses[kept, 0], colour, showlegend=keyed, **look))
    return traces
