"""Colours of the results in viewers, pictures and videos. Red, green, blue, 0 to 255."""

from collections.abc import Mapping
from typing import Final

from roadperc_stream.model.tag_tables import Colour

GREEN: Final[Colour] = (26, 230, 77)
YELLOW: Final[Colour] = (255, 230, 26)
ORANGE: Final[Colour] = (255, 128, 0)
CYAN: Final[Colour] = (26, 204, 255)
GREY: Final[Colour] = (165, 165, 165)

BOUNDARY: Final[Mapping[str, Colour]] = {"measured": GREEN, "held": ORANGE, "lost": GREY}
"""By the boundary's status."""
RAW_LINE: Final = YELLOW
PROPOSED_LINE: Final = CYAN
OBJECT: Final[Mapping[str, Colour]] = {"kept": GREEN, "unverified": YELLOW, "dropped": GREY}
DRIVABLE: Final[Colour] = (30, 130, 220)
"""Blue, because green lanes and boxes are drawn over it."""


def bgr(colour: Colour) -> Colour:
    """The colour in the order of OpenCV's images."""
    red, green, blue = colour
    return blue, green, red
