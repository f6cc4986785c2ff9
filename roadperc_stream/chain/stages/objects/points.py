"""The points of an object in its box, by depth alone: without tags and without instance masks.

Points on the ground are left out. A surface is upright if there is a point above or below at nearly the same distance;
along the ground, the distance changes many times faster than the height. The others form clusters: gaps in distance
separate them. The object is the cluster whose bounds fit the box best. A background continues beside the box, and
something in front covers a part of it. Clusters that fit nearly as well make the distance less certain.
"""

from math import hypot, inf, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects.contact import edge_std_px
from roadperc_stream.chain.stages.objects.mosaic import MARGIN, areas, corners
from roadperc_stream.chain.stages.objects.regions import (
    GAP,
    LEAST_POINTS,
    UNKNOWN,
    Measured,
    bounds_of_groups,
    fits_of_bounds,
    nearest,
    of_box,
)
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.model import Box, Detection, Image
from roadperc_stream.model.frame import Frame
from roadperc_stream.model.tag_tables import classes_of_label

_MOST_POINTS: Final = 300
"""Larger boxes are sampled with about this number of points."""
_HEIGHT_M: Final = (0.2, 1.5)
_ASIDE_M: Final = 0.5
_STEEPEST: Final = 0.7
"""Two points are on an upright surface if their heights differ by these metres, their places across by at most
``_ASIDE_M``, and their distances by at most this share of the height."""
_GAP: Final = 0.02
"""Gap between the distances of two clusters, as a share of the distance."""
_ALIKE: Final = 5
"""Power of the relative fit that is the weight of another cluster."""
_USUAL_M: Final[dict[tuple[str, ...], tuple[float, float]]] = {("pedestrian",): (1.7, 0.15), ("vehicle",): (1.6, 0.4)}
"""Usual height of a class, and the standard deviation of its logarithm for larger ones."""
_HIDDEN_STD: Final = 0.6
"""Standard deviation of the logarithm of the height for smaller ones, which may be partly hidden."""
_LEAST_STD: Final = 0.02
"""Least standard deviation, as a share of the distance: nothing but the depth separates the object."""
_FIRST_PART: Final = 0.15
"""Share of a cluster's points that may be ground before the object."""
_OTHER: Final = 0.005
"""Weight of the case that none of the clusters is the object."""
_UNSURE: Final = 0.5
"""Standard deviation, as a share of the distance, in that case and if no cluster is upright."""
_MOST_GAP_M: Final = 2.0
"""Largest gap between the distances of two points of an object, metres."""
_COVERED: Final = 0.2
"""Share of the points in the box of a nearer object of the class that belong to the object behind."""
_BESIDE: Final = 0.5
"""The same if the boxes end at the same height, so that either object may be the nearer one."""
_ALIKE_POINTS: Final = 3
"""Largest number of points of a group that count as independent."""
_ALIKE_FILLED: Final = 2
"""Power of the relative number of points, times the area, that is the weight of another group."""
_EMPTY: Final = 0.02
"""Weight of the case that no point is on the object."""
RARE: Final = 0.03
"""Probability of hypotheses that a deviation need not cover."""
_PART_M: Final[dict[tuple[str, ...], float]] = {("pedestrian",): 0.3, ("vehicle",): 1.5}
"""Depth of the visible side of an object: one point is anywhere on it, metres."""


