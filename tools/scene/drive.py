"""A drive frame by frame: where the car and its cameras are, and what there is to see."""

from collections.abc import Callable
from dataclasses import dataclass

from roadperc_stream.geometry import Float

from .ego import Ego, LaneChangeState, lane_changes, shake_of
from .faces import Faces, together
from .layout import Fixtures
from .options import RenderOptions
from .scenario import pair_of
from .shade import Shadow
from .sheet import CAR_M, CAR_WIDTH_M
from .traffic import Traffic
from .view import Scenery
from .world import World


@dataclass(frozen=True)
class Thing:
    """A car or a person: its faces in the world at one moment and its pose (world_T_body) at any time."""

    name: str
    label: str
    faces: Faces
    pose: Callable[[float], Float]


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
        parked = [Thing(f.name, f.label, f.faces, _standing(f.world_T_body)) for f in fixtures if f.label]
        moving = [Thing(m.name, m.label, m.faces.moved(m.pose(time_s)), m.pose) for m in self.traffic.at(time_s)]
        things = (*parked, *moving)
        groups = [f.faces for f in fixtures if not f.label]
        groups += [thing.faces.owned_by(i + 1) for i, thing in enumerate(things)]
        shadows = tuple(
            Shadow(thing.pose(time_s), CAR_M[0] / 2, CAR_WIDTH_M / 2) for thing in things if thing.label == "Car"
        )
        scenery = Scenery(world, s, together(groups), shadows, self.camera_height_m, self.seed)
        change = self.ego.lane_change(time_s, CAR_WIDTH_M / 2)
        return SceneMoment(time_s, self.ego.pose(time_s), scenery, things, self.ego.d(time_s), change)


def _standing(world_T_body: Float) -> Callable[[float], Float]:
    return lambda _: world_T_body
