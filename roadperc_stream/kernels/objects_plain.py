"""The function of ``objects_compiled`` in numpy and OpenCV; only the compiled one checks sizes (ValueError)."""

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Indices = NDArray[np.int64]
Labels = NDArray[np.int32]
Divided = tuple[Labels, Indices, Indices, Indices, Indices]


def divided(log_depth: Float32, of_class: Image, jumps: Float32) -> Divided:
    """Regions of pixels joined to neighbours whose depths differ by less than a jump, for each of several jumps.

    ``log_depth`` is (H, W), at least one pixel. ``of_class`` (H, W) is 1 at pixels that may belong to a region, else 0.
    ``jumps`` are (n,), ascending.

    Returns:
        (H, W) labels of the smallest jump's regions in the order of their first pixels, 0 outside. (n, labels) the
        number of the region that each label belongs to at each jump, 0 if that jump changes nothing. For the K regions,
        by ascending jump: (K,) index of the jump, (4, K) first column and row and those behind the last, (K,) pixels.
    """
    beside, below = (of_class[:, 1:] & of_class[:, :-1]) > 0, (of_class[1:] & of_class[:-1]) > 0
    across, down = np.abs(log_depth[:, 1:] - log_depth[:, :-1]), np.abs(log_depth[1:] - log_depth[:-1])
    finest, *coarser = (_connected(of_class, beside & (across < jump), below & (down < jump)) for jump in jumps)
    count = int(finest.max(initial=0))
    _, first_names, first_ways, first_bounds, first_pixels = numbered(finest, count)
    names, ways, bounds, pixels = [first_names[0]], [first_ways], [first_bounds], [first_pixels]
    before, regions = np.ones(count, np.int64), count
    for way, labels in enumerate(coarser, 1):
        label_of = np.zeros(count + 1, np.int64)
        label_of[finest] = labels
        _, first, group, members = np.unique(label_of[1:], return_index=True, return_inverse=True, return_counts=True)
        new = np.flatnonzero(members != before[first])
        number = np.full(len(members), -1)
        number[new] = np.arange(len(new))
        members_of_new = np.flatnonzero(number[group] >= 0)
        groups = number[group[members_of_new]]
        name = np.zeros(count + 1, np.int64)
        name[members_of_new + 1] = regions + 1 + groups
        joined = _together(groups, len(new), first_bounds[:, members_of_new], first_pixels[members_of_new])
        for kept, of_way in zip((names, ways, bounds, pixels), (name, np.full(len(new), way), *joined), strict=True):
            kept.append(of_way)
        before, regions = members[group], regions + len(new)
    return finest, np.stack(names), np.concatenate(ways), np.concatenate(bounds, axis=1), np.concatenate(pixels)


def _connected(of_class: Image, beside: NDArray[np.bool_], below: NDArray[np.bool_]) -> Labels:
    """(H, W) labels of connected pixels, found on a grid with an additional cell for each pair of neighbours."""
    height, width = of_class.shape
    grid = np.zeros((2 * height - 1, 2 * width - 1), np.uint8)
    grid[::2, ::2] = of_class
    grid[::2, 1::2] = beside
    grid[1::2, ::2] = below
    _, labels = cv2.connectedComponents(grid, connectivity=4, ltype=cv2.CV_32S)
    return np.asarray(labels[::2, ::2], np.int32)


def numbered(labels: Labels, count: int) -> Divided:
    """The regions of (H, W) labels from 1 to ``count``, as ``divided`` returns them for one jump."""
    rows, columns = np.divmod(np.flatnonzero(labels > 0), labels.shape[1])  # np.nonzero takes five times as long
    single = np.array((columns, rows, columns + 1, rows + 1))
    groups = labels[rows, columns].astype(np.int64) - 1
    bounds, pixels = _together(groups, count, single, np.ones(len(rows), np.int64))
    return labels, np.arange(count + 1)[None], np.zeros(count, np.int64), bounds, pixels


def _together(groups: Indices, count: int, bounds: Indices, pixels: Indices) -> tuple[Indices, Indices]:
    """(4, count) bounds and (count,) pixels of groups of regions; each region is in one group."""
    joined = np.concatenate((np.full((2, count), np.iinfo(np.int64).max), np.zeros((2, count), np.int64)))
    for into, values in zip(joined[:2], bounds[:2], strict=True):
        np.minimum.at(into, groups, values)
    for into, values in zip(joined[2:], bounds[2:], strict=True):
        np.maximum.at(into, groups, values)
    return joined, np.bincount(groups, pixels, count).astype(np.int64)
