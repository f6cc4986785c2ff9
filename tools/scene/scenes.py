"""The four scenes: path, cross-section and terrain, and the intersection of rays with the ground.

The height of the ground is a polyline over world x.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import chain as joined
from itertools import repeat
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float, rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy

from .lanes import RoadSection
from .options import RenderOptions, SceneName
from .path import Element, Path, chain
from .roads import Crossing, Road, road_of

VIEW_M: Final = 1100.0
"""Length of rays: a little beyond CARLA's far plane."""

BUMP_M: Final = 3.7
BUMP_HEIGHT_M: Final = 0.1
BUMP_KNOT_M: Final = 0.1
BUMP_FIRST_M: Final = 22.0
BUMP_EVERY_M: Final = 30.0


@dataclass(frozen=True, eq=False)
class Terrain:
    """Ground whose height depends on world x only: planar between knots, level beyond the outer knots."""

    x_m: Float
    z_m: Float
    rough: bool = False
    """True if the ground changes within the length of a car."""

    @property
    def flat(self) -> bool:
        """Return True if the ground is one level plane."""
        return len(self.x_m) < 2

    @cached_property
    def steepest(self) -> float:
        """Return the largest dz/dx; a steeper ray never meets the ground."""
        return 0.0 if self.flat else float((np.diff(self.z_m) / np.diff(self.x_m)).max())

    def height(self, x_m: Float) -> Float:
        """Return the ground height at world x of any shape."""
        return np.interp(x_m, self.x_m, self.z_m)

    def below(self, x_m: float, reach_m: float) -> tuple[float, float]:
        """Return height and mean dz/dx of a body at x with wheels ``reach_m`` behind and in front of it.

        On smooth ground the height is the ground's height at x.
        """
        ends = self.height(np.array([x_m - reach_m, x_m + reach_m]))
        height = ends.mean() if self.rough else self.height(np.array([x_m]))[0]
        return float(height), float(ends[1] - ends[0]) / (2 * reach_m)

    def first_hits(self, centre_m: Float, dx: Float, dz: Float, lift_m: float) -> Float:
        """Return the ray lengths, in units of their directions, to the ground lifted by ``lift_m``; inf for no hit.

        All rays start at ``centre_m`` (3,), a world point above the ground. ``dx`` and ``dz`` are the world components
        of the directions; ``dx`` is positive unless the ground is flat.
        """
        if self.flat:
            with np.errstate(divide="ignore"):
                return np.where(dz < 0, (self.z_m[0] + lift_m - centre_m[2]) / dz, np.inf)
        # A ray meets the ground before the first knot whose slope, seen from the centre, is above the ray's slope.
        # Within a segment the slope is monotone, so knots are enough. The running maximum hides knots behind a crest.
        first = int(np.searchsorted(self.x_m, centre_m[0] + 0.1))
        last = int(np.searchsorted(self.x_m, centre_m[0] + VIEW_M))
        x, z = self.x_m[first - 1 : last], self.z_m[first - 1 : last] + lift_m
        view = np.maximum.accumulate((z[1:] - centre_m[2]) / (x[1:] - centre_m[0]))
        segment = np.searchsorted(view, dz / dx)
        slope = np.append(np.diff(z) / np.diff(x), 0.0)
        below = z + slope * (centre_m[0] - x) - centre_m[2]
        with np.errstate(divide="ignore", invalid="ignore"):
            hit = below[segment] / (dz - slope[segment] * dx)
        return np.where(segment < len(view), hit, np.inf)


LEVEL_GROUND: Final = Terrain(np.zeros(1), np.zeros(1))


def rolling_ground(length_m: float, wave_m: float, max_grade: float, knot_m: float = 2.0) -> Terrain:
    """Return waves from x = -200 on with a largest grade of ``max_grade``; the ground is level at x = 0."""
    x = np.arange(-200.0, length_m + wave_m, knot_m)
    return Terrain(x, max_grade * wave_m / (2 * np.pi) * (1 - np.cos(2 * np.pi * x / wave_m)))


