"""Which pixels in and around a detection's box may be its object: pixels of its class that are connected in depth.

A segmentation gives all cars one class, so that a car and a nearer one before it are one area of it. Where the depth
jumps they are two: neighbours are of one region where their depths differ by less than a share of them. No single share
is right (the side of a car is steep, a car parked behind another is close), so regions of several shares are found, and
the detection's box decides which of them is its object. Where instance masks say which pixels are one object, those are
the regions.

The depth is smoothed before (bilateral filter: C. Tomasi and R. Manduchi, Bilateral filtering for gray and color
images, ICCV 1998).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects.boxes import areas, corners
from roadperc_stream.chain.stages.objects.mosaic import Indices, Mosaic, boxes_of
from roadperc_stream.core.datatypes import Box, Ids, Image
from roadperc_stream.core.geometry import Camera, Float, Float32

JUMPS = (0.02, 0.04, 0.08)
"""Differences of depth between neighbours, as a share of it, from which they are of different regions."""
LEAST_FIT = 0.2
"""Fit to the detection's box below which a region is not its object."""
MISSING_WEIGHT = 0.1
"""Of the part of the box that a region does not fill."""
MOST_REGIONS = 4
"""That are looked at for one box."""
LEAST_PIXELS = 4

Labels = NDArray[np.int32]


@dataclass(frozen=True)
class Region:
    """Pixels that may be the object of detection ``owner``: those of the (h, w) ``mask``.

    ``distances_m`` and their ``noise``, as a share of them, are None without depth. ``box_px`` bounds the pixels in the
    image, as far as they are around the detection's box; ``fit``, 0 to 1, says how well it fits that.
    """

    owner: int
    box_px: Box
    fit: float
    mask: NDArray[np.bool_]
    distances_m: Float32 | None
    noise: Float32 | None


def find_regions(camera: Camera, mosaic: Mosaic, boxes: Sequence[Box]) -> list[tuple[Region, ...]]:
    """The regions that fit each box best, the best first; of equal ones that of the smaller jump.

    Args:
        camera: whose image the boxes are in; the part of a box outside it counts for nothing.
        mosaic: what is around the boxes.
        boxes: of the detections.
    """
    found: list[list[Region]] = [[] for _ in boxes]
    if mosaic.of_class.size:
        labels, bounds = _labelled(mosaic)
        for region in _best(camera, mosaic, boxes, labels, bounds):
            if len(found[region.owner]) < MOST_REGIONS:
                found[region.owner].append(region)
    return [tuple(regions) for regions in found]


def _best(camera: Camera, mosaic: Mosaic, boxes: Sequence[Box], labels: Labels, bounds: Labels) -> Sequence[Region]:
    """All regions that are large enough and fit, the best first."""
    inside = corners(boxes).clip(0.0, np.array((camera.width, camera.height) * 2)[:, None])
    height = mosaic.of_class.shape[0]
    placed = bounds - np.array((0, 1, 0, 0, 0)) * (bounds[:, 1:2] // height * height)
    owners = np.searchsorted(mosaic.tops, placed[:, 1], side="right") - 1
    around = boxes_of(mosaic, owners, placed[:, :4])
    fits = np.where(bounds[:, 4] >= LEAST_PIXELS, _fits(inside[:, owners], around), 0.0)
    fitting = np.flatnonzero(fits >= LEAST_FIT)
    _, distinct = np.unique(placed[fitting], axis=0, return_index=True)
    order = sorted(fitting[distinct].tolist(), key=lambda k: (-fits[k], k))
    return [_region(mosaic, labels, k, bounds[k], placed[k], int(owners[k]), around[:, k], fits[k]) for k in order]


def _fits(boxes: Float, around: Float) -> Float:
    """(K,) how well the bounds of regions (4, K) fit as many boxes: Tversky's index.

    Source: A. Tversky, Features of similarity, Psychological Review 84 (1977): what they share, of that and what each
    has alone. What of the box has no region may be hidden, and counts less than what the region has outside the box.
    """
    shared = areas(np.concatenate((np.maximum(boxes[:2], around[:2]), np.minimum(boxes[2:], around[2:]))))
    alone = MISSING_WEIGHT * (areas(boxes) - shared) + areas(around) - shared
    fits: Float = shared / np.maximum(shared + alone, 1e-9)
    return fits


def _region(
    mosaic: Mosaic, labels: Labels, k: int, bounds: Labels, placed: Labels, owner: int, box: Float, fit: float
) -> Region:
    x, y, width, height, _ = bounds.tolist()
    mask = labels[y : y + height, x : x + width] == k + 1
    y = int(placed[1])
    part = slice(y, y + height), slice(x, x + width)
    distances = None if mosaic.distances_m is None else mosaic.distances_m[part]
    noise = None if mosaic.noise is None else mosaic.noise[part]
    return Region(owner, Box(*box.tolist()), float(fit), mask, distances, noise)


def _labelled(mosaic: Mosaic) -> tuple[Labels, Labels]:
    """Labels from 1 on, (n H, W) of n ways to divide the pixels, and of each x, y, width, height and count."""
    if mosaic.ids is not None:
        return _by_instance(mosaic.ids, mosaic.of_class, mosaic.tops)
    if mosaic.log_depth is not None:
        return _by_depth(mosaic.log_depth, mosaic.of_class)
    return np.zeros((0, 0), np.int32), np.zeros((0, 5), np.int32)


def _by_instance(ids: Ids, of_class: Image, tops: Indices) -> tuple[Labels, Labels]:
    """The instances of the class in each cutout."""
    cutout = np.repeat(np.arange(len(tops) - 1), np.diff(tops))[:, None]
    owned = np.where((of_class > 0) & (ids > 0), cutout * 2**16 + ids, 0)
    numbers = np.unique(owned[owned > 0])
    labels = np.where(owned > 0, np.searchsorted(numbers, owned) + 1, 0).astype(np.int32)
    masks = ((labels == k + 1).view(np.uint8) for k in range(len(numbers)))
    bounds = [(*cv2.boundingRect(mask), cv2.countNonZero(mask)) for mask in masks]
    return labels, np.array(bounds, np.int32).reshape(-1, 5)


def _by_depth(log_depth: Float32, of_class: Image) -> tuple[Labels, Labels]:
    """The regions of every jump, on a grid that has a cell for each pair of neighbours too."""
    height, width = of_class.shape
    across, down = np.abs(log_depth[:, 1:] - log_depth[:, :-1]), np.abs(log_depth[1:] - log_depth[:-1])
    beside, below = of_class[:, 1:] & of_class[:, :-1], of_class[1:] & of_class[:-1]
    grid = np.zeros((len(JUMPS), 2 * height, 2 * width - 1), np.uint8)
    grid[:, ::2, ::2] = of_class
    for of_jump, jump in zip(grid, JUMPS, strict=True):
        of_jump[::2, 1::2] = beside & (across < jump)
        of_jump[1:-1:2, ::2] = below & (down < jump)
    stacked = grid.reshape(-1, 2 * width - 1)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(stacked, connectivity=4, ltype=cv2.CV_32S)
    bounds = np.array(stats[1:], np.int32)
    bounds[:, :4] = (bounds[:, :4] + (0, 0, 1, 1)) // 2
    return np.asarray(labels[::2, ::2], np.int32), bounds
