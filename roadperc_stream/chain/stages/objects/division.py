"""The pixels of a class divided into regions: by the instance masks, or where the depth jumps.

Neighbours are of one region where their depths differ by less than a share of them. No single share is right, so there
are regions of several. What a larger one allows joins regions of the smallest one, so that the pixels are divided once.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from roadperc_stream.chain.stages.objects.mosaic import Indices, Mosaic
from roadperc_stream.core.datatypes import Ids, Image
from roadperc_stream.core.geometry import Float32

JUMPS = (0.02, 0.04, 0.08)
"""Differences of depth between neighbours, as a share of it, from which they are of different regions."""

Labels = NDArray[np.int32]


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

    def mask(self, k: int) -> tuple[NDArray[np.bool_], tuple[slice, slice]]:
        """(h, w) the pixels of a region within its bounds, and where those are in the mosaic."""
        x0, y0, x1, y1 = self.bounds[:, k].tolist()
        part = slice(y0, y1), slice(x0, x1)
        inside: NDArray[np.bool_] = self.names[self.ways[k]] == k + 1
        return inside[self.labels[part]], part


def divide(mosaic: Mosaic) -> Division:
    """The regions of a mosaic; none where it has neither instance masks nor depth, or no pixels."""
    if mosaic.ids is not None:
        return _by_instance(mosaic.ids, mosaic.of_class, mosaic.tops)
    if mosaic.log_depth is not None:
        return _by_depth(mosaic.log_depth, mosaic.of_class)
    return _one_way(np.zeros(mosaic.of_class.shape, np.int32), 0)


def _by_instance(ids: Ids, of_class: Image, tops: Indices) -> Division:
    """The instances of the class in each cutout."""
    cutout = np.repeat(np.arange(len(tops) - 1), np.diff(tops))[:, None]
    owned = np.where((of_class > 0) & (ids > 0), cutout * 2**16 + ids, 0)
    numbers = np.unique(owned[owned > 0])
    labels = np.where(owned > 0, np.searchsorted(numbers, owned) + 1, 0).astype(np.int32)
    return _one_way(labels, len(numbers))


def _one_way(labels: Labels, count: int) -> Division:
    """Of (H, W) labels from 1 to ``count``."""
    rows, columns = _places(labels > 0)
    single = np.array((columns, rows, columns + 1, rows + 1))
    groups = labels[rows, columns].astype(np.int64) - 1
    bounds, pixels = _together(groups, count, single, np.ones(len(rows), np.int64))
    return Division(labels, np.arange(count + 1)[None], np.zeros(count, np.int64), bounds, pixels)


def _places(mask: NDArray[np.bool_]) -> tuple[Indices, Indices]:
    """Rows and columns of true pixels: what NumPy's own for two axes costs five times as much for."""
    rows, columns = np.divmod(np.flatnonzero(mask), mask.shape[1])
    return rows, columns


def _together(groups: Indices, count: int, bounds: Indices, pixels: Indices) -> tuple[Indices, Indices]:
    """(4, count) bounds and (count,) pixels of groups of regions, of which each is in one."""
    joined = np.concatenate((np.full((2, count), np.iinfo(np.int64).max), np.zeros((2, count), np.int64)))
    for into, values in zip(joined[:2], bounds[:2], strict=True):
        np.minimum.at(into, groups, values)
    for into, values in zip(joined[2:], bounds[2:], strict=True):
        np.maximum.at(into, groups, values)
    return joined, np.bincount(groups, pixels, count).astype(np.int64)


def _by_depth(log_depth: Float32, of_class: Image) -> Division:
    """The regions of the smallest jump, and those that each larger one joins anew."""
    beside, below = (of_class[:, 1:] & of_class[:, :-1]) > 0, (of_class[1:] & of_class[:-1]) > 0
    across, down = np.abs(log_depth[:, 1:] - log_depth[:, :-1]), np.abs(log_depth[1:] - log_depth[:-1])
    labels = _connected(of_class, beside & (across < JUMPS[0]), below & (down < JUMPS[0]))
    finest = _one_way(labels, int(labels.max(initial=0)))
    aside, under = _edges(labels[:, 1:], labels[:, :-1], beside, across), _edges(labels[1:], labels[:-1], below, down)
    pairs, steps = np.concatenate((aside[0], under[0]), axis=1), np.concatenate((aside[1], under[1]))
    return _with_joined(finest, pairs, steps)


def _connected(of_class: Image, beside: NDArray[np.bool_], below: NDArray[np.bool_]) -> Labels:
    """(H, W) labels of pixels that are connected, on a grid that has a cell for each pair of neighbours too."""
    height, width = of_class.shape
    grid = np.zeros((2 * height - 1, 2 * width - 1), np.uint8)
    grid[::2, ::2] = of_class
    grid[::2, 1::2] = beside
    grid[1::2, ::2] = below
    _, labels = cv2.connectedComponents(grid, connectivity=4, ltype=cv2.CV_32S)
    return np.asarray(labels[::2, ::2], np.int32)


def _edges(one: Labels, other: Labels, neighbours: NDArray[np.bool_], steps: Float32) -> tuple[Indices, Float32]:
    """(2, E) the regions on either side, from 0, and (E,) the step, where neighbours are of two regions."""
    rows, columns = _places(neighbours & (steps < JUMPS[-1]) & (one != other))
    return np.array((one[rows, columns], other[rows, columns]), np.int64) - 1, steps[rows, columns]


def _with_joined(finest: Division, pairs: Indices, steps: Float32) -> Division:
    """The regions of the smallest jump, with those that larger ones make of them."""
    count = len(finest.pixels)
    names, ways, bounds, pixels = [finest.names[0]], [finest.ways], [finest.bounds], [finest.pixels]
    before, regions = np.ones(count, np.int64), count
    for way, jump in enumerate(JUMPS[1:], 1):
        first = _first_of_joined(pairs[:, steps < np.float32(jump)], count)
        members = np.bincount(first, minlength=count)
        new = np.flatnonzero((members > 0) & (members != before))
        number = np.full(count, -1)
        number[new] = np.arange(len(new))
        parts = np.flatnonzero(number[first] >= 0)
        groups = number[first[parts]]
        joined = _together(groups, len(new), finest.bounds[:, parts], finest.pixels[parts])
        called = np.zeros(count + 1, np.int64)
        called[parts + 1] = regions + 1 + groups
        for kept, of_way in zip((names, ways, bounds, pixels), (called, np.full(len(new), way), *joined), strict=True):
            kept.append(of_way)
        before, regions = members, regions + len(new)
    return Division(
        finest.labels, np.stack(names), np.concatenate(ways), np.concatenate(bounds, axis=1), np.concatenate(pixels)
    )


def _first_of_joined(pairs: Indices, count: int) -> Indices:
    """(count,) the first of all that each region is joined with by (2, E) pairs, itself among them.

    Source: Y. Shiloach and U. Vishkin, An O(log n) parallel connectivity algorithm, Journal of Algorithms 3 (1982).
    """
    first = np.arange(count)
    while True:
        lower = first.copy()
        least = np.minimum(first[pairs[0]], first[pairs[1]])
        np.minimum.at(lower, pairs[0], least)
        np.minimum.at(lower, pairs[1], least)
        lower = lower[lower]
        if np.array_equal(lower, first):
            return first
        first = lower
