"""The functions of ``surface_compiled`` in numpy; only the compiled ones check sizes (ValueError)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Marks = NDArray[np.uint8]
Float = NDArray[np.float64]
Places = NDArray[np.int64]


class PlaneDistances(NamedTuple):
    """The terms of a pixel's distance to a plane at depth z: z (column + row) + offset.

    ``column`` (W,) and ``row`` (H,) are in metres per metre of depth; ``offset_m`` is the distance at depth 0.
    """

    column: Float32
    row: Float32
    offset_m: float


def mark_near(depth_m: Float32, distances: PlaneDistances, within_m: float, among: Marks, near: Marks) -> None:
    """Write to ``near`` (H, W) 1 at pixels of ``among`` (H, W) 0 or 1 within a distance of a plane, else 0.

    ``depth_m`` is (H, W); NaN is never near. The distance counts to either side.
    """
    np.bitwise_and(among, _near(depth_m, distances, within_m), out=near)


def _near(depth_m: Float32, distances: PlaneDistances, within_m: float) -> NDArray[np.bool_]:
    column, row, offset_m = distances
    with np.errstate(invalid="ignore", over="ignore"):
        distance_m = depth_m * (row[:, None] + column[None, :])
        distance_m += np.float32(offset_m)
        near: NDArray[np.bool_] = np.abs(distance_m) <= np.float32(within_m)
    return near


def median_places(cell: NDArray[np.int32], values: NDArray[np.float32], cells: int) -> tuple[Places, Places]:
    """The index of each cell's median value and the number of its values: (M,) and (M,), in the order of cells.

    ``cell`` (N,) is the cell of each of the (N,) values, from 0 to ``cells`` - 1; no value is NaN. The median of an
    even number of values is the lower one; the first of equal values is the smaller one. Empty cells are left out.
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
    """A^T W A and A^T W b of N weighted equations A x = b for ``count`` = P unknowns.

    Equation n has the coefficients ``values`` (N, D) of the D unknowns from ``first`` (N,) on, the weight W ``weights``
    (N,) and the right side b ``targets`` (N,). Sums go from the first equation to the last.

    Returns:
        (D, P) main diagonal and the diagonals below it, each element at its column, and the (P,) right side.
    """
    unknowns = values.shape[1]
    row, column = np.tril_indices(unknowns)
    products = weights[:, None] * (values[:, row] * values[:, column])
    lower = np.bincount(((row - column) * count + first[:, None] + column).ravel(), products.ravel(), unknowns * count)
    right = np.bincount(
        (first[:, None] + np.arange(unknowns)).ravel(), ((weights * targets)[:, None] * values).ravel(), count
    )
    return lower.reshape(unknowns, count).astype(float, copy=False), right.astype(float, copy=False)


def solve_band(lower: Float, right: Float) -> Float | None:
    """(P,) solution of P equations with a symmetric band matrix, None if it is not positive definite.

    ``lower`` is (D, P): the main diagonal and the diagonals below it, each element at its column, as from
    ``normal_equations``; ``right`` is (P,). Method: L D L^T without pivoting (Golub and Van Loan 2013).
    """
    rest, x = lower.tolist(), right.tolist()
    count = len(x)
    for j in range(count):
        if not rest[0][j] > 0:
            return None
        reach = min(len(rest), count - j)
        for b in range(1, reach):
            factor = rest[b][j] / rest[0][j]
            for c in range(b, reach):
                rest[c - b][j + b] -= factor * rest[c][j]
            x[j + b] -= factor * x[j]
            rest[b][j] = factor
    for j in reversed(range(count)):
        x[j] /= rest[0][j]
        for b in range(1, min(len(rest), count - j)):
            x[j] -= rest[b][j] * x[j + b]
    return np.array(x)
