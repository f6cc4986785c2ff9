"""The car's path, objects in it, cut-in and time to impact, on constructed circles and backs of cars."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from roadperc_stream.chain.stages.objects.path import PATH_MEMORY_M, DrivenArc, EgoPath, left_of, path_of
from roadperc_stream.chain.stages.objects.tracker import ObjectsState, step
from roadperc_stream.config import ObjectsConfig
from roadperc_stream.geometry import Camera, mounting, rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy
from roadperc_stream.model import Boundary, Box, Detection, Lanes
from tests.analytic import PEDESTRIAN, STEP_NS, VEHICLE
from tests.scenes import scene_of

CFG = ObjectsConfig()
RIGHT_BEND = DrivenArc(-0.1, 10.0)


def lanes(left_m, right_m, heading=0.0, curvature=0.0, changes=2):
    """Boundaries at these offsets; a boundary with None is lost."""
    offsets = {"left": left_m, "right": right_m}
    return Lanes(
        tuple(
            Boundary(side, "lost")
            if offset is None
            else Boundary(side, "measured", offset_m=offset, heading=heading, curvature_per_m=curvature)
            for side, offset in offsets.items()
        ),
        lane_changes=changes,
    )


def step_of(metres, turn):
    """A step along a circle: last_T_this."""
    chord = metres if turn == 0 else 2 * metres / turn * np.sin(turn / 2)
    return rigid(rotation_from_rpy(0, 0, turn), np.array([chord * np.cos(turn / 2), chord * np.sin(turn / 2), 0]))


@pytest.mark.parametrize("radius_m", [12.0, -150.0, 1e9])
@pytest.mark.parametrize(("offset_m", "heading"), [(0.0, 0.0), (-0.7, 0.1)])
def test_places_beside_a_circle_are_at_right_angles_to_it(radius_m, offset_m, heading):
    path = EgoPath("odometry", offset_m, heading, 1 / radius_m)
    along, aside = np.array([0.0, 5.0, 15.0]), np.array([0.4, -1.2, 3.0])
    turned = heading + along / radius_m
    middle = np.stack((np.sin(turned) - np.sin(heading), np.cos(heading) - np.cos(turned)), axis=-1) * radius_m
    points = middle + [0, offset_m] + aside[:, None] * np.stack((-np.sin(turned), np.cos(turned)), axis=-1)
    for (x, y), expected in zip(points, aside, strict=True):
        lateral = left_of(path, np.array([x]), np.array([y]))
        assert lateral == pytest.approx([expected], abs=1e-5)


def test_the_path_is_the_middle_of_the_lane():
    path = path_of(lanes(2.0, -1.5, heading=0.02, curvature=0.01), RIGHT_BEND)
    assert path == EgoPath("lane", 0.25, 0.02, 0.01, 1.75, 2)


@pytest.mark.parametrize("sides", [(2.0, None), (None, -1.0), (5.0, -1.5)])
def test_the_path_follows_a_boundary_if_the_lane_is_unknown_or_too_wide(sides):
    assert path_of(lanes(*sides, heading=0.02), RIGHT_BEND) == EgoPath("boundary", 0.0, 0.02, 0.0, None, 2)


def test_the_path_follows_the_boundary_that_the_car_follows_where_a_lane_ends():
    lane = lanes(2.0, -1.5, heading=0.01)
    ends = replace(lane, boundaries=(lane.side("left"), replace(lane.side("right"), heading=0.08)))
    assert path_of(ends, RIGHT_BEND) == EgoPath("boundary", 0.0, 0.01, 0.0, None, 2)


def test_where_a_lane_splits_the_path_follows_the_boundary_that_is_sure():
    lane = lanes(2.0, -1.5, heading=0.01)
    left, right = lane.boundaries
    sure, unsure = (tuple(np.diag((0.02, spread, spread / 10)).ravel() ** 2) for spread in (0.001, 0.02))
    splits = replace(right, heading=0.02, curvature_per_m=-0.004, covariance=unsure)
    path = path_of(replace(lane, boundaries=(replace(left, covariance=sure), splits)), RIGHT_BEND)
    assert (path.source, path.offset_m) == ("lane", 0.25)
    assert abs(left_of(path, np.array([30.0]), np.array([0.25 + 0.3]))[0]) < 0.2


@pytest.mark.parametrize("ego_lane", [None, lanes(None, None), lanes(-1.8, -1.35)])
def test_the_path_is_the_driven_circle_without_a_lane(ego_lane):
    path = path_of(ego_lane, RIGHT_BEND)
    assert (path.source, path.curvature_per_m) == ("odometry", -0.01)
    assert path_of(ego_lane, DrivenArc()).source == "straight"


@pytest.mark.parametrize("steps", [40, 4])
def test_the_driven_curvature_does_not_depend_on_the_frame_rate(steps):
    arc = DrivenArc()
    for _ in range(steps):
        arc = arc.after(step_of(20 / steps, 0.4 / steps))
    assert arc.curvature_per_m == pytest.approx(0.02, rel=0.01)
    straight = arc
    for _ in range(steps):
        straight = straight.after(step_of(5 / steps, 0.0))
    assert straight.curvature_per_m == pytest.approx(0.02 * np.exp(-5 / PATH_MEMORY_M), rel=0.35)


def test_a_standing_car_keeps_its_curvature():
    arc = DrivenArc().after(step_of(1.0, 0.05))
    assert arc.after(step_of(0.0, 0.001)) == arc.after(None) == arc
    assert DrivenArc().after(step_of(0.05, 0.0)).curvature_per_m is None


CAMERA = Camera("camera", 640, 480, 320.0, 320.0, 319.5, 239.5)
MOUNTING = mounting(z=1.4)
LANE = lanes(1.75, -1.75)
STEP_S = STEP_NS / 1e9
FAR_M = 90.0
TAGS = {"Car": VEHICLE, "Pedestrian": PEDESTRIAN}


@dataclass
class Road:
    """A road with backs of cars at (ahead, left) metres, each 1.8 m wide and 1.5 m high."""

    cfg: ObjectsConfig = CFG
    lane: object = LANE
    state: ObjectsState = field(default_factory=ObjectsState)
    stamp_ns: int = 0
    depth_noise: float = 0.0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    label: str = "Car"
    first_px: float = -1000.0
    """Left end of all boxes."""

    def frame(self, *backs, ego_step_m=None):
        depth, tags = np.full(CAMERA.size, FAR_M, np.float32), np.zeros(CAMERA.size, np.uint8)
        boxes = [self.draw(depth, tags, TAGS[self.label], *back) for back in backs]
        depth *= 1 + self.depth_noise * self.rng.standard_normal(depth.shape, np.float32)
        self.stamp_ns += STEP_NS
        scene = scene_of(
            CAMERA,
            MOUNTING,
            depth_m=depth,
            tags=tags,
            stamp_ns=self.stamp_ns,
            detections=tuple(
                Detection(self.label, replace(box, x_min=max(box.x_min, self.first_px)), 0.9) for box in boxes
            ),
        )
        last_T_this = None if ego_step_m is None else rigid(np.eye(3), np.array([ego_step_m, 0.0, 0.0]))
        self.state, out = step(self.cfg, self.state, scene, self.lane, last_T_this)
        return out

    @staticmethod
    def draw(depth, tags, tag, ahead_m, left_m):
        x0, x1 = (CAMERA.cx - CAMERA.fx * y / ahead_m + 0.5 for y in (left_m + 0.9, left_m - 0.9))
        y0, y1 = (CAMERA.cy - CAMERA.fy * z / ahead_m + 0.5 for z in (0.2, -1.3))
        box = Box(*(float(round(v)) for v in (x0, y0, x1, y1)))
        c0, r0, c1, r1 = box.rounded(CAMERA.width, CAMERA.height)
        depth[r0:r1, c0:c1], tags[r0:r1, c0:c1] = ahead_m, tag
        return box


def nearing(left_m, *, lane=LANE, cfg=CFG):
    """The objects of the last of 20 frames, in which a car approaches from 25 m at 8 m/s."""
    road = Road(cfg, lane)
    for k in range(20):
        out = road.frame((25.0 - 8.0 * STEP_S * k, left_m))
    return out


def test_an_object_in_the_path_and_one_beside_it():
    ahead, beside = nearing(0.3), nearing(3.2)
    (item,) = ahead.objects
    distance_m = 25.0 - 8.0 * STEP_S * 19
    assert (item.in_path, item.cut_in) == (True, False)
    assert item.lateral_m == pytest.approx(0.3, abs=0.1)
    assert item.time_to_impact_s == pytest.approx(distance_m / 8.0, rel=0.05)
    assert ahead.most_urgent == item
    (item,) = beside.objects
    assert (item.in_path, item.cut_in, item.time_to_impact_s) == (False, False, None)
    assert item.lateral_m == pytest.approx(3.2, abs=0.15)
    assert item.closing_speed_mps == pytest.approx(8.0, abs=0.5)
    assert beside.most_urgent is None


@pytest.mark.parametrize(
    ("changed", "in_path"), [({}, True), ({"path_margin_m": 0.0}, False), ({"car_width_m": 1.0}, False)]
)
def test_the_path_is_as_wide_as_the_car_and_a_margin(changed, in_path):
    (item,) = nearing(-2.0, cfg=ObjectsConfig(**changed)).objects
    assert item.in_path == in_path


@pytest.mark.parametrize(
    ("label", "across_mps", "threatens"), [("Car", 1.0, True), ("Car", 5.0, False), ("Pedestrian", 5.0, True)]
)
def test_a_vehicle_that_crosses_the_path_fast_has_no_time_to_impact(label, across_mps, threatens):
    """An oncoming car in a bend does so; a pedestrian may stop."""
    road = Road(label=label)
    for k in range(20):
        (item,) = road.frame((38.0 - 16.0 * STEP_S * k, -0.5 + across_mps * STEP_S * (k - 19))).objects
    assert item.in_path
    assert (item.time_to_impact_s is not None) == threatens


def test_a_car_cuts_in_until_it_is_in_the_path():
    road, seen = Road(), []
    for k in range(45):
        (item,) = road.frame((20.0 - 2.0 * STEP_S * k, -3.6 + 1.2 * STEP_S * k)).objects
        seen.append((item.in_path, item.cut_in, item.time_to_impact_s is None))
    beside, cutting, inside = seen.index((False, True, True)), seen.count((False, True, True)), (True, False, False)
    edges_m = [-3.6 + 1.2 * STEP_S * k + 0.9 for k in range(45)]
    assert edges_m[beside] == pytest.approx(-1.75, abs=0.2)
    assert seen[beside : beside + cutting] == [(False, True, True)] * cutting
    assert edges_m[beside + cutting] == pytest.approx(-1.2, abs=0.15)
    assert set(seen[beside + cutting :]) == {inside}


@pytest.mark.parametrize(("cut_in_mps", "cuts_in"), [(0.3, True), (2.0, False)])
def test_cut_in_needs_a_least_speed(cut_in_mps, cuts_in):
    road = Road(ObjectsConfig(cut_in_mps=cut_in_mps))
    for k in range(20):
        (item,) = road.frame((12.0, -3.4 + 1.2 * STEP_S * k)).objects
    assert (item.in_path, item.cut_in) == (False, cuts_in)


def test_no_cut_in_along_the_line_and_unknown_without_a_lane():
    (item,) = nearing(-2.4).objects
    assert (item.in_path, item.cut_in) == (False, False)
    out = nearing(-2.4, lane=None)
    assert out.path_source == "straight"
    assert (out.objects[0].in_path, out.objects[0].cut_in) == (False, None)


def test_places_change_with_the_lane():
    """A car in the left lane is beside the path until the ego car has crossed the line."""
    road = Road()
    for _ in range(10):
        (item,) = road.frame((20.0, 2.6)).objects
    assert (item.in_path, item.lateral_m) == (False, pytest.approx(2.6, abs=0.1))
    road.lane = lanes(3.4, -0.1, changes=3)
    (item,) = road.frame((20.0, 2.6)).objects
    assert (item.in_path, item.lateral_m) == (True, pytest.approx(0.95, abs=0.1))


@pytest.mark.parametrize("speed_mps", [0.0, 6.0])
def test_impacts_are_known_while_the_source_of_the_path_changes(speed_mps):
    """A car stands, or drives ahead, at 10 m/s of the ego car; the lane is lost and found again."""
    road, ahead_m, known = Road(), 25.0, []
    for k in range(30):
        road.lane = None if 20 <= k < 23 else LANE
        ahead_m -= (10.0 - speed_mps) * STEP_S
        (item,) = road.frame((ahead_m, 0.0), ego_step_m=10.0 * STEP_S).objects
        known.append(item.time_to_impact_s is not None)
    assert all(known[15:])


def test_a_vehicle_that_crosses_the_path_fast_has_no_time_to_impact_after_the_path_changed():
    road = Road()
    for k in range(20):
        road.lane = LANE if k < 19 else None
        (item,) = road.frame(
            (38.0 - 16.0 * STEP_S * k, -0.5 + 5.0 * STEP_S * (k - 19)), ego_step_m=10.0 * STEP_S
        ).objects
    assert (item.in_path, item.time_to_impact_s) == (True, None)


@pytest.mark.parametrize(("ahead_m", "left_m", "threatens"), [(40.0, 1.7, False), (40.0, 0.0, True), (15.0, 1.7, True)])
def test_a_standing_car_at_the_edge_of_the_path_threatens_when_it_is_near(ahead_m, left_m, threatens):
    """Until the car is there, 4 s later, the path may bend by a metre."""
    road = Road()
    for k in range(20):
        (item,) = road.frame((ahead_m + 10.0 * STEP_S * (19 - k), left_m), ego_step_m=10.0 * STEP_S).objects
    assert item.in_path
    assert (item.time_to_impact_s is not None) == threatens


def test_odometry_gives_the_closing_speed_while_braking():
    """The ego car brakes at 8 m/s2 behind a standing car; without odometry the filter reacts late."""
    errors = {}
    for known in (True, False):
        road, ahead_m, speed = Road(), 15.0, 10.0
        for _ in range(24):
            way_m = speed * STEP_S
            (item,) = road.frame((ahead_m, 0.0), ego_step_m=way_m if known else None).objects
            ahead_m, speed = ahead_m - (speed - 4.0 * STEP_S) * STEP_S, speed - 8.0 * STEP_S
        errors[known] = abs(item.closing_speed_mps - (speed + 8.0 * STEP_S))
    assert errors[True] < 0.3
    assert errors[True] < errors[False]


@pytest.mark.parametrize("depth_noise", [0.01, 0.02])
def test_impact_with_a_lead_car_that_brakes_hard(depth_noise):
    """At 6 m/s2, the errors agree with their standard deviations and are below 0.5 s."""
    errors, deviations = [], []
    for seed in range(4):
        road = Road(depth_noise=depth_noise, rng=np.random.default_rng(seed))
        ahead_m, closing = 12.0, 0.0
        for k in range(40):
            (item,) = road.frame((ahead_m, 0.0), ego_step_m=0.5).objects
            if 0.5 < ahead_m / max(closing, 1e-9) < 3.0:
                errors.append(np.inf if item.time_to_impact_s is None else item.time_to_impact_s - ahead_m / closing)
                deviations.append(errors[-1] / (item.time_to_impact_std_s or 1.0))
            braking = 6.0 if k >= 12 else 0.0
            ahead_m -= closing * STEP_S + braking * STEP_S**2 / 2
            closing += braking * STEP_S
    assert len(errors) > 40
    assert np.median(np.abs(errors)) < 0.2
    assert np.quantile(np.abs(errors), 0.95) < 0.5
    assert np.mean(np.abs(deviations) < 2) > 0.9


@pytest.mark.parametrize("first_px", [-1000.0, 2.0])
def test_a_car_cut_by_the_images_border_keeps_its_speed(first_px):
    """Its nearest visible point changes in every frame: the distance stays, although the car passes at 10 m/s."""
    road = Road(first_px=first_px)
    for k in range(40):
        (item,) = road.frame((max(20.0 - 0.5 * k, 4.5), 4.2), ego_step_m=0.5).objects
    assert item.detection.box_px.x_min < 0 or item.detection.box_px.x_min == first_px
    assert item.closing_speed_mps == pytest.approx(10 * np.cos(np.arctan2(3.8, 4.5)), abs=1.0)
