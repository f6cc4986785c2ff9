"""How far an object is: a low quantile of the distances of its pixels, or of a lidar's few points in its box.

The bare minimum jumps with every stray pixel.

Of groups of points that a gap in distance parts it is the one whose bounds fill most of the box.
"""

from dataclasses import dataclass
from math import hypot, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.kernels import region_distances
from roadperc_stream.chain.stages.objects.mosaic import areas
from roadperc_stream.chain.stages.objects.regions import Region
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera, Float32

NOISE_LEFT = 1 / 3
"""Standard deviation of a distance in noises of its pixels: what the mean of 3x3 independent ones leaves."""
SMOOTHING_STD = 0.002
"""The same without noise, as a share of the distance: smoothing takes edges away."""
Indices = NDArray[np.int64]
GAP = 0.08
"""Share of the distance from one point to the next beyond which they are of different objects."""
LEAST_POINTS = 3


@dataclass(frozen=True)
class Measured:
    """A distance and its standard deviation in metres, None where not known, and whether it is beyond the range."""

    distance_m: float | None = None
    std_m: float | None = None
    beyond_range: bool = False


UNKNOWN = Measured()
"""Nothing could be measured."""


def of_region(cfg: ObjectsConfig, region: Region) -> Measured:
    """The distance of a region's pixels, each the mean of the region's pixels around it."""
    distances, noise = region.distances_m, region.noise
    if distances is None or noise is None:
        return UNKNOWN
    near, noise_of_finite = region_distances(region.labels, region.of_region, distances, noise)
    measured = _of_known(cfg, near)
    if measured.distance_m is None or measured.std_m is None:
        return measured
    # The mean, without what NumPy's own makes of axes and types: that takes four times as long.
    share = NOISE_LEFT * float(np.add.reduce(noise_of_finite) / len(noise_of_finite)) + SMOOTHING_STD
    return Measured(measured.distance_m, hypot(measured.std_m, share * measured.distance_m))


def of_box(camera: Camera, depth_m: Float32, box: tuple[int, int, int, int], limit_m: float) -> Float32:
    """(h, w) distances of a box's pixels: NaN unknown, infinite beyond the depth's range."""
    x0, y0, x1, y1 = box
    depths_m = within_range(depth_m[y0:y1, x0:x1], limit_m)
    return depths_m * ray_lengths(camera, np.arange(x0, x1), np.arange(y0, y1))


def within_range(depths_m: Float32, limit_m: float) -> Float32:
    """(h, w) depths, infinite beyond the depth's range."""
    return np.where(depths_m >= np.float32(limit_m), np.float32(np.inf), depths_m)


def ray_lengths(camera: Camera, columns: Indices, rows: Indices) -> Float32:
    """(h, w) metres along the ray of each pixel for each metre of its depth."""
    x = (columns - camera.cx) / camera.fx
    y = (rows - camera.cy) / camera.fy
    lengths: Float32 = np.sqrt((x**2 + 1.0).astype(np.float32) + (y**2).astype(np.float32)[:, None])
    return lengths


def nearest(cfg: ObjectsConfig, distances_m: Float32) -> Measured:
    """The quantile of distances, NaN unknown and infinite beyond the depth's range.

    The deviation is that of the pixels around the quantile: what the choice of the quantile could have been; and no
    less than the quantile moves with the box.
    """
    return _of_known(cfg, distances_m[~np.isnan(distances_m)])


def _of_known(cfg: ObjectsConfig, known: Float32) -> Measured:
    if not len(known):
        return UNKNOWN
    quantile = cfg.distance_quantile
    nearest, chosen, beside = ranked(known, 0.0, quantile, 2 * quantile)
    if not isfinite(chosen):
        return Measured(beyond_range=True)
    spread = beside - nearest
    return Measured(chosen, max(spread / 2, cfg.min_distance_std_m) if isfinite(spread) else None)


def ranked(values: NDArray[np.floating[Any]], *quantiles: float) -> list[float]:
    """Quantiles of values, each the nearest one below: what NumPy's own costs ten times as much for."""
    last = len(values) - 1
    ranks = [min(int(quantile * last), last) for quantile in quantiles]
    parted = np.partition(values, ranks)
    return [parted.item(rank) for rank in ranks]


def own_distances(distances_m: Float32) -> Float32:
    """(N,) distances of the points that are the object's.

    Args:
        distances_m: (h, w) of the pixels of a box, NaN where there is no point or one of another class.

    Returns:
        All of them where no group has three points.
    """
    rows, columns = np.nonzero(~np.isnan(distances_m))
    order = np.argsort(distances_m[rows, columns], kind="stable")
    rows, columns = rows[order], columns[order]
    sorted_m = distances_m[rows, columns]
    first = np.flatnonzero(np.append(True, sorted_m[1:] > sorted_m[:-1] * (1 + GAP)))[: len(sorted_m)]
    if not len(first):
        return sorted_m
    last = np.append(first[1:], len(sorted_m))
    low = [np.minimum.reduceat(places, first) for places in (columns, rows)]
    high = [np.maximum.reduceat(places, first) + 1 for places in (columns, rows)]
    filled = np.where(last - first >= LEAST_POINTS, areas(np.array((*low, *high), np.float64)), 0.0)
    best = int(np.argmax(filled))
    return sorted_m[first[best] : last[best]] if filled[best] > 0 else sorted_m
