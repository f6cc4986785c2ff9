"""What ``surface_compiled`` does, in numpy; the compiled form alone checks the sizes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Marks = NDArray[np.uint8]
Float = NDArray[np.float64]
Places = NDArray[np.int64]


class PlaneDistances(NamedTuple):
    """How far a pixel at depth z is from a plane: z (column + row) + offset, of its column and its row.

    ``column`` is (W,), ``row`` (H,), both metres per metre of depth; ``offset_m`` is the distance at depth 0.
    """

    column: Float32
    row: Float32
    offset_m: float


def mark_near(depth_m: Float32, distances: PlaneDistances, within_m: float, among: Marks, near: Marks) -> None:
    """Write which marked pixels are within a distance of a plane.

    Args:
        depth_m: (H, W); of NaN the pixel is nowhere near.
        distances: from the plane.
        within_m: the largest distance, either side.
        among: (H, W) 0 or 1, the pixels that count.
        near: (H, W), written: 0 or 1.
    """
    np.bitwise_and(among, _near(depth_m, distances, within_m), out=near)


def moments_near(
    depth_m: Float32, distances: PlaneDistances, within_m: float, among: Marks, ray_x: Float32
) -> NDArray[np.float64]:
    """(H, 6) sums of each row over its marked pixels within a distance of a plane: 1, z, x, z z, x z and x x.

    z is the depth and x the ray's times z, in float32. The sums are of float64, from left to right.

    Args:
        depth_m: (H, W); of NaN the pixel does not count.
        distances: from the plane.
        within_m: the largest distance, either side.
        among: (H, W) 0 or 1, the pixels that count.
        ray_x: (W,) x of the rays with z = 1.
    """
    near = among.view(bool) & _near(depth_m, distances, within_m)
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
    """
    return np.flatnonzero(marks)[ranks]


def _near(depth_m: Float32, distances: PlaneDistances, within_m: float) -> NDArray[np.bool_]:
    column, row, offset_m = distances
    with np.errstate(invalid="ignore", over="ignore"):
        distance_m = depth_m * (row[:, None] + column[None, :])
        distance_m += np.float32(offset_m)
        near: NDArray[np.bool_] = np.abs(distance_m) <= np.float32(within_m)
    return near


def median_places(cell: NDArray[np.int32], values: NDArray[np.float32], cells: int) -> tuple[Places, Places]:
    """Where each cell's median value stands, the lower one of an even number, and how many values the cell has.

    Of equal values the first counts as the smaller one. Cells without values are left out.

    Args:
        cell: (N,) of each value.
        values: (N,) none of them NaN.
        cells: how many there are.

    Returns:
        (M,) places among the values, in the order of the cells, and (M,) numbers of values.
    """
    order = np.lexsort((values, cell))
    counts = np.bincount(cell, minlength=cells)
    last = np.cumsum(counts) - 1
    filled = counts > 0
    counts, last = counts[filled], last[filled]
    return order[last - counts // 2], counts


def normal_equations(
    first: NDArray[np.intp], values: Float, weights: Float, targets: Float, count: int
) -> tuple[Float, Float]:
    """A^T W A and A^T W b of N weighted equations A x = b, each of D unknowns that are neighbours.

    The sums go from the first equation to the last.

    Args:
        first: (N,) index of the first of the unknowns in each.
        values: (N, D) by how much each counts.
        weights: (N,).
        targets: (N,).
        count: of the unknowns, P.

    Returns:
        (D, P) diagonals of the matrix in and below its middle, each element at its column, and the (P,) right side.
    """
    unknowns = values.shape[1]
    row, column = np.tril_indices(unknowns)
    products = weights[:, None] * (values[:, row] * values[:, column])
    lower = np.bincount(((row - column) * count + first[:, None] + column).ravel(), products.ravel(), unknowns * count)
    right = np.bincount(
        (first[:, None] + np.arange(unknowns)).ravel(), ((weights * targets)[:, None] * values).ravel(), count
    )
    return lower.reshape(unknowns, count).astype(float, copy=False), right.astype(float, copy=False)
