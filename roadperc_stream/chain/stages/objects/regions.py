"""Regions: the pixels in and around a detection's box that may be its object, and their distance.

In a segmentation, a car and a nearer car in front of it form one area of the same class. The depth separates them:
neighbouring pixels belong to one region if their depths differ by less than a share of the depth. One share does not
fit all cases: the depth changes fast along a car's side, and a car parked behind another is close. So regions are found
for several shares, and the region that fits the detection's box is its object. A larger share only joins regions of the
smallest share, so the pixels are divided once. If the frame has instance masks, the instances are the regions.

The depth is smoothed first (bilateral filter: C. Tomasi and R. Manduchi, Bilateral filtering for gray and color
images, ICCV 1998).

The distance is a low quantile of the distances of the region's pixels; the minimum would jump with every stray pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, inf, isfinite
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects.mosaic import Indices, Mosaic, areas, boxes_of, corners
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera, Float, Float32
from roadperc_stream.kernels import divided
from roadperc_stream.kernels.objects_plain import Divided, numbered
from roadperc_stream.model import Box, Ids, Image, Mask

JUMPS = np.array((0.02, 0.04, 0.08), np.float32)
"""Differences of depth between neighbours, as a share of the depth, from which they belong to different regions."""
Labels = NDArray[np.int32]
LEAST_FIT = 0.2
"""Minimum fit of a region to the detection's box."""
MISSING_WEIGHT = 0.1
"""Weight of the part of the box that a region does not fill."""
EDGE_PX = 0.4
"""A region that extends beyond its box by this much still fits: boxes of far objects are few pixels wide."""
MOST_REGIONS = 4
"""Largest number of regions for one box."""
LEAST_PIXELS = 12
"""Minimum number of pixels of a region; a few pixels fit any small box."""
NOISE_LEFT = 1 / 3
"""Standard deviation of a distance, as a share of its pixels' noise: a mean of 3x3 independent pixels."""
SMOOTHING_STD = 0.002
"""Standard deviation without noise, as a share of the distance: smoothing moves edges."""
MOST_STD_SHARE = 0.3
"""Largest standard deviation, as a share, of a distance by ground contact, and due to other regions of a box."""
_JOINED_M = 1.5
"""A region whose middle pixel is farther behind its distance may join two cars of a row."""
_ROWS_FROM_M = 40.0
"""Distance from which the smallest jump is nearly as large as the gap between cars of a row."""
_SURE_FIT = 0.85
_NEXT_CAR_M = 3.0
"""Standard deviation of a far region with a lower fit: about half the distance to the next car."""
_FAR_QUANTILE = 0.75
_WRONG = 0.5
_DEPTH_M = 1.5
"""Standard deviation for wrong matches of stereo: this share of how far that quantile is behind an object's depth."""
GAP = 0.08
"""Gap between the distances of two points, as a share of the distance, beyond which they are different objects."""
LEAST_POINTS = 3


@dataclass(frozen=True, eq=False)
class Division:
    """K regions of an (H, W) mosaic that is divided in n ways; regions are sorted by way.

    ``labels`` (H, W) are the labels of the first way: 0 outside regions, k + 1 in region k. ``names`` (n, labels) maps
    each label to the label of its region in each way. ``ways`` (K,) is the way of each region, ``bounds`` (4, K) its
    half-open box in the mosaic (first column, first row, end column, end row), ``pixels`` (K,) its number of pixels.
    """

    mosaic: Mosaic
    labels: Labels
    names: Indices
    ways: Indices
    bounds: Indices
    pixels: Indices

    def of_region(self, k: int) -> tuple[Mask, tuple[slice, slice]]:
        """(h, w) mask of a region, and its rows and columns in the mosaic."""
        x0, y0, x1, y1 = self.bounds[:, k].tolist()
        part, way = (slice(y0, y1), slice(x0, x1)), self.ways[k]
        labels = self.labels[part]
        mask: Mask = labels == k + 1 if way == 0 else (self.names[way] == k + 1)[labels]
        return mask, part


@dataclass(frozen=True, eq=False)
class Region:
    """Pixels that may be the object of detection ``owner``: region ``number`` of a division.

    Regions are compared by identity. ``box_px`` is the bounding box of the pixels in the image, limited to the
    surroundings of the detection's box. ``fit``, 0 to 1, is how well it fits the detection's box.
    """

    owner: int
    box_px: Box
    fit: float
    division: Division
    number: int


