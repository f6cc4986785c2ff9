"""The functions of ``objects_compiled`` in numpy and OpenCV; only the compiled ones check sizes (ValueError)."""

import cv2
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Image = NDArray[np.uint8]
Indices = NDArray[np.int64]
Labels = NDArray[np.int32]
Divided = tuple[Labels, Indices, Indices, Indices, Indices]
Float = NDArray[np.float64]
Numbers = tuple[float, float, float, float]


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


def region_distances(
    labels: NDArray[np.int32], of_region: NDArray[np.bool_], distances_m: Float32, noise: Float32
) -> tuple[Float32, Float32]:
    """The distances of a region's pixels, each the mean of the region's known distances in the 3x3 square around it.

    ``labels`` are (h, w), ``of_region`` (n,) marks the region's labels. ``distances_m`` is (h, w), NaN unknown and
    infinite beyond the depth's range; ``noise`` (h, w) belongs to them. Sums are in float64, first along rows.

    Returns:
        (N,) known distances, and the (M,) noise of the finite ones; row by row. Infinite distances stay infinite.
    """
    mask = of_region[labels]
    finite = mask & (distances_m < np.inf)
    sums = _sums(np.where(finite, distances_m, 0.0).astype(np.float64)).astype(np.float32)
    means = sums / np.maximum(_sums(finite.astype(np.float64)), 1.0).astype(np.float32)
    near = np.where(finite, means, distances_m)
    return near[mask & ~np.isnan(distances_m)], noise[finite]


def _sums(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(h, w) sums over the 3x3 square around each value."""
    padded = np.pad(values, 1)
    rows = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    return rows[:-2] + rows[1:-1] + rows[2:]


def object_points(
    depth_m: NDArray[np.float32],
    camera: Numbers,
    box: tuple[int, int, int, int, int],
    of_class: tuple[Image, Image] | None,
    distance_m: float,
    behind_m: tuple[float, float],
) -> tuple[Float, Float]:
    """The points of a box's pixels near or behind an object's distance.

    Args:
        depth_m: (H, W) metres, NaN unknown.
        camera: fx, fy, cx and cy in pixels.
        box: first column and row, those behind the last, and the step between the used columns and rows.
        of_class: (H, W) tags, and (256,) above 0 at the accepted ones; None accepts all.
        distance_m: the object's distance.
        behind_m: range of the points' distances beyond the object's, both ends excluded.

    Returns:
        (N, 3) points in the camera's frame, and (N,) their distances, row by row.
    """
    x0, y0, x1, y1, step = box
    fx, fy, cx, cy = camera
    cutout = slice(y0, max(y1, y0), step), slice(x0, max(x1, x0), step)
    x, y = (np.arange(x0, x1, step) - cx) / fx, (np.arange(y0, y1, step) - cy) / fy
    depths = depth_m[cutout].astype(np.float64)
    behind = depths * np.sqrt(x**2 + (y**2 + 1.0)[:, None]) - distance_m
    chosen = (behind > behind_m[0]) & (behind < behind_m[1])
    if of_class:
        chosen &= of_class[1][of_class[0][cutout]] > 0
    rows, columns = np.nonzero(chosen)
    z = depths[chosen]
    points = np.stack((x[columns] * z, y[rows] * z, z), axis=-1)
    return points, np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + z**2)
