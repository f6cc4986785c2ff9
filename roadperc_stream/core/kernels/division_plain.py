"""What ``division_compiled`` does, in numpy and OpenCV."""

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Indices = NDArray[np.int64]
Labels = NDArray[np.int32]
Divided = tuple[Labels, Indices, Indices, Indices, Indices]


def divided(log_depth: Float32, of_class: Image, jumps: Float32) -> Divided:
    """The regions of the smallest jump, and those that each larger one joins anew.

    Args:
        log_depth: (H, W), at least one pixel.
        of_class: (H, W) 1 at pixels that may be of a region, else 0.
        jumps: (n,) from the smallest on: pixels beside or below each other whose depths differ by less are joined.

    Returns:
        (H, W) labels of the smallest jump's regions in the order of their first pixels, 0 of none; (n, labels) what
        each is called by each jump, 0 where no region that is new by that jump has it; of the K regions, those of a
        smaller jump before the others: the jump's index (K,), first column and row and those behind the last (4, K),
        and how many pixels each has (K,).

    Raises:
        ValueError: of other sizes, no pixels or no jumps.
    """
    if log_depth.shape != of_class.shape or not of_class.size or not len(jumps):
        raise ValueError(f"{of_class.shape} pixels, {log_depth.shape} depths, {len(jumps)} jumps")
    beside, below = (of_class[:, 1:] & of_class[:, :-1]) > 0, (of_class[1:] & of_class[:-1]) > 0
    across, down = np.abs(log_depth[:, 1:] - log_depth[:, :-1]), np.abs(log_depth[1:] - log_depth[:-1])
    labels = _connected(of_class, beside & (across < jumps[0]), below & (down < jumps[0]))
    finest = numbered(labels, int(labels.max(initial=0)))
    beside, below = beside & (across < jumps[-1]), below & (down < jumps[-1])
    aside, under = _edges(labels[:, 1:], labels[:, :-1], beside, across), _edges(labels[1:], labels[:-1], below, down)
    pairs, steps = np.concatenate((aside[0], under[0]), axis=1), np.concatenate((aside[1], under[1]))
    return _with_joined(finest, pairs, steps, jumps)


def _connected(of_class: Image, beside: NDArray[np.bool_], below: NDArray[np.bool_]) -> Labels:
    """(H, W) labels of pixels that are connected, on a grid that has a cell for each pair of neighbours too."""
    height, width = of_class.shape
    grid = np.zeros((2 * height - 1, 2 * width - 1), np.uint8)
    grid[::2, ::2] = of_class
    grid[::2, 1::2] = beside
    grid[1::2, ::2] = below
    _, labels = cv2.connectedComponents(grid, connectivity=4, ltype=cv2.CV_32S)
    return np.asarray(labels[::2, ::2], np.int32)


def numbered(labels: Labels, count: int) -> Divided:
    """The regions of (H, W) labels from 1 to ``count``, as those of one jump."""
    rows, columns = _places(labels > 0)
    single = np.array((columns, rows, columns + 1, rows + 1))
    groups = labels[rows, columns].astype(np.int64) - 1
    bounds, pixels = _together(groups, count, single, np.ones(len(rows), np.int64))
    return labels, np.arange(count + 1)[None], np.zeros(count, np.int64), bounds, pixels


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


def _edges(one: Labels, other: Labels, neighbours: NDArray[np.bool_], steps: Float32) -> tuple[Indices, Float32]:
    """(2, E) the regions on either side, from 0, and (E,) the step, where neighbours are of two regions."""
    rows, columns = _places(neighbours & (one != other))
    return np.array((one[rows, columns], other[rows, columns]), np.int64) - 1, steps[rows, columns]


def _with_joined(finest: Divided, pairs: Indices, steps: Float32, jumps: Float32) -> Divided:
    """The regions of the smallest jump, with those that larger ones make of them."""
    labels, first_names, first_ways, first_bounds, first_pixels = finest
    count = len(first_pixels)
    names, ways, bounds, pixels = [first_names[0]], [first_ways], [first_bounds], [first_pixels]
    before, regions = np.ones(count, np.int64), count
    for way, jump in enumerate(jumps[1:], 1):
        first = _first_of_joined(pairs[:, steps < jump], count)
        members = np.bincount(first, minlength=count)
        new = np.flatnonzero((members > 0) & (members != before))
        number = np.full(count, -1)
        number[new] = np.arange(len(new))
        parts = np.flatnonzero(number[first] >= 0)
        groups = number[first[parts]]
        joined = _together(groups, len(new), first_bounds[:, parts], first_pixels[parts])
        called = np.zeros(count + 1, np.int64)
        called[parts + 1] = regions + 1 + groups
        for kept, of_way in zip((names, ways, bounds, pixels), (called, np.full(len(new), way), *joined), strict=True):
            kept.append(of_way)
        before, regions = members, regions + len(new)
    return labels, np.stack(names), np.concatenate(ways), np.concatenate(bounds, axis=1), np.concatenate(pixels)


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