def divide(mosaic: Mosaic) -> Division:
    """The regions of a mosaic; empty without pixels, or with neither instance masks nor depth."""
    if mosaic.ids is not None:
        return Division(mosaic, *_by_instance(mosaic.ids, mosaic.of_class, mosaic.tops))
    if mosaic.log_depth is not None:
        return Division(mosaic, *divided(mosaic.log_depth, mosaic.of_class, JUMPS))
    return Division(mosaic, *numbered(np.zeros(mosaic.of_class.shape, np.int32), 0))


def _by_instance(ids: Ids, of_class: Image, tops: Indices) -> Divided:
    """The instances of the class in each cutout."""
    cutout = np.repeat(np.arange(len(tops) - 1), np.diff(tops))[:, None]
    owned = np.where((of_class > 0) & (ids > 0), cutout * 2**16 + ids, 0)
    numbers = np.unique(owned[owned > 0])
    labels = np.where(owned > 0, np.searchsorted(numbers, owned) + 1, 0).astype(np.int32)
    return numbered(labels, len(numbers))


def find_regions(camera: Camera, mosaic: Mosaic, boxes: Sequence[Box]) -> list[tuple[Region, ...]]:
    """The regions that fit each box best, best first; with equal fits, the smaller jump first.

    Args:
        camera: the camera of the boxes; parts of boxes outside its image are ignored.
        mosaic: the surroundings of the boxes.
        boxes: the boxes of the detections.
    """
    found: list[list[Region]] = [[] for _ in boxes]
    if mosaic.of_class.size:
        division = divide(mosaic)
        inside = corners(boxes).clip(0.0, np.array((camera.width, camera.height) * 2)[:, None])
        owners = np.searchsorted(mosaic.tops, division.bounds[1], side="right") - 1
        around = boxes_of(mosaic, owners, division.bounds)
        fits = np.where(division.pixels >= LEAST_PIXELS, fits_of_bounds(inside[:, owners], around), 0.0)
        best_first = np.argsort(-fits, kind="stable")[: np.count_nonzero(fits >= LEAST_FIT)]
        columns = (best_first, owners[best_first], fits[best_first], around[:, best_first].T)
        for k, owner, fit, box in zip(*(column.tolist() for column in columns), strict=True):
            if len(found[owner]) < MOST_REGIONS:
                found[owner].append(Region(owner, Box(*box), fit, division, k))
    return [tuple(regions) for regions in found]


def fits_of_bounds(boxes: Float, around: Float) -> Float:
    """(K,) Tversky index, 0 to 1, of the bounds of regions (4, K) and their boxes (4, K).

    Source: A. Tversky, Features of similarity, Psychological Review 84 (1977): the shared area over the sum of the
    shared area and both weighted differences. The part of the box without the region may be hidden, so it weighs less
    than the part of the region outside the box.
    """
    shared = areas(_common(boxes, around))
    grown = boxes + np.array((-EDGE_PX, -EDGE_PX, EDGE_PX, EDGE_PX))[:, None]
    alone = MISSING_WEIGHT * (areas(boxes) - shared) + areas(around) - areas(_common(grown, around))
    fits: Float = shared / np.maximum(shared + alone, 1e-9)
    return fits


def _common(ours: Float, theirs: Float) -> Float:
    """(4, K) corners of what (4, K) and (4, K) corners have in common."""
    return np.concatenate((np.maximum(ours[:2], theirs[:2]), np.minimum(ours[2:], theirs[2:])))


@dataclass(frozen=True)
class Measured:
    """A distance and its standard deviation in metres, None if unknown, and whether it is beyond the range."""

    distance_m: float | None = None
    std_m: float | None = None
    beyond_range: bool = False


UNKNOWN = Measured()
"""The result without a measurement."""


def of_region(cfg: ObjectsConfig, region: Region, inverse_std: float = 0.0) -> Measured:
    """The distance of a region, from the means of its pixels over 3x3 neighbours of the region.

    ``inverse_std`` as in ``nearest``.
    """
    mosaic = region.division.mosaic
    if mosaic.distances_m is None or mosaic.noise is None:
        return UNKNOWN
    mask, part = region.division.of_region(region.number)
    near_m, known = _smoothed(mask, mosaic.distances_m[part])
    if mosaic.beyond is not None and len(near_m) < region.division.pixels[region.number]:
        beyond = np.count_nonzero(mask & mosaic.beyond[part])
        near_m = np.append(near_m, np.full(beyond, np.inf, np.float32))
    measured = _nearest(cfg, near_m, inverse_std)
    if measured.distance_m is None or measured.std_m is None:
        return measured
    noise = mosaic.noise[part][known]
    # Four times as fast as np.mean.
    share = NOISE_LEFT * float(np.add.reduce(noise) / len(noise)) + SMOOTHING_STD
    doubt_m = _doubt_m(region.fit, measured.distance_m, near_m)
    return Measured(measured.distance_m, hypot(measured.std_m, share * measured.distance_m, doubt_m))


