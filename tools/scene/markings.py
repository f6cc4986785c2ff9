"""Painted lines whose place changes along the road, dashed, worn or missing for stretches.

The plain scenes have their lines in the cross-section; these are painted over a cross-section without lines.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .along import Along
from .options import Stretch
from .section import Colour

Dashes = Literal["none", "all", "stretches"]


@dataclass(frozen=True)
class Marking:
    """A line as wide as all are, about a middle that changes with s, between two places.

    ``dashes`` says where it is dashed: nowhere, all along, or for a part of each stretch as in the plain scenes.
    """

    middle_m: Along
    colour: Colour
    dashes: Dashes = "none"
    from_m: float = -np.inf
    to_m: float = np.inf


@dataclass(frozen=True)
class Markings:
    """All lines of a road, and the stretches where they are missing or worn down to remains."""

    lines: tuple[Marking, ...]
    missing: tuple[Stretch, ...] = ()
    worn: tuple[Stretch, ...] = ()
