"""Which pixels in and around a detection's box may be its object, and how far away that is.

A segmentation gives all cars one class, so that a car and a nearer one before it are one area of it. Where the depth
jumps they are two: neighbours are of one region where their depths differ by less than a share of them. No single share
is right (the side of a car is steep, a car parked behind another is close), so regions of several shares are found, and
the detection's box decides which of them is its object. What a larger share allows joins regions of the smallest one,
so that the pixels are divided once. Where instance masks say which pixels are one object, those are the regions.

The depth is smoothed before (bilateral filter: C. Tomasi and R. Manduchi, Bilateral filtering for gray and color
images, ICCV 1998).

The distance is a low quantile of the distances of the region's pixels, or of a lidar's few points in the box: the bare
minimum jumps with every stray pixel. Of groups of points that a gap in distance parts it is the one whose bounds fill
most of the box.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.kernels import divided, region_distances
from roadperc_stream.chain.kernels.objects_plain import numbered
from roadperc_stream.chain.stages.objects.mosaic import Indices, Mosaic, areas, boxes_of, corners
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.model import Box, Ids, Image

JUMPS = np.array((0.02, 0.04, 0.08), np.float32)
"""Differences of depth between neighbours, as a share of it, from which they are of different regions."""
Labels = NDArray[np.int32]
LEAST_FIT = 0.2
"""Fit to the detection's box below which a region is not its object."""
MISSING_WEIGHT = 0.1
"""Of the part of the box that a region does not fill."""
MOST_REGIONS = 4
"""That are looked at for one box."""
LEAST_PIXELS = 3
NOISE_LEFT = 1 / 3
"""Standard deviation of a distance in noises of its pixels: what the mean of 3x3 independent ones leaves."""
SMOOTHING_STD = 0.002
"""The same without noise, as a share of the distance: smoothing takes edges away."""
GAP = 0.08
"""Share of the distance from one point to the next beyond which they are of different objects."""
LEAST_POINTS = 3


@dataclass(frozen=True)
class Division:
    """K regions of a mosaic of (H, W) pixels, by n ways to divide it, those of an earlier way before the others.

    ``labels`` (H, W) are those of the first way, 0 of no region and k + 1 of region k; ``names`` (n, labels) are what
    each label is called in each way. ``ways`` (K,) are the regions' own, ``bounds`` (4, K) their first column and row
    in the mosaic and those behind their last, ``pixels`` (K,) how many each has.
    """

    labels: Labels
    names: Indices
    ways: Indices
    bounds: Indices
    pixels: Indices

    def of_region(self, k: int) -> tuple[NDArray[np.bool_], tuple[slice, slice]]:
        """(labels,) which labels are a region's, and where its bounds are in the mosaic: no other pixels have them."""
        x0, y0, x1, y1 = self.bounds[:, k].tolist()
        inside: NDArray[np.bool_] = self.names[self.ways[k]] == k + 1
        return inside, (slice(y0, y1), slice(x0, x1))


@dataclass(frozen=True, eq=False)
class Region:
    """Pixels that may be the object of detection ``owner``. No two are equal.

    They are those among the (h, w) ``labels`` whose label is the region's, ``of_region`` (n,) of each label.
    ``distances_m`` and their ``noise``, as a share of them, are None without depth. ``box_px`` bounds the pixels in the
    image, as far as they are around the detection's box; ``fit``, 0 to 1, says how well it fits that.
    """

    owner: int
    box_px: Box
    fit: float
    labels: Labels
    of_region: NDArray[np.bool_]
    distances_m: Float32 | None
    noise: Float32 | None


def divide(mosaic: Mosaic) -> Division:
    """The regions of a mosaic; none where it has neither instance masks nor depth, or no pixels."""
    if mosaic.ids is not None:
        return _by_instance(mosaic.ids, mosaic.of_class, mosaic.tops)
    if mosaic.log_depth is not None:
        return Division(*divided(mosaic.log_depth, mosaic.of_class, JUMPS))
    return Division(*numbered(np.zeros(mosaic.of_class.shape, np.int32), 0))


def _by_instance(ids: Ids, of_class: Image, tops: Indices) -> Division:
    """The instances of the class in each cutout."""
    cutout = np.repeat(np.arange(len(tops) - 1), np.diff(tops))[:, None]
    owned = np.where((of_class > 0) & (ids > 0), cutout * 2**16 + ids, 0)
    numbers = np.unique(owned[owned > 0])
    labels = np.where(owned > 0, np.searchsorted(numbers, owned) + 1, 0).astype(np.int32)
    return Division(*numbered(labels, len(numbers)))