def _smoothed(of_region: Mask, distances_m: Float32) -> tuple[Float32, Mask]:
    """The distances above 0 of a region, each the mean of those in the 3x3 square, and the (h, w) mask of them."""
    known_m = distances_m * of_region
    known = known_m > 0
    sums, counts = _sums_around(known_m, cv2.CV_32F), _sums_around(known.view(np.uint8), cv2.CV_8U)
    return sums[known] / counts[known], known


def _sums_around(values: NDArray[Any], depth: int) -> NDArray[Any]:
    """(h, w) sums over the 3x3 square around each value, as numbers of an OpenCV depth."""
    return cv2.boxFilter(values, depth, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)


def _doubt_m(fit: float, distance_m: float, near_m: Float32) -> float:
    """Standard deviation, because far regions may join two cars of a row or be the next car, metres.

    ``near_m`` are the distances of the pixels; the middle one of a joined region is far behind its distance.
    """
    next_m = _NEXT_CAR_M if distance_m > _ROWS_FROM_M else 0.0
    behind = np.count_nonzero(near_m > distance_m + _JOINED_M)
    spread_m = ranked(near_m, 0.5)[0] - distance_m if 2 * behind >= len(near_m) else 0.0
    if _JOINED_M < spread_m < np.inf:
        return max(spread_m, next_m)
    return next_m if fit < _SURE_FIT else 0.0


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


def nearest(cfg: ObjectsConfig, distances_m: NDArray[np.floating[Any]], inverse_std: float = 0.0) -> Measured:
    """The quantile of distances, NaN unknown and infinite beyond the depth's range.

    The standard deviation is the spread of the pixels around the quantile, at least ``objects.min_distance_std_m``.
    Depth of stereo has ``inverse_std``, the standard deviation of 1 / depth that the pixels share, and wrong matches.
    """
    return _nearest(cfg, distances_m[~np.isnan(distances_m)], inverse_std)


def _nearest(cfg: ObjectsConfig, known: NDArray[np.floating[Any]], inverse_std: float) -> Measured:
    if not len(known):
        return UNKNOWN
    quantile = cfg.distance_quantile
    least, chosen, beside = ranked(known, 0.0, quantile, 2 * quantile)
    if not isfinite(chosen):
        return Measured(beyond_range=True)
    spread = beside - least
    std_m = max(spread / 2, cfg.min_distance_std_m) if isfinite(spread) else None
    if not inverse_std:
        return Measured(chosen, std_m)
    (far,) = ranked(known, _FAR_QUANTILE)
    wrong_m = _WRONG * max(far - chosen - _DEPTH_M, 0.0)
    return Measured(chosen, hypot(std_m, inverse_std * chosen**2, wrong_m) if std_m else None)


def ranked(values: NDArray[np.floating[Any]], *quantiles: float) -> list[float]:
    """Quantiles of values, each the nearest value below; NumPy sorts faster than it partitions at several ranks."""
    last, ordered = len(values) - 1, np.sort(values)
    return [ordered.item(min(int(quantile * last), last)) for quantile in quantiles]


def bounds_of_groups(
    sorted_m: NDArray[np.floating[Any]], columns: NDArray[Any], rows: NDArray[Any], gap: float, most_gap_m: float = inf
) -> tuple[Indices, Indices, Float]:
    """The groups of points between gaps in distance: first and end positions (K,), and bounds (4, K) in the image.

    Args:
        sorted_m: (N,) increasing distances, at least one.
        columns: (N,) their columns.
        rows: (N,) their rows.
        gap: smallest gap, as a share of the distance.
        most_gap_m: the smallest gap is at most this one, metres.
    """
    first = np.flatnonzero(np.append(True, np.diff(sorted_m) > np.minimum(gap * sorted_m[:-1], most_gap_m)))
    last = np.append(first[1:], len(sorted_m))
    low = [np.minimum.reduceat(places, first) for places in (columns, rows)]
    high = [np.maximum.reduceat(places, first) + 1 for places in (columns, rows)]
    return first, last, np.array((*low, *high), np.float64)
