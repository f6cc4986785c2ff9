"""Painted lines whose place changes along the road, dashed, worn or missing for stretches.

The plain scenes have their lines in the cross-section; these are painted over a cross-section without lines.
"""

from dataclasses import dataclass

import numpy as np

from .along import Along
from .section import Colour

Stretch = tuple[float, float]
"""From and to, metres along the road."""


@dataclass(frozen=True)
class Marking:
    """A line as wide as all are, about a middle that changes with s, between two places."""

    middle_m: Along
    colour: Colour
    dashed: bool = False
    from_m: float = -np.inf
    to_m: float = np.inf


@dataclass(frozen=True)
class Markings:
    """All lines of a road, and the stretches where they are missing."""

    lines: tuple[Marking, ...]
    missing: tuple[Stretch, ...] = ()
