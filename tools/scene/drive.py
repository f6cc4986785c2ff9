"""A drive frame by frame: where the car and its cameras are, and what there is to see.

Houses, lamp posts, trees and parked cars stand slot by slot along s. Every slot is drawn from (seed, slot) alone, so a
drive can be as long as one likes and each place looks the same whenever one comes by.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float

from .ego import Ego, LaneChangeState, lane_changes, shake_of
from .faces import Faces, Thing, building, car, lamp_post, together, tree
from .options import RenderOptions
from .scenario import pair_of
from .shade import Shadow
from .sheet import CAR_M, CAR_WIDTH_M
from .traffic import Traffic
from .view import Scenery
from .world import World

HOUSE_SLOT_M: Final = 16.0
POST_SLOT_M: Final = 34.0
TREE_SLOT_M: Final = 23.0
PARKING_SLOT_M: Final = 7.5
ROW_SLOT_M: Final = 5.4
"""The same where they stand in rows without gaps."""
ROW_SWAY_M: Final = 0.3
PARKED_M: Final = 1.2
"""Distance of a parked car's middle from the curb."""


@dataclass(frozen=True, eq=False)
class Fixtures:
    """The fixtures of a world."""

    world: World
    seed: int
    parked_rows: bool = False
    """Whether cars are parked without gaps."""

    def near(self, s_m: float) -> list[Thing]:
        """Everything that may be seen from s, in a fixed order."""
        kinds = (
            (self._house, HOUSE_SLOT_M, -25.0, 230.0),
            (self._post, POST_SLOT_M, -5.0, 130.0),
            (self._tree, TREE_SLOT_M, -8.0, 120.0),
            (self._parked, ROW_SLOT_M if self.parked_rows else PARKING_SLOT_M, -6.0, 100.0),
        )
        return [
            fixture
            for place, slot_m, behind_m, ahead_m in kinds
            for slot in range(floor((s_m + behind_m) / slot_m), ceil((s_m + ahead_m) / slot_m))
            for side in (1, -1)
            if (fixture := place(slot, side)) is not None and self._is_free(fixture, place == self._house)
        ]

    def _is_free(self, fixture: Thing, is_house: bool) -> bool:
        """Whether no other road runs where the fixture stands."""
        crossing = self.world.road.crossing
        if crossing is None:
            return True
        x, y = fixture.pose(0.0)[:2, 3]
        distances = np.abs(crossing.arm_distances(np.array([x]), np.array([y])))
        own = self.world.section.walk_m if is_house else self.world.section.curb_m - 2 * PARKED_M
        other = own + HOUSE_SLOT_M if is_house else crossing.curb_m + crossing.corner_m
        return bool(distances.min() > own - 0.5 and distances.max() > other)

    def _rng(self, slot: int, side: int, kind: int) -> np.random.Generator:
        return np.random.default_rng((self.seed, 101, kind, side + 1, slot + 1_000_000))

    @lru_cache(maxsize=256)  # noqa: B019 - a layout lives as long as its run
    def _house(self, slot: int, side: int) -> Thing | None:
        rng = self._rng(slot, side, 0)
        length, depth, floors = rng.uniform(11.5, 15.5), rng.uniform(8.0, 12.0), int(rng.integers(1, 4))
        b, g, r = (float(c) for c in rng.uniform(0.82, 1.08) * rng.uniform(0.94, 1.06, 3))
        if rng.random() < 0.12:
            return None
        faces = building(int(rng.integers(100)), length, depth, 3.2 * floors + 0.5, (b, g, r))
        setback = self.world.section.walk_m + rng.uniform(0.2, 2.0)
        turn = np.pi if side > 0 else 0.0
        s = (slot + 0.5) * HOUSE_SLOT_M
        pose = self.world.upright_pose(s, self.world.road.aside(side, s, setback), turn)
        return _standing(f"house{side}:{slot}", "", faces, pose)

    @lru_cache(maxsize=256)  # noqa: B019
    def _post(self, slot: int, side: int) -> Thing:
        s = (slot + (0.3 if side > 0 else 0.75)) * POST_SLOT_M
        d = self.world.road.aside(side, s, self.world.section.curb_m + 0.5)
        return _standing(f"post{side}:{slot}", "", lamp_post(-side), self.world.upright_pose(s, d, 0.0))

    @lru_cache(maxsize=256)  # noqa: B019
    def _tree(self, slot: int, side: int) -> Thing | None:
        rng = self._rng(slot, side, 1)
        s, d = (slot + rng.uniform(0.2, 0.8)) * TREE_SLOT_M, self.world.section.walk_m - rng.uniform(0.3, 0.8)
        if rng.random() < 0.45:
            return None
        d = self.world.road.aside(side, s, d)
        return _standing(f"tree{side}:{slot}", "", tree(), self.world.upright_pose(s, d, float(rng.uniform(0, 6))))

    @lru_cache(maxsize=256)  # noqa: B019
    def _parked(self, slot: int, side: int) -> Thing | None:
        rng = self._rng(slot, side, 2)
        slot_m, sway_m = (ROW_SLOT_M, ROW_SWAY_M) if self.parked_rows else (PARKING_SLOT_M, 0.8)
        s = (slot + 0.5) * slot_m + rng.uniform(-sway_m, sway_m)
        d = self.world.road.aside(side, s, self.world.section.curb_m - PARKED_M - rng.uniform(-0.1, 0.1))
        taken = self.world.section.outside_right == "road" and (rng.random() < 0.42 or self.parked_rows)
        if not taken:
            return None
        turn = (np.pi if side > 0 else 0.0) + rng.uniform(-0.03, 0.03)
        pose = self.world.ground_pose(s, d, turn)
        return _standing(f"parked{side}:{slot}", "Car", car(int(rng.integers(100))), pose)


