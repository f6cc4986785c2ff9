"""What ``bands_compiled`` does, in numpy."""

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


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

    Raises:
        ValueError: the arrays do not fit each other, or an equation has unknowns that there are not.
    """
    equations, unknowns = values.shape
    if not len(first) == len(weights) == len(targets) == equations:
        raise ValueError(f"{equations} equations, {len(first)} places, {len(weights)} weights, {len(targets)} targets")
    if equations and not 0 <= first.min() <= first.max() <= count - unknowns:
        raise ValueError(f"unknowns {first.min()} to {first.max() + unknowns - 1} of {count}")
    row, column = np.tril_indices(unknowns)
    products = weights[:, None] * (values[:, row] * values[:, column])
    lower = np.bincount(((row - column) * count + first[:, None] + column).ravel(), products.ravel(), unknowns * count)
    right = np.bincount(
        (first[:, None] + np.arange(unknowns)).ravel(), ((weights * targets)[:, None] * values).ravel(), count
    )
    return lower.reshape(unknowns, count).astype(float, copy=False), right.astype(float, copy=False)