def measured_by_points(
    cfg: ObjectsConfig, camera: Camera, depth_m: Float32, limit_m: float, detection: Detection
) -> Measured:
    """The distance of the cluster that fits a box, with its standard deviation.

    Args:
        cfg: the quantile of the distances.
        camera: camera of box and depth.
        depth_m: (H, W) metres along z, NaN unknown; few pixels of a lidar have one.
        limit_m: depth at which the encoding saturates.
        detection: its box may be cut by the image's border.
    """
    x0, y0, x1, y1 = box = detection.box_px.rounded(camera.width, camera.height)
    aside, above = (MARGIN * (last - first) for first, last in ((x0, x1), (y0, y1)))
    around = Box(x0 - aside, y0 - above, x1 + aside, y1 + above).rounded(camera.width, camera.height)
    columns, rows, distances = _sampled(of_box(camera, depth_m, around, limit_m), around[:2])
    upright = _upright(camera, columns, rows, distances)
    if np.count_nonzero(upright) >= LEAST_POINTS:
        order = np.flatnonzero(upright)[np.argsort(distances[upright], kind="stable")]
        sorted_m = distances[order]
        first, last, bounds = bounds_of_groups(sorted_m, columns[order], rows[order], _GAP)
        fits = fits_of_bounds(corners([Box(x0, y0, x1, y1)]), bounds) * (last - first >= LEAST_POINTS)
        heights_m = (y1 - y0) / camera.fy * sorted_m[first]
        weights = fits**_ALIKE * usual_heights(detection.label, heights_m)
        best = int(np.argmax(weights))
        if weights[best] > 0:
            return _of_cluster(cfg, sorted_m[first[best] : last[best]], weights, sorted_m[first])
    measured = nearest(cfg, of_box(camera, depth_m, box, limit_m).ravel())
    if measured.distance_m is None:
        return measured
    return Measured(measured.distance_m, max(measured.std_m or 0.0, _UNSURE * measured.distance_m))


def measured_of_class(cfg: ObjectsConfig, frame: Frame, detection: Detection, lookup: Image, others: Float) -> Measured:
    """The distance of the object's group of a lidar's points, with a deviation for the other groups.

    Gaps in distance separate the groups. A group in the box of a nearer object mostly belongs to that object.

    Args:
        cfg: the quantile of the distances.
        frame: with tags and a lidar's depth.
        detection: its box may be outside the image.
        lookup: (256,) above 0 at the tags of the class.
        others: (4, K) corners of the other detections of the class.
    """
    box, camera = detection.box_px, frame.camera
    x0, y0, x1, y1 = rounded = box.rounded(camera.width, camera.height)
    if frame.depth_m is None or frame.tags is None or x0 >= x1 or y0 >= y1:
        return UNKNOWN
    distances_m = of_box(camera, frame.depth_m, rounded, frame.depth_limit_m)
    rows, columns = np.nonzero(~np.isnan(distances_m) & (lookup[frame.tags[y0:y1, x0:x1]] > 0))
    if not len(rows):
        return UNKNOWN
    order = np.argsort(distances_m[rows, columns], kind="stable")
    rows, columns = rows[order], columns[order]
    sorted_m = distances_m[rows, columns].astype(np.float64)
    first, last, bounds = bounds_of_groups(sorted_m, columns, rows, GAP, _MOST_GAP_M)
    counts = last - first
    shares = _own_shares(box, others, columns + x0, rows + y0)
    own: Float = np.add.reduceat(shares, first) / counts
    filled = own * counts * areas(bounds)
    height_per_m = (box.y_max - box.y_min) / camera.fy
    usual = usual_heights(detection.label, height_per_m * sorted_m[first], hidden=bool((shares < 1).any()))
    weights = own ** np.minimum(counts, _ALIKE_POINTS) * (filled / filled.max()) ** _ALIKE_FILLED * usual
    best = int(np.argmax(weights))
    measured = nearest(cfg, sorted_m[first[best] : last[best]])
    if measured.distance_m is None or measured.std_m is None or weights[best] <= _EMPTY:
        return UNKNOWN
    kind = classes_of_label(detection.label) or ()
    usual_m = _USUAL_M[kind][0] / height_per_m if kind in _USUAL_M else (1 + _UNSURE) * measured.distance_m
    apart_m = np.append(sorted_m[first], usual_m) - measured.distance_m
    others_m = std_by_others_m(np.append(weights, _EMPTY / counts[best]), apart_m)
    part_m = _PART_M.get(kind, max(_PART_M.values())) / sqrt(counts[best])
    return Measured(measured.distance_m, hypot(measured.std_m, others_m, part_m))


