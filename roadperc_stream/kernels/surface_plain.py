"""The functions of ``surface_compiled`` in numpy; only the compiled ones check sizes (ValueError)."""

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Places = NDArray[np.int64]


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
