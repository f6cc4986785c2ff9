"""Which of a lidar's few points in a box are the object's.

Of groups of points that a gap in distance parts it is the one whose bounds fill most of the box.
"""

import numpy as np

from roadperc_stream.chain.stages.objects.boxes import areas
from roadperc_stream.core.geometry import Float32

GAP = 0.08
"""Share of the distance from one point to the next beyond which they are of different objects."""
LEAST_POINTS = 3


def own_distances(distances_m: Float32) -> Float32:
    """(N,) distances of the points that are the object's.

    Args:
        distances_m: (h, w) of the pixels of a box, NaN where there is no point or one of another class.

    Returns:
        All of them where no group has three points.
    """
    rows, columns = np.nonzero(~np.isnan(distances_m))
    order = np.argsort(distances_m[rows, columns], kind="stable")
    rows, columns = rows[order], columns[order]
    sorted_m = distances_m[rows, columns]
    first = np.flatnonzero(np.append(True, sorted_m[1:] > sorted_m[:-1] * (1 + GAP)))[: len(sorted_m)]
    if not len(first):
        return sorted_m
    last = np.append(first[1:], len(sorted_m))
    low = [np.minimum.reduceat(places, first) for places in (columns, rows)]
    high = [np.maximum.reduceat(places, first) + 1 for places in (columns, rows)]
    filled = np.where(last - first >= LEAST_POINTS, areas(np.array((*low, *high), np.float64)), 0.0)
    best = int(np.argmax(filled))
    return sorted_m[first[best] : last[best]] if filled[best] > 0 else sorted_m
