"""A quantity that changes along the road."""

from dataclasses import dataclass

import numpy as np

from roadperc_stream.core.geometry import Float

from .path import Real


@dataclass(frozen=True)
class Along:
    """A quantity over s: straight between knots, constant beyond the outer ones."""

    s_m: tuple[float, ...]
    value: tuple[float, ...]

    @property
    def constant(self) -> bool:
        """Whether it is the same everywhere."""
        return len(set(self.value)) == 1

    def at(self, s_m: Real | float) -> Float:
        """The quantity at s of any shape."""
        return np.asarray(np.interp(s_m, self.s_m, self.value))


def constant(value: float) -> Along:
    """The same everywhere."""
    return Along((0.0,), (value,))