def std_by_others_m(weights: Float, apart_m: Float) -> float:
    """Standard deviation of a distance due to (K,) hypotheses that are ``apart_m`` from it, by their weights, metres.

    The least probable ones, ``RARE`` together, do not count.
    """
    shares: Float = weights / weights.sum()
    order = np.argsort(shares, kind="stable")
    shares[order[np.cumsum(shares[order]) < RARE]] = 0.0
    return sqrt(float(shares @ apart_m**2))


def _own_shares(box: Box, others: Float, columns: NDArray[np.int64], rows: NDArray[np.int64]) -> Float:
    """(N,) probability that the points at columns and rows of a box are not on one of (4, K) other boxes' objects."""
    x0, y0, x1, y1 = others[:, :, None]
    inside = (columns >= x0) & (columns < x1) & (rows >= y0) & (rows < y1)
    edge_px = edge_std_px(box.y_max - box.y_min)
    share = np.where(y1 > box.y_max + edge_px, _COVERED, np.where(y1 < box.y_max - edge_px, 1.0, _BESIDE))
    shares: Float = np.where(inside, share, 1.0).prod(axis=0)
    return shares


def _sampled(distances_m: Float32, first_px: tuple[int, int]) -> tuple[Float, Float, Float]:
    """Columns, rows and distances of pixels with a finite distance, evenly spaced if they are too many."""
    step = max(round(sqrt(np.count_nonzero(np.isfinite(distances_m)) / _MOST_POINTS)), 1)
    few = distances_m[::step, ::step]
    rows, columns = np.nonzero(np.isfinite(few))
    left, top = first_px
    return (
        left + step * columns.astype(np.float64),
        top + step * rows.astype(np.float64),
        few[rows, columns].astype(np.float64),
    )


def _upright(camera: Camera, columns: Float, rows: Float, distances_m: Float) -> NDArray[np.bool_]:
    """(N,) whether a point above or below is at nearly the same distance."""
    x, y = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
    depths_m = distances_m / np.sqrt(x**2 + y**2 + 1.0)
    across, height, along = (np.abs(m[:, None] - m) for m in (x * depths_m, y * depths_m, distances_m))
    least_m, most_m = _HEIGHT_M
    pairs = (height > least_m) & (height < most_m) & (across < _ASIDE_M) & (along < _STEEPEST * height)
    return np.asarray(pairs.any(axis=1), np.bool_)


def usual_heights(label: str, heights_m: Float, *, hidden: bool = False) -> Float:
    """(K,) 0 to 1: how usual heights of a box in metres are for a label; a part of an object may be visible.

    With ``hidden``, something covers a part of the object, and any smaller height is usual.
    """
    usual_m = _USUAL_M.get(classes_of_label(label) or ())
    if usual_m is None:
        return np.ones_like(heights_m)
    off = np.log(heights_m / usual_m[0])
    usual: Float = np.exp(-0.5 * (off / np.where(off > 0, usual_m[1], inf if hidden else _HIDDEN_STD)) ** 2)
    return usual


def _of_cluster(cfg: ObjectsConfig, own_m: Float, weights: Float, first_m: Float) -> Measured:
    """The distance of a cluster's sorted distances, with a deviation for the other clusters and its first points.

    Its first points may be ground before the object. ``weights`` are those of all clusters, ``first_m`` their first
    distances.
    """
    measured = nearest(cfg, own_m)
    if measured.distance_m is None or measured.std_m is None:
        return measured
    squares = (
        float((weights * (first_m - measured.distance_m) ** 2).sum()) + _OTHER * (_UNSURE * measured.distance_m) ** 2
    )
    others_m = sqrt(squares / (float(weights.sum()) + _OTHER))
    first_part_m = float(own_m[round(_FIRST_PART * (len(own_m) - 1))]) - measured.distance_m
    std_m = hypot(measured.std_m, others_m, first_part_m, _LEAST_STD * measured.distance_m)
    return Measured(measured.distance_m, std_m)
