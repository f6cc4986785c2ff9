"""The height of the ground, a polyline over world x, and where rays first meet it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from roadperc_stream.core.geometry import Float

VIEW_M: Final = 1100.0
"""How far rays are followed: somewhat beyond CARLA's far plane."""

BUMP_M: Final = 3.7
BUMP_HEIGHT_M: Final = 0.1
BUMP_KNOT_M: Final = 0.1
BUMP_FIRST_M: Final = 22.0
BUMP_EVERY_M: Final = 30.0


@dataclass(frozen=True, eq=False)
class Terrain:
    """Ground that rises and falls along world x alone: planar strips between knots, level beyond the last ones."""

    x_m: Float
    z_m: Float
    rough: bool = False
    """Whether there is anything as short as a car."""

    @property
    def flat(self) -> bool:
        """Whether one plane is all there is."""
        return len(self.x_m) < 2

    @cached_property
    def steepest(self) -> float:
        """The largest dz/dx; a ray that climbs more never meets the ground."""
        return 0.0 if self.flat else float((np.diff(self.z_m) / np.diff(self.x_m)).max())

    def height(self, x_m: Float) -> Float:
        """Ground height at world x, any shape."""
        return np.interp(x_m, self.x_m, self.z_m)

    def slope(self, x_m: float, reach_m: float) -> float:
        """Mean dz/dx between ``reach_m`` behind and before x."""
        low, high = self.height(np.array([x_m - reach_m, x_m + reach_m]))
        return float(high - low) / (2 * reach_m)

    def carried_height(self, x_m: float, reach_m: float) -> float:
        """Height of a body at x on wheels ``reach_m`` behind and before it; on smooth ground that of the ground."""
        if self.rough:
            return float(self.height(np.array([x_m - reach_m, x_m + reach_m])).mean())
        return float(self.height(np.array([x_m]))[0])

    def first_hits(self, centre_m: Float, dx: Float, dz: Float, lift_m: float) -> Float:
        """How many times their direction rays travel until they meet the ground lifted by ``lift_m``; inf for never.

        Args:
            centre_m: (3,) world point above the ground where all rays start.
            dx: (...) world x component of the directions; positive where the ground is not flat.
            dz: (...) world z component.
            lift_m: height of the layer over the ground.
        """
        if self.flat:
            with np.errstate(divide="ignore"):
                return np.where(dz < 0, (self.z_m[0] + lift_m - centre_m[2]) / dz, np.inf)
        return self._first_strip_hits(centre_m, dx, dz, lift_m)

    def _first_strip_hits(self, centre_m: Float, dx: Float, dz: Float, lift_m: float) -> Float:
        """Seen from the centre, a ray meets the ground at the first knot that stands as high in view as the ray.

        The view angle of a straight strip is monotone, so its knots decide; the running maximum hides what lies behind
        a crest.
        """
        first = int(np.searchsorted(self.x_m, centre_m[0] + 0.1))
        last = int(np.searchsorted(self.x_m, centre_m[0] + VIEW_M))
        x, z = self.x_m[first - 1 : last], self.z_m[first - 1 : last] + lift_m
        view = np.maximum.accumulate((z[1:] - centre_m[2]) / (x[1:] - centre_m[0]))
        strip = np.searchsorted(view, dz / dx)
        slope = np.append(np.diff(z) / np.diff(x), 0.0)
        below = z + slope * (centre_m[0] - x) - centre_m[2]
        with np.errstate(divide="ignore", invalid="ignore"):
            hit = below[strip] / (dz - slope[strip] * dx)
        return np.where(strip < len(view), hit, np.inf)


def level_ground() -> Terrain:
    """Flat ground at height 0."""
    return Terrain(np.zeros(1), np.zeros(1))


def rolling_ground(length_m: float, wave_m: float, max_grade: float, knot_m: float = 2.0) -> Terrain:
    """Waves from x = -200 on whose steepest grade is ``max_grade``; level ground at x = 0."""
    x = np.arange(-200.0, length_m + wave_m, knot_m)
    z = max_grade * wave_m / (2 * np.pi) * (1 - np.cos(2 * np.pi * x / wave_m))
    return Terrain(x, z)


def with_bumps(terrain: Terrain, length_m: float) -> Terrain:
    """The same ground with speed bumps across it, round ones as Watts' hump is: 3.7 m long and 10 cm high."""
    middles = np.arange(BUMP_FIRST_M, length_m, BUMP_EVERY_M)
    u = np.linspace(-1, 1, round(BUMP_M / BUMP_KNOT_M) + 1)
    bumps_x = (middles[:, None] + BUMP_M / 2 * u).ravel()
    bumps_z = np.tile(BUMP_HEIGHT_M * (1 - u * u), len(middles))
    # Level ground has one knot; it needs an end on either side.
    ends = (-200.0, length_m + 200.0)
    x = np.union1d(np.append(terrain.x_m, ends), bumps_x)
    return Terrain(x, terrain.height(x) + np.interp(x, bumps_x, bumps_z), rough=True)
