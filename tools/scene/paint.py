"""What of the ground is painted with lines that are not in the cross-section."""

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.geometry import Float32

from .grain import pink_noise
from .ground import FAR_M, Ground
from .lanes import Marking, Markings
from .options import Stretch
from .section import DASH_M, DASH_PERIOD_M, LINE_M, Colour, line_gap

PAINT_CONTRAST: Final = 0.3
"""Relative strength of the paint's grain, as the sections have it."""

REMAINING: Final = 0.35
"""Share of worn paint that is still there."""
FADED: Final = 0.6
"""How much of its colour that has left."""
WEAR_TEXEL_M: Final = 0.04


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
    on_road = (ground.depth_m < FAR_M) & ~ground.curb & ~_within(s, markings.missing)
    fresh: Float32 = np.ones(s.shape, np.float32)
    if markings.worn:
        worn = _within(s, markings.worn)
        on_road &= ~worn | _remains(s, ground.across_m)
        fresh = np.where(worn, np.float32(FADED), fresh)
    line = np.zeros(s.shape, np.bool_)
    layers: dict[Colour, Float32] = {}
    for marking in markings.lines:
        inside, cover = _painted(marking, ground, s, focal_px)
        line |= inside & on_road
        before = layers.get(marking.colour, np.float32(0))
        layers[marking.colour] = np.maximum(before, cover * on_road * fresh).astype(np.float32)
    return Paint(line, tuple(layers.items()))


def _within(s_m: NDArray[np.float64], stretches: tuple[Stretch, ...]) -> NDArray[np.bool_]:
    inside = np.zeros(s_m.shape, np.bool_)
    for start, end in stretches:
        inside |= (s_m >= start) & (s_m < end)
    return inside


def _remains(s_m: NDArray[np.float64], across_m: Float32) -> NDArray[np.bool_]:
    """Where worn paint is still there."""
    pattern = _wear_pattern()
    rows = np.floor(s_m / WEAR_TEXEL_M).astype(np.intp) % pattern.shape[0]
    columns = np.floor(across_m / WEAR_TEXEL_M).astype(np.intp) % pattern.shape[1]
    remains: NDArray[np.bool_] = pattern[rows, columns]
    return remains


@cache
def _wear_pattern() -> NDArray[np.bool_]:
    """Patches of every size; it repeats every 20 m along the road and every 5 m across it."""
    noise = pink_noise((512, 128), np.random.default_rng(17))
    return noise > np.quantile(noise, 1 - REMAINING)


def _painted(
    marking: Marking, ground: Ground, s_m: NDArray[np.float64], focal_px: float
) -> tuple[NDArray[np.bool_], Float32]:
    """(rows, W) whether a pixel is on the line, and the share of it that is."""
    there = (s_m >= marking.from_m) & (s_m < marking.to_m)
    if marking.dashes == "all":
        there &= s_m % DASH_PERIOD_M < DASH_M
    elif marking.dashes == "stretches":
        there &= ~line_gap(s_m.astype(np.float32), 0.0)
    inward = LINE_M / 2 - np.abs(ground.across_m - marking.middle_m.at(s_m))
    pixel_m = ground.depth_m / np.float32(focal_px)
    share = np.clip(inward / pixel_m + 0.5, 0, 1) * np.minimum(LINE_M / pixel_m, 1)
    return there & (inward >= 0), np.asarray(share * there, np.float32)
