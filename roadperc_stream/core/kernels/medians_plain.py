"""The place of each cell's median, by numpy."""

import numpy as np
from numpy.typing import NDArray

Places = NDArray[np.int64]


def median_places(cell: NDArray[np.int32], values: NDArray[np.float32], cells: int) -> tuple[Places, Places]:
    """Where each cell's median value stands, the lower one of an even number, and how many values the cell has.

    Of equal values the first counts as the smaller one. Cells without values are left out.

    Args:
        cell: (N,) of each value.
        values: (N,) none of them NaN.
        cells: how many there are.

    Returns:
        (M,) places among the values, in the order of the cells, and (M,) numbers of values.

    Raises:
        ValueError: not as many cells as values, or a cell that there is not.
    """
    if len(cell) != len(values) or (len(cell) and not 0 <= cell.min() <= cell.max() < cells):
        raise ValueError(f"{len(values)} values in {len(cell)} places of {cells} cells")
    order = np.lexsort((values, cell))
    counts = np.bincount(cell, minlength=cells)
    last = np.cumsum(counts) - 1
    filled = counts > 0
    counts, last = counts[filled], last[filled]
    return order[last - counts // 2], counts
