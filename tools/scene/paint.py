"""What of the ground is painted with lines that are not in the cross-section."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.geometry import Float32

from .ground import FAR_M, Ground
from .markings import Marking, Markings
from .section import DASH_M, DASH_PERIOD_M, LINE_M, Colour

PAINT_CONTRAST: Final = 0.3
"""Relative strength of the paint's grain, as the sections have it."""


@dataclass(frozen=True)
class Paint:
    """What of the ground's rows is painted.

    ``line`` are the pixels of the class, exactly; ``layers`` are colours with the share (rows, W) of each pixel that
    they cover, softly at the borders.
    """

    line: NDArray[np.bool_]
    layers: tuple[tuple[Colour, Float32], ...]


def paint_on(markings: Markings, ground: Ground, focal_px: float) -> Paint:
    """The paint that a camera sees."""
    s = ground.s_m + np.float64(ground.road.s_origin_m)
    bare = np.zeros(s.shape, np.bool_)
    for start, end in markings.missing:
        bare |= (s >= start) & (s < end)
    on_road = (ground.depth_m < FAR_M) & ~ground.curb & ~bare
    line = np.zeros(s.shape, np.bool_)
    layers: dict[Colour, Float32] = {}
    for marking in markings.lines:
        inside, cover = _painted(marking, ground, s, focal_px)
        line |= inside & on_road
        before = layers.get(marking.colour, np.float32(0))
        layers[marking.colour] = np.maximum(before, cover * on_road).astype(np.float32)
    return Paint(line, tuple(layers.items()))


def _painted(
    marking: Marking, ground: Ground, s_m: NDArray[np.float64], focal_px: float
) -> tuple[NDArray[np.bool_], Float32]:
    """(rows, W) whether a pixel is on the line, and the share of it that is."""
    there = (s_m >= marking.from_m) & (s_m < marking.to_m)
    if marking.dashed:
        there &= s_m % DASH_PERIOD_M < DASH_M
    inward = LINE_M / 2 - np.abs(ground.across_m - marking.middle_m.at(s_m))
    pixel_m = ground.depth_m / np.float32(focal_px)
    share = np.clip(inward / pixel_m + 0.5, 0, 1) * np.minimum(LINE_M / pixel_m, 1)
    return there & (inward >= 0), np.asarray(share * there, np.float32)
