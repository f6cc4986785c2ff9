"""What ``facing_edges_compiled`` does, in numpy."""

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Indices = NDArray[np.intp]


def facing_edges(marked: Image, road: Image, towards: int, fringe: int) -> NDArray[np.float64]:
    """(N, 2) columns and rows halfway between the last of marked pixels in a row and the road on one side of them.

    Row by row from above, and in each towards that side.

    Args:
        marked: (H, W) 1 at marked pixels, else 0.
        road: (H, W) not 0 at the road.
        towards: 1 for the road to the right of a marking, -1 for that to the left.
        fringe: pixels that may lie between both and are neither; all beyond the image are its last one.

    Raises:
        ValueError: images of other sizes.
    """
    if marked.shape != road.shape:
        raise ValueError(f"{marked.shape} marked pixels, {road.shape} of road: expected one size")
    rows, columns = _last_of_marked(marked, towards)
    gap = _gap(marked, road, rows, columns, towards, fringe)
    found = gap >= 0
    rows, columns, gap = rows[found], columns[found], gap[found]
    return np.stack((columns + towards * 0.5 * (gap + 1), rows.astype(np.float64)), axis=-1)


def _last_of_marked(marked: Image, towards: int) -> tuple[Indices, Indices]:
    """Rows and columns of marked pixels with none beside them on that side."""
    width = max(marked.shape[1] - 1, 1)
    if towards > 0:
        rows, columns = np.divmod(np.flatnonzero(marked[:, :-1] > marked[:, 1:]), width)
        return rows, columns
    rows, columns = np.divmod(np.flatnonzero(marked[:, 1:] > marked[:, :-1])[::-1], width)
    order = np.argsort(rows, kind="stable")
    return rows[order], columns[order] + 1


def _gap(marked: Image, road: Image, rows: Indices, columns: Indices, towards: int, fringe: int) -> Indices:
    """(N,) pixels between marked ones and the road; -1 where there is none so near, or another marked one before it."""
    gap = np.full(len(rows), -1)
    sought = np.arange(len(rows))
    for step in range(fringe + 1):
        row, beyond = rows[sought], np.clip(columns[sought] + towards * (1 + step), 0, marked.shape[1] - 1)
        other = marked[row, beyond] > 0
        met = (road[row, beyond] > 0) & ~other
        gap[sought[met]] = step
        sought = sought[~(met | other)]
        if not len(sought):
            break
    return gap