def find_regions(camera: Camera, mosaic: Mosaic, boxes: Sequence[Box]) -> list[tuple[Region, ...]]:
    """The regions that fit each box best, the best first; of equal ones that of the smaller jump.

    Args:
        camera: whose image the boxes are in; the part of a box outside it counts for nothing.
        mosaic: what is around the boxes.
        boxes: of the detections.
    """
    found: list[list[Region]] = [[] for _ in boxes]
    if mosaic.of_class.size:
        division = divide(mosaic)
        inside = corners(boxes).clip(0.0, np.array((camera.width, camera.height) * 2)[:, None])
        owners = np.searchsorted(mosaic.tops, division.bounds[1], side="right") - 1
        around = boxes_of(mosaic, owners, division.bounds)
        fits = np.where(division.pixels >= LEAST_PIXELS, _fits(inside[:, owners], around), 0.0)
        fitting = np.flatnonzero(fits >= LEAST_FIT)
        for k in fitting[np.argsort(-fits[fitting], kind="stable")].tolist():
            of_owner = found[owners[k]]
            if len(of_owner) < MOST_REGIONS:
                of_owner.append(_region(mosaic, division, k, int(owners[k]), around[:, k], fits[k]))
    return [tuple(regions) for regions in found]


def _fits(boxes: Float, around: Float) -> Float:
    """(K,) how well the bounds of regions (4, K) fit as many boxes: Tversky's index.

    Source: A. Tversky, Features of similarity, Psychological Review 84 (1977): what they share, of that and what each
    has alone. What of the box has no region may be hidden, and counts less than what the region has outside the box.
    """
    shared = areas(np.concatenate((np.maximum(boxes[:2], around[:2]), np.minimum(boxes[2:], around[2:]))))
    alone = MISSING_WEIGHT * (areas(boxes) - shared) + areas(around) - shared
    fits: Float = shared / np.maximum(shared + alone, 1e-9)
    return fits


def _region(mosaic: Mosaic, division: Division, k: int, owner: int, box: Float, fit: float) -> Region:
    of_region, part = division.of_region(k)
    distances = None if mosaic.distances_m is None else mosaic.distances_m[part]
    noise = None if mosaic.noise is None else mosaic.noise[part]
    return Region(owner, Box(*box.tolist()), float(fit), division.labels[part], of_region, distances, noise)


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
    measured = nearest(cfg, near)
    if measured.distance_m is None or measured.std_m is None:
        return measured
    # The mean, without what NumPy's own makes of axes and types: that takes four times as long.
    share = NOISE_LEFT * float(np.add.reduce(noise_of_finite) / len(noise_of_finite)) + SMOOTHING_STD
    return Measured(measured.distance_m, hypot(measured.std_m, share * measured.distance_m))


def of_box(camera: Camera, depth_m: Float32, box: tuple[int, int, int, int], limit_m: float) -> Float32:
    """(h, w) distances of a box's pixels: NaN unknown, infinite beyond the depth's range."""
    x0, y0, x1, y1 = box
    depths_m = within_range(depth_m[y0:y1, x0:x1], limit_m)
    x = (np.arange(x0, x1) - camera.cx) / camera.fx
    y = (np.arange(y0, y1) - camera.cy) / camera.fy
    ray_lengths: Float32 = np.sqrt((x**2 + 1.0).astype(np.float32) + (y**2).astype(np.float32)[:, None])
    return depths_m * ray_lengths


def within_range(depths_m: Float32, limit_m: float) -> Float32:
    """(h, w) depths, infinite beyond the depth's range."""
    return np.where(depths_m >= np.float32(limit_m), np.float32(np.inf), depths_m)


def nearest(cfg: ObjectsConfig, distances_m: Float32) -> Measured:
    """The quantile of distances, NaN unknown and infinite beyond the depth's range.

    The deviation is that of the pixels around the quantile: what the choice of the quantile could have been; and no
    less than the quantile moves with the box.
    """
    known = distances_m[~np.isnan(distances_m)]
    if not len(known):
        return UNKNOWN
    quantile = cfg.distance_quantile
    least, chosen, beside = ranked(known, 0.0, quantile, 2 * quantile)
    if not isfinite(chosen):
        return Measured(beyond_range=True)
    spread = beside - least
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
