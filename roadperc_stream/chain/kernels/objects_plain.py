"""What ``objects_compiled`` does, in numpy and OpenCV; the compiled form alone checks the sizes."""

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
        parts = np.flatnonzero(number[group] >= 0)
        groups = number[group[parts]]
        called = np.zeros(count + 1, np.int64)
        called[parts + 1] = regions + 1 + groups
        joined = _together(groups, len(new), first_bounds[:, parts], first_pixels[parts])
        for kept, of_way in zip((names, ways, bounds, pixels), (called, np.full(len(new), way), *joined), strict=True):
            kept.append(of_way)
        before, regions = members[group], regions + len(new)
    return finest, np.stack(names), np.concatenate(ways), np.concatenate(bounds, axis=1), np.concatenate(pixels)


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


def region_distances(
    labels: NDArray[np.int32], of_region: NDArray[np.bool_], distances_m: Float32, noise: Float32
) -> tuple[Float32, Float32]:
    """The distances of a region's pixels, each the mean of the region's known ones in the 3x3 around it.

    Those are summed in float64, each row and then the rows. Pixels without a distance are left out; an infinite one
    stays as it is.

    Args:
        labels: (h, w) of the pixels.
        of_region: (n,) of each label whether its pixels are the region's.
        distances_m: (h, w) NaN unknown and infinite beyond the depth's range.
        noise: (h, w) of the distances.

    Returns:
        (N,) distances, and (M,) the noise of those that are finite; row by row.
    """
    mask = of_region[labels]
    finite = mask & (distances_m < np.inf)
    sums = _sums(np.where(finite, distances_m, 0.0).astype(np.float64)).astype(np.float32)
    means = sums / np.maximum(_sums(finite.astype(np.float64)), 1.0).astype(np.float32)
    near = np.where(finite, means, distances_m)
    return near[mask & ~np.isnan(distances_m)], noise[finite]


def _sums(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(h, w) of the 3x3 around each."""
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
    """The points of a box's pixels that lie so far behind a distance.

    Args:
        depth_m: (H, W) NaN unknown.
        camera: fx, fy, cx and cy in pixels.
        box: first column and row and those behind the last, in the image, and the step from one pixel that is looked
            at to the next of a row or column.
        of_class: (H, W) tags, and (256,) above 0 at those that the points may have; None for all.
        distance_m: of the object.
        behind_m: by how much more their own are at least and at most, both exclusive.

    Returns:
        (N, 3) points in the camera's frame, and (N,) their distances, row by row.
    """
    x0, y0, x1, y1, step = box
    fx, fy, cx, cy = camera
    part = slice(y0, max(y1, y0), step), slice(x0, max(x1, x0), step)
    x, y = (np.arange(x0, x1, step) - cx) / fx, (np.arange(y0, y1, step) - cy) / fy
    depths = depth_m[part].astype(np.float64)
    behind = depths * np.sqrt(x**2 + (y**2 + 1.0)[:, None]) - distance_m
    chosen = (behind > behind_m[0]) & (behind < behind_m[1])
    if of_class:
        chosen &= of_class[1][of_class[0][part]] > 0
    rows, columns = np.nonzero(chosen)
    z = depths[chosen]
    points = np.stack((x[columns] * z, y[rows] * z, z), axis=-1)
    return points, np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + z**2)
