"""Charts without a time axis: histograms of the errors, and the trajectories from above."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from roadperc_stream.geometry import Float

from ..quantities import TRUTH, Quantity
from ..sections import better
from ..trajectories.poses import ESTIMATED_COLUMNS, TRUE_COLUMNS, known_poses
from .figures import BUCKETS, TRUTH_COLOUR, Figure, Series, Trace, axis, colour_of, layout, line, numbers

MOST_BINS, LEAST_BINS = 40, 8
ERROR_COLUMNS: Final = tuple(quantity.column for quantity in TRUTH)
"""Columns of the histograms."""
POSE_COLUMNS: Final = (*ESTIMATED_COLUMNS, *TRUE_COLUMNS)
"""Columns of the trajectory."""
Paths = dict[str, Float]
"""(N, 6) poses by path, from ``paths``."""


def histograms(runs: Sequence[Series]) -> Iterator[Figure]:
    """A histogram of each truth metric that has values, the runs over each other on the same bins."""
    for quantity in TRUTH:
        having = [(place, run) for place, run in enumerate(runs) if quantity.column in run.values]
        if having:
            edges = bin_edges([run.values[quantity.column] for _, run in having])
            traces = [_histogram(run, quantity, edges, place) for place, run in having]
            look = layout(quantity.label, "% of values", height=230, showlegend=len(runs) > 1)
            yield Figure(quantity.label, better(quantity), traces, look)


def bin_edges(values: Sequence[Float]) -> Float:
    """Edges of 2 sqrt(N) bins over N finite values, within limits; more bins would only show single values.

    Bins have a width even if all values are equal.
    """
    joined = np.concatenate(values)
    known = joined[np.isfinite(joined)]
    bins = int(np.clip(2 * np.sqrt(len(known)), LEAST_BINS, MOST_BINS))
    span = float(known.max() - known.min()) if known.size else 0.0
    if known.size and 0 <= span < bins * np.spacing(np.abs(known).max()):  # too few floats between the ends
        return np.linspace(known.min() - abs(known.min()) / 2, known.max() + abs(known.max()) / 2, bins + 1)
    edges: Float = np.histogram_bin_edges(known, bins)
    return edges


def _histogram(run: Series, quantity: Quantity, edges: Float, place: int) -> Trace:
    values = run.values[quantity.column]
    counts, _ = np.histogram(values[np.isfinite(values)], edges)
    percent = 100 * counts / max(counts.sum(), 1)
    # A step line, because the outlines of several runs stay visible over each other, unlike bars.
    outline = np.concatenate([[0.0], np.repeat(percent, 2), [0.0]])
    return line(run.name, np.repeat(edges, 2), outline, colour_of(place), fill="tozeroy", width=1.2)


def trajectory(runs: Sequence[Series], found: Sequence[Paths]) -> Figure | None:
    """Odometry's path and the true path in the ego frame of each run's first pose; None if no run has a pose.

    The path of a single run has the colours of its position error.
    """
    pairs = zip(runs, found, strict=True)
    traces = [trace for at, (run, path) in enumerate(pairs) for trace in _traces(run, path, at, len(runs) > 1)]
    if not traces:
        return None
    note = "From above: ahead of the first frame is up, left is left; both axes to one scale, in metres."
    if any(np.ptp(run.segments) for run in runs):
        note += " Each segment of a log begins at the origin."
    if any(trace["line"]["dash"] != "solid" for trace in traces):
        note += " The true path is dashed."
    if len(runs) == 1 and len(traces) > 1:
        note += " Points: the position error."
        traces.append(_coloured_by_error(runs[0], found[0]))
    left = axis("y to the left, m", autorange="reversed")
    ahead = axis("x ahead, m", scaleanchor="x", scaleratio=1)
    return Figure("Trajectory", note, traces, layout("", "", hovermode="closest", height=440, xaxis=left, yaxis=ahead))


def _coloured_by_error(run: Series, found: Paths) -> Trace:
    kept = _evenly(run)
    poses, error_m = found["odom"][kept], np.linalg.norm((found["odom"] - found["true"])[kept, :3], axis=1)
    bar = {"title": {"text": "position error, m"}, "thickness": 12, "exponentformat": "none"}
    marker = {"color": numbers(error_m), "colorscale": "Portland", "size": 5, "colorbar": bar}
    points = {"mode": "markers", "showlegend": False, "hovertemplate": "error %{marker.color} m<extra></extra>"}
    return {**line("error", poses[:, 1], poses[:, 0], TRUTH_COLOUR), **points, "marker": marker}


def _evenly(run: Series) -> NDArray[np.intp]:
    evenly = np.linspace(0, len(run.segments) - 1, 3 * BUCKETS).astype(int)
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
    names = {"odom": run.name if several else "odometry", "true": f"{run.name}: truth" if several else "truth"}
    looks = {
        "odom": (colour_of(place), {"width": 2.2, "dash": "solid"}),
        "true": (colour_of(place) if several else TRUTH_COLOUR, {"width": 1.6, "dash": "dash"}),
    }
    traces = []
    for which, poses in found.items():
        kept = _evenly(run)
        colour, look = looks[which]
        traces.append(line(names[which], poses[kept, 1], poses[kept, 0], colour, **look))
    return traces
