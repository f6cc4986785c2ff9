"""The four scenes: path, terrain and cross-section of each."""

from dataclasses import dataclass
from itertools import chain as joined
from itertools import repeat
from typing import Final

import numpy as np

from roadperc_stream.core.geometry import Float, rigid

from .crossing import Crossing
from .options import RenderOptions, SceneName
from .path import Element, Path, chain
from .roads import Road, road_of
from .section import RoadSection
from .terrain import Terrain, level_ground, rolling_ground, with_bumps

RADIUS_M: Final = 150.0
MARGIN_M: Final = 1200.0
"""How far the world reaches beyond the drive's end: farther than the depth camera sees."""
WHEELBASE_M: Final = 2.8


@dataclass(frozen=True, eq=False)
class World:
    """All that stands still and has no edges: the road and the ground."""

    name: SceneName
    path: Path
    terrain: Terrain
    road: Road

    @property
    def ground_path(self) -> Path | Crossing:
        """The roads that there are to see; the path is the ego car's way on them."""
        return self.road.crossing or self.path

    @property
    def section(self) -> RoadSection:
        """The road's cross-section."""
        return self.road.section

    def ground_pose(self, s_m: float, d_m: float, turn: float = 0.0) -> Float:
        """world_T_body of a body on its wheels at (s, d), turned by ``turn`` radians against the road.

        Its x and y axes lie in the plane of the wheels, which are a wheelbase apart; its origin touches the ground.
        """
        x, y, heading = (float(v[0]) for v in self.path.pose(np.array([s_m])))
        x, y = x - d_m * np.sin(heading), y + d_m * np.cos(heading)
        slope = 0.0 if self.terrain.flat else self.terrain.slope(x, WHEELBASE_M / 2)
        yaw = heading + turn
        forward = np.array([np.cos(yaw), np.sin(yaw), slope * np.cos(yaw)])
        up = np.array([-slope, 0.0, 1.0])
        forward, up = forward / np.linalg.norm(forward), up / np.linalg.norm(up)
        rotation = np.column_stack((forward, np.cross(up, forward), up))
        return rigid(rotation, np.array([x, y, self.terrain.carried_height(x, WHEELBASE_M / 2)]))


def make_world(options: RenderOptions, length_m: float) -> World:
    """The world for a drive of ``length_m`` along the road, which starts at s = 0."""
    name = options.scene
    wave_m = _WAVES_M.get(name)
    terrain = rolling_ground(length_m + MARGIN_M, wave_m, _MAX_GRADE) if wave_m else level_ground()
    road = road_of(options)
    if road.crossing is not None:
        return World(name, road.crossing.path, level_ground(), road)
    if options.bumps:
        terrain = with_bumps(terrain, length_m + MARGIN_M)
    return World(name, _PATHS[name](length_m), terrain, road)


def _straight(length_m: float) -> Path:
    del length_m
    return Path((Element(0.0, 0.0, 0.0, 0.0, 0.0),))


def _ring(length_m: float) -> Path:
    del length_m
    return Path((Element(0.0, 0.0, 0.0, 0.0, 1 / RADIUS_M),))


def _winding(length_m: float) -> Path:
    """Bends of 30 degrees to either side, so that the road always runs towards positive x."""
    arc, line = RADIUS_M * np.radians(60), 25.0
    swing = [(arc, -1 / RADIUS_M), (line, 0.0), (arc, 1 / RADIUS_M), (line, 0.0)]
    pieces = [(45.0, 0.0), (arc / 2, 1 / RADIUS_M), (line, 0.0)]
    turns = int((length_m + MARGIN_M) / sum(length for length, _ in swing)) + 1
    return chain(Element(0.0, 0.0, 0.0, 0.0, 0.0), joined(pieces, *repeat(swing, turns)))


_PATHS: Final = {"straight": _straight, "bend": _ring, "hill": _straight, "town": _winding}
_WAVES_M: Final = {"hill": 240.0, "town": 320.0}
_MAX_GRADE: Final = 0.08
