"""CARLA's CityScapesPalette back to tags: the colours name the classes in every version."""

from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.datatypes import Image
from roadperc_stream.core.semantics import CARLA_FROM_0_9_14, TagTable
from roadperc_stream.errors import DecodeError

PALETTE_TABLE: Final = CARLA_FROM_0_9_14
"""Table of colours whose log names none: it has every class that earlier versions colour (their vehicle as car)."""
UNKNOWN: Final = 255
"""In ``tags_by_code``: a colour of no class."""


@cache
def tags_by_code(table: TagTable) -> Image:
    """(2^24,) uint8 tag of every colour, red * 65536 + green * 256 + blue."""
    tags = np.full(1 << 24, UNKNOWN, np.uint8)
    for (r, g, b), tag in table.tag_by_colour().items():
        tags[(r << 16) | (g << 8) | b] = tag
    return tags


def tags_of_colours(bgr: Image, table: TagTable) -> Image:
    """(H, W) uint8 tags of an (H, W, 3) image of class colours.

    Raises:
        DecodeError: a colour is no class's; the message names the most frequent such one.
    """
    import cv2

    codes = cv2.cvtColor(bgr, cv2.COLOR_BGR2BGRA).view("<u4")[..., 0] & 0xFFFFFF
    tags: Image = tags_by_code(table)[codes]
    if (tags == UNKNOWN).any():
        raise DecodeError(_unknown_in_words(codes[tags == UNKNOWN], table))
    return tags


def _unknown_in_words(codes: NDArray[Any], table: TagTable) -> str:
    distinct, counts = np.unique(codes, return_counts=True)
    code = int(distinct[counts.argmax()])
    colour = (code >> 16, code >> 8 & 255, code & 255)
    more = f" and {len(distinct) - 1} more colours" if len(distinct) > 1 else ""
    return f"colour {colour} ({counts.max()} pixels){more} is no class's of {table.name}: expected CARLA's palette"