def _standing(name: str, label: str, faces: Faces, world_T_body: Float) -> Thing:
    return Thing(name, label, faces.moved(world_T_body), lambda _: world_T_body)


@dataclass(frozen=True)
class SceneMoment:
    """Everything at one time; ``things[i]`` has the number i + 1 in the views."""

    time_s: float
    world_T_ego: Float
    scenery: Scenery
    things: tuple[Thing, ...]
    d_m: float
    """How far the ego car is to the left of the road's middle."""
    lane_change: LaneChangeState


@dataclass(frozen=True)
class Drive:
    """A drive through a world."""

    ego: Ego
    layout: Fixtures
    traffic: Traffic
    seed: int
    camera_height_m: float

    @classmethod
    def of(cls, world: World, options: RenderOptions) -> "Drive":
        """The drive that the options ask for; its things are drawn from the seed."""
        changes = lane_changes(options, world.road.lanes)
        pair, shake = pair_of(options), shake_of(options.pitch_std_deg, options.seed)
        ego = Ego(world, options.speed_mps, options.weave_m, options.static, changes, pair.ego, shake)
        traffic = Traffic(ego, options.seed, pair.leader, crossing_cars=options.crossing_cars)
        return cls(ego, Fixtures(world, options.seed, options.parked_rows), traffic, options.seed, options.mount[2])

    def at(self, time_s: float) -> SceneMoment:
        """The moment at a time since the start."""
        world, s = self.ego.world, self.ego.s(time_s)
        fixtures = self.layout.near(s)
        things = (*(thing for thing in fixtures if thing.label), *self.traffic.at(time_s))
        groups = [thing.faces for thing in fixtures if not thing.label]
        groups += [thing.faces.owned_by(i + 1) for i, thing in enumerate(things)]
        shadows = tuple(
            Shadow(thing.pose(time_s), CAR_M[0] / 2, CAR_WIDTH_M / 2) for thing in things if thing.label == "Car"
        )
        scenery = Scenery(world, s, together(groups), shadows, self.camera_height_m, self.seed)
        change = self.ego.lane_change(time_s, CAR_WIDTH_M / 2)
        return SceneMoment(time_s, self.ego.pose(time_s), scenery, things, self.ego.d(time_s), change)
