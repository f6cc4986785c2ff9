"""Edges of separators that face the ego lane: where the lane's road begins."""

import numpy as np

from roadperc_stream.chain.stages.lanes.sides import outward
from roadperc_stream.core.datatypes import Image, Mask, Side
from roadperc_stream.core.geometry import Float
from roadperc_stream.core.kernels.facing_edges import facing_edges as edges_towards

_FRINGE_PX = 4
"""Foreign pixels between a separator and the road that compression leaves there."""


def facing_edges(separators: Image, drivable: Mask, side: Side, top: int) -> Float:
    """(N, 2) pixels on the edge between a separator and the road beside it, towards the ego lane.

    Row by row from above, those of a row outermost first.

    Args:
        separators: (H - top, W) uint8 from row ``top`` down, 1 at separators.
        drivable: (H, W) drivable surface.
        side: the boundary's side: a left one faces right.
        top: the first row evaluated.
    """
    edges = edges_towards(separators, drivable[top:].view(np.uint8), round(outward(side)), _FRINGE_PX)
    edges[:, 1] += top
    return edges
