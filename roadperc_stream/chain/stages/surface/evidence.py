"""Whether a road leaves its plane: the evidence by which ``surface.model = "auto"`` takes the height field.

The road near the car is cut into patches, and the median height of each one's cells over the plane is compared with
two errors: its own, by which chance alone would lift it, and that of a height field fitted to the same cells. The
field follows the road everywhere, but its coefficients cost accuracy in proportion to the cells' scatter; the plane
has next to none of that error and all of the bias (Mallows 1973). So the field pays where patches lie off the plane by
more than both: on roads that climb, and where noise has tilted the plane itself.
"""

import math
from typing import Final

import numpy as np

from roadperc_stream.core.geometry import Float

_PATCH_M: Final = 5.0
"""Length of a patch; there is one on either side of the ego x axis."""
_REACH_M: Final = 40.0
"""Patches farther ahead hold few points, of a road that is seen at a grazing angle."""
_HALF_WIDTH_M: Final = 4.0
_MIN_CELLS: Final = 5
_STDS: Final = 2.0
_MEDIAN_STD: Final = 1.25
"""Standard error of a median of many normal errors over that of their mean."""
NORMAL_MAD: Final = 1.4826
"""Standard deviation of normal errors over their median absolute one."""
_FIELD_STD: Final = 0.25
"""Error of a height field over the standard deviation of the cells' heights, measured on rendered roads."""
_FINEST_M: Final = 0.0005
"""Height for which no field is worth its time."""
_SHARE: Final = 0.2
"""Share of the patches that must lie off the plane."""


def leaves_plane(cells: Float) -> bool:
    """Whether a road lies off its plane by more than a height field would be wrong.

    Args:
        cells: (N, 3) x ahead, y to the left and height above the plane of the road's cells, metres.
    """
    off = [_lies_off(heights) for heights in _patches(cells) if len(heights) >= _MIN_CELLS]
    return bool(off) and sum(off) >= _SHARE * len(off)


def median(values: Float) -> float:
    """Median of (N,) numbers, N > 0: numpy's own takes many times as long for a few hundred."""
    ordered, middle = np.sort(values), len(values) // 2
    return float(ordered[middle] if len(values) % 2 else (ordered[middle - 1] + ordered[middle]) / 2)


def _lies_off(heights: Float) -> bool:
    """Whether (N,) heights of a patch are off by more than chance and a field's own error."""
    middle = median(heights)
    std = NORMAL_MAD * median(np.abs(heights - middle))
    by_chance = _STDS * _MEDIAN_STD * std / math.sqrt(len(heights))
    return abs(middle) > max(by_chance, _FIELD_STD * std, _FINEST_M)


def _patches(cells: Float) -> list[Float]:
    """The heights of each patch's cells."""
    x, y, heights = cells[(cells[:, 0] < _REACH_M) & (np.abs(cells[:, 1]) < _HALF_WIDTH_M)].T
    patch = 2 * (x // _PATCH_M) + (y > 0)
    order = np.argsort(patch, kind="stable")
    _, first = np.unique(patch[order], return_index=True)
    return np.split(heights[order], first[1:])
