"""The pixels of a depth image that lie near a plane, and their moments, by numpy.

A plane is given by how far from it a point at depth 1 lies over what a point at depth 0 does: a part of the pixel's
column and one of its row. A pixel at depth z is z (column + row) + offset away from it.
"""

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Marks = NDArray[np.uint8]


def mark_known(depth_m: Float32, limit_m: float, among: Marks, known: Marks) -> None:
    """Write which marked pixels have a depth, one below a limit.

    Args:
        depth_m: (H, W), NaN unknown.
        limit_m: the limit.
        among: (H, W) 0 or 1, the pixels that count.
        known: (H, W), written: 0 or 1.

    Raises:
        ValueError: the arrays do not fit each other.
    """
    if not depth_m.shape == among.shape == known.shape:
        height, width = depth_m.shape
        raise ValueError(f"{among.shape} and {known.shape} marks of {height}x{width} depths")
    with np.errstate(invalid="ignore"):
        np.bitwise_and(among, depth_m < np.float32(limit_m), out=known)


def mark_near(
    depth_m: Float32, column: Float32, row: Float32, offset_m: float, within_m: float, among: Marks, near: Marks
) -> None:
    """Write which marked pixels are within a distance of a plane.

    Args:
        depth_m: (H, W); of NaN the pixel is nowhere near.
        column: (W,) distance per depth.
        row: (H,) distance per depth.
        offset_m: distance at depth 0.
        within_m: the largest distance, either side.
        among: (H, W) 0 or 1, the pixels that count.
        near: (H, W), written: 0 or 1.

    Raises:
        ValueError: the arrays do not fit each other.
    """
    for marks in (among, near):
        _require_fitting(depth_m, column, row, marks)
    np.bitwise_and(among, _near(depth_m, column, row, offset_m, within_m), out=near)


def count_near(depth_m: Float32, column: Float32, row: Float32, offset_m: float, within_m: float, among: Marks) -> int:
    """How many pixels ``mark_near`` marks.

    Raises:
        ValueError: the arrays do not fit each other.
    """
    near = np.empty_like(among)
    mark_near(depth_m, column, row, offset_m, within_m, among, near)
    return int(np.count_nonzero(near))


def moments_near(
    depth_m: Float32,
    column: Float32,
    row: Float32,
    offset_m: float,
    within_m: float,
    among: NDArray[np.uint8],
    ray_x: Float32,
) -> NDArray[np.float64]:
    """(H, 6) sums of each row over its marked pixels within a distance of a plane: 1, z, x, z z, x z and x x.

    z is the depth and x the ray's times z, in float32. The sums are of float64, from left to right.

    Args:
        depth_m: (H, W); of NaN the pixel does not count.
        column: (W,) distance per depth.
        row: (H,) distance per depth.
        offset_m: distance at depth 0.
        within_m: the largest distance, either side.
        among: (H, W) 0 or 1, the pixels that count.
        ray_x: (W,) x of the rays with z = 1.

    Raises:
        ValueError: the arrays do not fit each other.
    """
    _require_fitting(depth_m, column, row, among, ray_x)
    near = among.view(bool) & _near(depth_m, column, row, offset_m, within_m)
    rows, columns = np.nonzero(near)
    z = depth_m[near]
    x, z = (ray_x[columns] * z).astype(float), z.astype(float)
    # NumPy's own sum adds in another order.
    sums = [np.bincount(rows, terms, len(depth_m)) for terms in (np.ones(len(z)), z, x, z * z, x * z, x * x)]
    return np.stack(sums, axis=-1)


def marked(marks: NDArray[np.uint8], ranks: NDArray[np.int64]) -> NDArray[np.int64]:
    """(N,) places of chosen ones of an image's marks, counted row by row.

    Args:
        marks: (H, W) 0 or 1.
        ranks: (N,) which: 0 is the first mark.

    Raises:
        IndexError: there is no such mark.
    """
    places = np.flatnonzero(marks)
    if len(ranks) and not 0 <= ranks.min() <= ranks.max() < len(places):
        raise IndexError(f"marks {ranks.min()} to {ranks.max()} of {len(places)}")
    return places[ranks]


def _near(depth_m: Float32, column: Float32, row: Float32, offset_m: float, within_m: float) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore", over="ignore"):
        distance_m = depth_m * (row[:, None] + column[None, :])
        distance_m += np.float32(offset_m)
        near: NDArray[np.bool_] = np.abs(distance_m) <= np.float32(within_m)
    return near


def _require_fitting(
    depth_m: Float32, column: Float32, row: Float32, marks: NDArray[np.uint8], ray_x: Float32 | None = None
) -> None:
    height, width = depth_m.shape
    columns = len(column) if ray_x is None or len(ray_x) == len(column) else -1
    if (len(row), columns) != (height, width) or marks.shape != (height, width):
        raise ValueError(f"{len(row)}x{columns} distances and {marks.shape} marks of {height}x{width} depths")
