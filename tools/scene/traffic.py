"""Moving bodies: cars ahead, oncoming and crossing cars, people on the sidewalks and on the road."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from roadperc_stream.geometry import Float, rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy

from .ego import Ego
from .faces import Body, car, pedestrian
from .lanes import CURB_HEIGHT_M
from .motions import SpeedProfile
from .scenes import RenderedScene

HEADWAY_S: Final = 2.8
HEADWAY_MIN_M: Final = 14.0
ONCOMING_SPEED_MPS: Final = 9.0
ONCOMING_SPACING_M: Final = 42.0
ACROSS_MPS: Final = 8.0
CROSSES_BEFORE_S: Final = ((1.6, 1), (2.6, -1), (4.5, 1))
"""Times before the ego car's arrival at which cars cross its road, and their direction: 1 left, -1 right."""
CLEAR_S: Final = 2.0
LATEST_S: Final = 120.0
CAR_RANGE_M: Final = 140.0
WALKER_SLOT_M: Final = 19.0
WALKER_RANGE_M: Final = 90.0
WALK_MPS: Final = 1.2
WALK_TURN_S: Final = 14.0
CROSSING_SLOT_M: Final = 95.0
RUN_MPS: Final = 2.6
STRIDE_M: Final = 0.22


@dataclass(frozen=True)
class Traffic:
    """All moving bodies of a scenario."""

    ego: Ego
    seed: int
    leader: SpeedProfile | None = None
    """Motion of the car ahead, None for default driving."""
    crossing_cars: bool = False

    @property
    def scene(self) -> RenderedScene:
        """Return the scene of the traffic."""
        return self.ego.scene

    def at(self, time_s: float) -> list[Body]:
        """Return the bodies that can be visible at a time, in a fixed order."""
        motion = self.leader
        leaders = self._leaders() if motion is None else (self._leader(0, lambda time_s: motion.at(time_s)[0]),)
        # People run across the road only if the ego car has constant speed; otherwise it could hit them.
        crossing = self._crossing(time_s) if self.ego.motion is None else ()
        across = self._across() if self.crossing_cars else ()
        movers = (*leaders, *self._oncoming(time_s), *across, *self._walkers(time_s), *crossing)
        return [replace(body, faces=body.faces.moved(body.pose(time_s))) for body in movers]

    def _rng(self, kind: int, slot: int) -> np.random.Generator:
        return np.random.default_rng((self.seed, 202, kind, slot + 1_000_000))

    def _leaders(self) -> Iterator[Body]:
        """Yield two cars in the ego lane; they drive away from a static ego car."""
        headway = max(HEADWAY_MIN_M, HEADWAY_S * self.ego.speed_mps)
        for i, (gap, swing, period) in enumerate(((headway, 0.18, 11.0), (headway + 34.0, 0.1, 17.0))):

            def s_at(time_s: float, gap: float = gap, swing: float = swing, period: float = period) -> float:
                ahead = gap * (1 + swing * np.sin(2 * np.pi * time_s / period))
                if self.ego.static:
                    ahead = gap + self.ego.speed_mps * time_s
                return self.ego.s(time_s) + float(ahead)

            yield self._leader(i, s_at)

    def _leader(self, number: int, s_at: Callable[[float], float]) -> Body:
        """Return a car in the ego lane; ``s_at`` gives its s by time."""

        def pose(time_s: float) -> Float:
            s = s_at(time_s)
            return self.scene.ground_pose(s, self.scene.road.lanes.start.way_m(s))

        return Body(f"leader:{number}", "Car", car(int(self._rng(0, number).integers(100))), pose)

    def _oncoming(self, time_s: float) -> Iterator[Body]:
        """Yield oncoming cars, numbered by their position at time 0."""
        start = self.ego.s(time_s) + ONCOMING_SPEED_MPS * time_s
        for k in range(int((start - 8) // ONCOMING_SPACING_M), int((start + CAR_RANGE_M) // ONCOMING_SPACING_M)):
            rng = self._rng(1, k)
            first = (k + 0.5 + rng.uniform(-0.3, 0.3)) * ONCOMING_SPACING_M
            d = -self.scene.section.lane_centre_m + rng.uniform(-0.15, 0.15)
            if self._meets_crossing_car(first):
                continue

            def pose(time_s: float, first: float = first, d: float = d) -> Float:
                return self.scene.ground_pose(first - ONCOMING_SPEED_MPS * time_s, d, np.pi)

            yield Body(f"oncoming:{k}", "Car", car(int(rng.integers(100))), pose)

    def _meets_crossing_car(self, first_m: float) -> bool:
        """Return True if an oncoming car that starts at ``first_m`` would hit a crossing car."""
        crossing = self.scene.road.crossing
        if crossing is None or not self.crossing_cars:
            return False
        passes_s = (first_m - crossing.x_m) / ONCOMING_SPEED_MPS
        return any(abs(passes_s - time_s) < CLEAR_S for time_s, _ in self._crossing_times)

    @cached_property
    def _crossing_times(self) -> tuple[tuple[float, int], ...]:
        """Return the times at which cars cross the ego car's road, and their direction: 1 left, -1 right."""
        crossing = self.scene.road.crossing
        if crossing is None:
            return ()
        times = np.arange(0.0, LATEST_S, 0.05)
        target = crossing.begins_m if crossing.turn else crossing.x_m
        reached = np.array([self.ego.s(float(t)) >= target for t in times])
        arrives = float(times[int(reached.argmax())]) if reached.any() else LATEST_S
        return tuple((arrives - before, towards) for before, towards in CROSSES_BEFORE_S)

    def _across(self) -> Iterator[Body]:
        """Yield cars on the other road that cross shortly before the ego car arrives."""
        crossing = self.scene.road.crossing
        for k, (crosses_s, towards) in enumerate(self._crossing_times if crossing else ()):
            x = crossing.x_m - towards * self.scene.section.lane_centre_m if crossing else 0.0

            def pose(time_s: float, x: float = x, crosses_s: float = crosses_s, towards: int = towards) -> Float:
                y = towards * ACROSS_MPS * (time_s - crosses_s)
                return rigid(rotation_from_rpy(0.0, 0.0, towards * np.pi / 2), np.array([x, y, 0.0]))

            yield Body(f"across:{k}", "Car", car(int(self._rng(4, k).integers(100))), pose)

    def _walkers(self, time_s: float) -> Iterator[Body]:
        """Yield people who walk back and forth on the sidewalks."""
        s = self.ego.s(time_s)
        for k in range(int((s - 10) // WALKER_SLOT_M), int((s + WALKER_RANGE_M) // WALKER_SLOT_M)):
            rng = self._rng(2, k)
            side = 1 if rng.random() < 0.5 else -1
            middle, late = (k + rng.random()) * WALKER_SLOT_M, rng.uniform(0, WALK_TURN_S)
            d = self.scene.road.aside(side, middle, self.scene.section.curb_m + rng.uniform(0.9, 2.3))

            def pose(time_s: float, middle: float = middle, late: float = late, d: float = d) -> Float:
                along, turn = _back_and_forth(time_s + late)
                return self._on_foot(middle + along, d, turn)

            if rng.random() < 0.7:
                yield self._person(f"walker:{k}", int(rng.integers(100)), time_s + late, WALK_MPS, pose)

    def _crossing(self, time_s: float) -> Iterator[Body]:
        """Yield people who run across the road from the right, between the ego car and the car ahead."""
        s, speed = self.ego.s(time_s), max(self.ego.speed_mps, 1.0)
        left = self.scene.section.curb_m + 1.0
        for k in range(int((s - 5) // CROSSING_SLOT_M), int((s + WALKER_RANGE_M) // CROSSING_SLOT_M) + 1):
            runs_m = (k + 0.4) * CROSSING_SLOT_M
            right = -self.scene.road.aside(-1, runs_m, left)
            start = runs_m / speed - 0.5 - right / RUN_MPS if not self.ego.static else 1.5 + 3 * k

            def pose(time_s: float, runs_m: float = runs_m, start: float = start, right: float = right) -> Float:
                d = float(np.clip(RUN_MPS * (time_s - start) - right, -right, left))
                return self._on_foot(runs_m, d, np.pi / 2)

            moving = 0 < time_s - start < (left + right) / RUN_MPS
            yield self._person(f"crossing:{k}", 3 * k + 1, time_s if moving else 0.0, RUN_MPS, pose)

    def _person(self, name: str, clothes: int, walked_s: float, speed: float, pose: Callable[[float], Float]) -> Body:
        stride = STRIDE_M * float(np.sin(np.pi * speed * walked_s / 0.75))
        return Body(name, "Pedestrian", pedestrian(clothes, stride), pose)

    def _on_foot(self, s_m: float, d_m: float, turn: float) -> Float:
        """Return the pose of a person on the road or, beyond the curb, on the sidewalk."""
        beyond = abs(float(self.scene.road.section_d(np.array([s_m]), np.array([d_m]))[0])) > self.scene.section.curb_m
        return self.scene.upright_pose(s_m, d_m, turn, CURB_HEIGHT_M if beyond else 0.0)


def _back_and_forth(time_s: float) -> tuple[float, float]:
    """Return offset along the road in metres, and heading, of a person who walks back and forth."""
    phase = time_s % (2 * WALK_TURN_S)
    if phase < WALK_TURN_S:
        return WALK_MPS * (phase - WALK_TURN_S / 2), 0.0
    return WALK_MPS * (1.5 * WALK_TURN_S - phase), np.pi
