"""Edges of separators that face the ego lane: where the lane's road begins."""

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.datatypes import Image, Mask, Side
from roadperc_stream.core.geometry import Float

_FRINGE_PX = 4
"""Foreign pixels between a separator and the road that compression leaves there."""

Indices = NDArray[np.intp]


def facing_edges(separators: Image, drivable: Mask, side: Side, top: int) -> Float:
    """(N, 2) pixels on the edge between a separator and the road beside it, towards the ego lane.

    Row by row from above, those of a row outermost first.

    Args:
        separators: (H - top, W) uint8 from row ``top`` down, 1 at separators.
        drivable: (H, W) drivable surface.
        side: the boundary's side: a left one faces right.
        top: the first row evaluated.
    """
    towards = 1 if side == "left" else -1
    rows, columns = _last_of_separators(separators, towards)
    gap = _gap(separators, drivable[top:], rows, columns, towards)
    found = gap >= 0
    rows, columns, gap = rows[found], columns[found], gap[found]
    return np.stack((columns + towards * 0.5 * (gap + 1), rows + float(top)), axis=-1)


def _last_of_separators(separators: Image, towards: int) -> tuple[Indices, Indices]:
    """Rows and columns of separators' pixels with none beside them to the right (``towards`` 1) or to the left (-1)."""
    width = separators.shape[1] - 1
    if towards > 0:
        rows, columns = np.divmod(np.flatnonzero(separators[:, :-1] > separators[:, 1:]), width)
        return rows, columns
    rows, columns = np.divmod(np.flatnonzero(separators[:, 1:] > separators[:, :-1])[::-1], width)
    order = np.argsort(rows, kind="stable")
    return rows[order], columns[order] + 1


def _gap(separators: Image, drivable: Mask, rows: Indices, columns: Indices, towards: int) -> Indices:
    """(N,) foreign pixels between separators' last pixels and the road; -1 where there is none, or another separator.

    All beyond the image's side are its last one.
    """
    gap = np.full(len(rows), -1)
    sought = np.arange(len(rows))
    for step in range(_FRINGE_PX + 1):
        row, beyond = rows[sought], np.clip(columns[sought] + towards * (1 + step), 0, separators.shape[1] - 1)
        marked = separators[row, beyond] > 0
        road = drivable[row, beyond] & ~marked
        gap[sought[road]] = step
        sought = sought[~(road | marked)]
        if not len(sought):
            break
    return gap
