"""Which pixels in and around a detection's box may be its object: pixels of its class that are connected in depth.

Neighbours are of one region where their depths differ by less than a share of them. No single share is right, so there
are regions of several. What a larger one allows joins regions of the smallest one, so that the pixels are divided once.

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

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.kernels import divided
from roadperc_stream.chain.kernels.objects_plain import numbered
from roadperc_stream.chain.stages.objects.mosaic import Indices, Mosaic, areas, boxes_of, corners
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
