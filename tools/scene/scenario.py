"""A scenario frame by frame: the pose of the car and everything visible to the cameras.

Houses, lamp posts, trees and parked cars stand in slots along s. The content of a slot depends only on (seed, slot),
so a scenario can have any length, and a place always looks the same.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float

from .atlas import CAR_M, CAR_WIDTH_M
from .ego import Ego, lane_changes, pitching
from .faces import Body, Faces, building, car, lamp_post, together, tree
from .motions import motions_of
from .options import RenderOptions
from .scenes import RenderedScene
from .shading import Shadow
from .traffic import Traffic
from .view import Snapshot

HOUSE_SLOT_M: Final = 16.0
POST_SLOT_M: Final = 34.0
TREE_SLOT_M: Final = 23.0
PARKING_SLOT_M: Final = 7.5
ROW_SLOT_M: Final = 5.4
"""Length of a parking slot in rows without gaps."""
ROW_SWAY_M: Final = 0.3
PARKED_M: Final = 1.2
"""Distance from the centre of a parked car to the curb."""


@dataclass(frozen=True, eq=False)
class Fixtures:
    """Houses, lamp posts, trees and parked cars along the road of a scene."""

    scene: RenderedScene
    seed: int
    parked_rows: bool = False
    """True if cars are parked without gaps."""

    def near(self, s_m: float) -> list[Body]:
        """Return all fixtures that can be visible from s, in a fixed order."""
        kinds = (
            (self._house, HOUSE_SLOT_M, -25.0, 230.0),
            (self._post, POST_SLOT_M, -5.0, 130.0),
            (self._tree, TREE_SLOT_M, -8.0, 120.0),
            (self._parked, ROW_SLOT_M if self.parked_rows else PARKING_SLOT_M, -6.0, 100.0),
        )
        return [
            fixture
            for in_slot, slot_m, behind_m, ahead_m in kinds
            for slot in range(floor((s_m + behind_m) / slot_m), ceil((s_m + ahead_m) / slot_m))
            for side in (1, -1)
            if (fixture := in_slot(slot, side)) is not None and self._is_free(fixture, in_slot == self._house)
        ]

    def _is_free(self, fixture: Body, is_house: bool) -> bool:
        """Return True if the fixture does not stand on another road."""
        crossing = self.scene.road.crossing
        if crossing is None:
            return True
        x, y = fixture.pose(0.0)[:2, 3]
        distances = np.abs(crossing.arm_distances(np.array([x]), np.array([y])))
        own = self.scene.section.walk_m if is_house else self.scene.section.curb_m - 2 * PARKED_M
        other = own + HOUSE_SLOT_M if is_house else crossing.curb_m + crossing.corner_m
        return bool(distances.min() > own - 0.5 and distances.max() > other)

    def _rng(self, slot: int, side: int, kind: int) -> np.random.Generator:
        return np.random.default_rng((self.seed, 101, kind, side + 1, slot + 1_000_000))

    @lru_cache(maxsize=256)  # noqa: B019 - a render holds one layout until it ends
    def _house(self, slot: int, side: int) -> Body | None:
        rng = self._rng(slot, side, 0)
        length, depth, floors = rng.uniform(11.5, 15.5), rng.uniform(8.0, 12.0), int(rng.integers(1, 4))
        b, g, r = (float(c) for c in rng.uniform(0.82, 1.08) * rng.uniform(0.94, 1.06, 3))
        if rng.random() < 0.12:
            return None
        faces = building(int(rng.integers(100)), length, depth, 3.2 * floors + 0.5, (b, g, r))
        setback = self.scene.section.walk_m + rng.uniform(0.2, 2.0)
        turn = np.pi if side > 0 else 0.0
        s = (slot + 0.5) * HOUSE_SLOT_M
        pose = self.scene.upright_pose(s, self.scene.road.aside(side, s, setback), turn)
        return _standing(f"house{side}:{slot}", "", faces, pose)

    @lru_cache(maxsize=256)  # noqa: B019
    def _post(self, slot: int, side: int) -> Body:
        s = (slot + (0.3 if side > 0 else 0.75)) * POST_SLOT_M
        d = self.scene.road.aside(side, s, self.scene.section.curb_m + 0.5)
        return _standing(f"post{side}:{slot}", "", lamp_post(-side), self.scene.upright_pose(s, d, 0.0))

    @lru_cache(maxsize=256)  # noqa: B019
    def _tree(self, slot: int, side: int) -> Body | None:
        rng = self._rng(slot, side, 1)
        s, d = (slot + rng.uniform(0.2, 0.8)) * TREE_SLOT_M, self.scene.section.walk_m - rng.uniform(0.3, 0.8)
        if rng.random() < 0.45:
            return None
        d = self.scene.road.aside(side, s, d)
        return _standing(f"tree{side}:{slot}", "", tree(), self.scene.upright_pose(s, d, float(rng.uniform(0, 6))))

    @lru_cache(maxsize=256)  # noqa: B019
    def _parked(self, slot: int, side: int) -> Body | None:
        rng = self._rng(slot, side, 2)
        slot_m, sway_m = (ROW_SLOT_M, ROW_SWAY_M) if self.parked_rows else (PARKING_SLOT_M, 0.8)
        s = (slot + 0.5) * slot_m + rng.uniform(-sway_m, sway_m)
        d = self.scene.road.aside(side, s, self.scene.section.curb_m - PARKED_M - rng.uniform(-0.1, 0.1))
        taken = self.scene.section.outside_right == "road" and (rng.random() < 0.42 or self.parked_rows)
        if not taken:
            return None
        turn = (np.pi if side > 0 else 0.0) + rng.uniform(-0.03, 0.03)
        pose = self.scene.ground_pose(s, d, turn)
        return _standing(f"parked{side}:{slot}", "Car", car(int(rng.integers(100))), pose)


def _standing(name: str, label: str, faces: Faces, world_T_body: Float) -> Body:
    return Body(name, label, faces.moved(world_T_body), lambda _: world_T_body)


@dataclass(frozen=True)
class Scenario:
    """The moving and parked bodies of a scene, and the ego car's motion."""

    ego: Ego
    layout: Fixtures
    traffic: Traffic
    camera_height_m: float

    @classmethod
    def of(cls, scene: RenderedScene, options: RenderOptions) -> "Scenario":
        """Return the scenario of the options; the seed decides which bodies it contains."""
        changes = lane_changes(options, scene.road.lanes)
        motion, leader = motions_of(options)
        shake = pitching(options.pitch_std_deg, options.seed) if options.pitch_std_deg else None
        ego = Ego(scene, options.speed_mps, options.weave_m, options.static, changes, motion, shake)
        traffic = Traffic(ego, options.seed, leader, crossing_cars=options.crossing_cars)
        return cls(ego, Fixtures(scene, options.seed, options.parked_rows), traffic, options.mount[2])

    def at(self, time_s: float) -> Snapshot:
        """Return the scene at a time since the start, in seconds."""
        scene, s = self.ego.scene, self.ego.s(time_s)
        fixtures = self.layout.near(s)
        bodies = (*(body for body in fixtures if body.label), *self.traffic.at(time_s))
        groups = [body.faces for body in fixtures if not body.label]
        groups += [body.faces.owned_by(i + 1) for i, body in enumerate(bodies)]
        shadows = tuple(
            Shadow(body.pose(time_s), CAR_M[0] / 2, CAR_WIDTH_M / 2) for body in bodies if body.label == "Car"
        )
        return Snapshot(
            time_s=time_s,
            scene=scene,
            s_m=s,
            d_m=self.ego.d(time_s),
            world_T_ego=self.ego.pose(time_s),
            bodies=bodies,
            faces=together(groups),
            shadows=shadows,
            lane_change=self.ego.lane_change(time_s, CAR_WIDTH_M / 2),
            camera_height_m=self.camera_height_m,
            seed=self.layout.seed,
        )
