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

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects.boxes import areas, corners
from roadperc_stream.chain.stages.objects.division import Division, Labels, divide
from roadperc_stream.chain.stages.objects.mosaic import Mosaic, boxes_of
from roadperc_stream.core.datatypes import Box
from roadperc_stream.core.geometry import Camera, Float, Float32

LEAST_FIT = 0.2
"""Fit to the detection's box below which a region is not its object."""
MISSING_WEIGHT = 0.1
"""Of the part of the box that a region does not fill."""
MOST_REGIONS = 4
"""That are looked at for one box."""
LEAST_PIXELS = 3


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