def with_bumps(terrain: Terrain, length_m: float) -> Terrain:
    """Return the ground with round speed bumps like the Watts hump: 3.7 m long and 10 cm high."""
    middles = np.arange(BUMP_FIRST_M, length_m, BUMP_EVERY_M)
    u = np.linspace(-1, 1, round(BUMP_M / BUMP_KNOT_M) + 1)
    bumps_x = (middles[:, None] + BUMP_M / 2 * u).ravel()
    bumps_z = np.tile(BUMP_HEIGHT_M * (1 - u * u), len(middles))
    # Level ground has one knot; add a knot on each side.
    ends = (-200.0, length_m + 200.0)
    x = np.union1d(np.append(terrain.x_m, ends), bumps_x)
    return Terrain(x, terrain.height(x) + np.interp(x, bumps_x, bumps_z), rough=True)


RADIUS_M: Final = 150.0
MARGIN_M: Final = 1200.0
"""Length of the scene beyond the end of the scenario: more than the depth camera's range."""
WHEELBASE_M: Final = 2.8


@dataclass(frozen=True, eq=False)
class RenderedScene:
    """The road and the terrain of a scenario."""

    path: Path
    terrain: Terrain
    road: Road

    @property
    def ground_path(self) -> Path | Crossing:
        """Return the roads to render; ``path`` is the ego car's path on them."""
        return self.road.crossing or self.path

    @property
    def section(self) -> RoadSection:
        """Return the cross-section of the road."""
        return self.road.section

    def point(self, s_m: float, d_m: float) -> tuple[float, float, float]:
        """Return world x and y, and the road's heading, at (s, d)."""
        x, y = self.path.point(np.array([s_m]), d_m)
        return float(x[0]), float(y[0]), float(self.path.pose(np.array([s_m]))[2][0])

    def upright_pose(self, s_m: float, d_m: float, turn: float, step_m: float = 0.0) -> Float:
        """Return world_T_body of a body with a vertical axis at (s, d), ``step_m`` above the road."""
        x, y, heading = self.point(s_m, d_m)
        height = float(self.terrain.height(np.array([x]))[0]) + step_m
        return rigid(rotation_from_rpy(0.0, 0.0, heading + turn), np.array([x, y, height]))

    def ground_pose(self, s_m: float, d_m: float, turn: float = 0.0) -> Float:
        """Return world_T_body of a car at (s, d), turned by ``turn`` radians relative to the road.

        The x and y axes are in the plane of the wheels (one wheelbase apart); the origin is on the ground.
        """
        x, y, heading = self.point(s_m, d_m)
        height, slope = self.terrain.below(x, WHEELBASE_M / 2)
        yaw = heading + turn
        forward = np.array([np.cos(yaw), np.sin(yaw), slope * np.cos(yaw)])
        up = np.array([-slope, 0.0, 1.0])
        forward, up = forward / np.linalg.norm(forward), up / np.linalg.norm(up)
        return rigid(np.column_stack((forward, np.cross(up, forward), up)), np.array([x, y, height]))


def make_scene(options: RenderOptions, length_m: float) -> RenderedScene:
    """Return the scene for ``length_m`` of driving along the road from s = 0."""
    road = road_of(options)
    if road.crossing is not None:
        return RenderedScene(road.crossing.path, LEVEL_GROUND, road)
    wave_m = _WAVES_M.get(options.scene)
    terrain = rolling_ground(length_m + MARGIN_M, wave_m, _MAX_GRADE) if wave_m else LEVEL_GROUND
    if options.bumps:
        terrain = with_bumps(terrain, length_m + MARGIN_M)
    return RenderedScene(_path(options.scene, length_m), terrain, road)


def _path(name: SceneName, length_m: float) -> Path:
    """Return a straight line, a ring or, in town, bends of up to 30 degrees; a town's road never turns back."""
    start = Element(0.0, 0.0, 0.0, 0.0, 1 / RADIUS_M if name == "bend" else 0.0)
    if name != "town":
        return Path((start,))
    arc, line = RADIUS_M * np.radians(60), 25.0
    swing = [(arc, -1 / RADIUS_M), (line, 0.0), (arc, 1 / RADIUS_M), (line, 0.0)]
    pieces = [(45.0, 0.0), (arc / 2, 1 / RADIUS_M), (line, 0.0)]
    turns = int((length_m + MARGIN_M) / sum(length for length, _ in swing)) + 1
    return chain(start, joined(pieces, *repeat(swing, turns)))


_WAVES_M: Final = {"hill": 240.0, "town": 320.0}
_MAX_GRADE: Final = 0.08
