"""Lane changes and implausible lanes on roads computed by hand."""

from functools import cache

import numpy as np
import pytest

from roadperc_stream.chain.stages.lanes import tracking
from roadperc_stream.chain.stages.lanes.curves import Curve
from roadperc_stream.chain.stages.lanes.following import change_of, handed_over
from roadperc_stream.chain.stages.lanes.tracking import LanesState, TrackedBoundary
from roadperc_stream.config import LanesConfig
from roadperc_stream.model import Odometry, Reason
from tests.analytic import LINE, OTHER, ROAD, Road
from tests.chain.stages.lanes.test_ego_lane import look

CFG = LanesConfig()
LANE_M, MARKING_M = 3.5, 0.15
LINES_M = (5.25, 1.75, -1.75)
"""Middles of the markings of two lanes, the car in the right one."""


def markings(car_m, dashed=False, double=False, size=(640, 480)):
    """Tags of the two lanes if the car is ``car_m`` to the left of its first lane's middle."""
    road = Road(width=size[0], height=size[1])
    x, y, _ = np.moveaxis(road.ground()[1], -1, 0)
    tags = np.where(x < 150, ROAD, OTHER).astype(np.uint8)
    for k, line_m in enumerate(LINES_M):
        aside = y - (line_m - car_m)
        on_line = np.abs(aside) < MARKING_M / 2
        if k == 1 and double:
            on_line = np.abs(np.abs(aside) - 0.15) < MARKING_M / 2
        if k == 1 and dashed:
            on_line &= (x % 6.0) < 3.0
        tags[on_line & (x < 150)] = LINE
    return road, tags


def moved(sideways_m, index):
    """Odometry of half a metre ahead and ``sideways_m`` to the left."""
    T = np.eye(4)
    T[:2, 3] = 0.5, sideways_m
    covariance = np.diag([0.01, 0.005, 0.01, 1e-3, 1e-3, 1e-3]) ** 2
    return Odometry("tracked", np.eye(4), T, covariance=tuple(covariance.ravel())) if index else None


@cache
def drive(places_m, **kind):
    state, seen, before_m = LanesState(), [], places_m[0]
    for index, car_m in enumerate(places_m):
        state, lanes = look(*markings(car_m, **kind), state, index, motion=moved(car_m - before_m, index))
        seen.append(lanes)
        before_m = car_m
    return seen


ACROSS = (*[0.0] * 3, *np.linspace(0.0, LANE_M, 30).tolist(), *[LANE_M] * 3)


@pytest.mark.parametrize("kind", [{}, {"dashed": True}, {"double": True}], ids=["solid", "dashed", "double"])
def test_the_crossed_line_becomes_the_other_boundary(kind):
    seen = drive(ACROSS, **kind)
    assert [lanes.lane_changes for lanes in seen] == sorted(lanes.lane_changes for lanes in seen)
    crossed = next(k for k, lanes in enumerate(seen) if lanes.lane_changes == 1)
    assert abs(ACROSS[crossed] - 1.75) < 0.3
    half = 0.15 + MARKING_M / 2 if "double" in kind else MARKING_M / 2
    for lanes, car_m in zip(seen[crossed + 6 :], ACROSS[crossed + 6 :], strict=True):
        left, right = lanes.boundaries
        assert (left.status, right.status) == ("measured", "measured")
        assert left.offset_m == pytest.approx(5.25 - car_m - MARKING_M / 2, abs=0.05)
        assert right.offset_m == pytest.approx(1.75 - car_m + half, abs=0.08)
    assert seen[-1].lane_changes == 1


def test_the_change_lasts_while_the_car_is_over_the_line():
    states = [lanes.lane_change for lanes in drive(ACROSS)]
    first, last = states.index("left"), len(states) - 1 - states[::-1].index("left")
    assert set(states[first : last + 1]) == {"left"}
    assert set(states[:first]) == set(states[last + 1 :]) == {"none"}
    half_car = CFG.car_width_m / 2
    assert ACROSS[first] == pytest.approx(1.75 - half_car, abs=0.25)
    assert ACROSS[last] == pytest.approx(1.75 + half_car, abs=0.25)


@pytest.mark.parametrize(
    ("std_m", "heading_std", "changes", "is_sure"),
    [(0.02, 0.01, 1, True), (0.02, 0.1, 1, False), (0.4, 0.01, 0, None)],
    ids=["known", "uncertain ahead", "uncertain"],
)
def test_only_a_certain_line_is_crossed(std_m, heading_std, changes, is_sure):
    """30 cm past the line: an uncertain line may still be ahead of the car."""
    track = tracking.start(Curve(np.array([-0.3, 0.0, 0.0]), np.diag([std_m, heading_std, 0.001]) ** 2, 20.0), 1)
    after = handed_over(CFG, LanesState(left=TrackedBoundary(track, 20.0)), None, 1)
    assert after.lane_changes == changes
    assert (after.right and after.right.is_sure) == is_sure


def test_a_line_passed_in_a_turn_is_no_lane_change_but_changes_its_side():
    track = tracking.start(Curve(np.array([-0.3, 0.6, 0.0]), np.diag([0.02, 0.01, 0.001]) ** 2, 20.0), 1)
    after = handed_over(CFG, LanesState(left=TrackedBoundary(track, 20.0)), None, 1)
    assert (after.lane_changes, after.lane_change, after.left) == (0, "none", None)
    assert after.right.offset_m < -0.1
    assert change_of(CFG, "none", after) == "none"


def test_an_aborted_lane_change_does_not_count():
    there = list(np.linspace(0.0, 1.4, 14))
    seen = drive((0.0, 0.0, *there, *there[::-1], 0.0))
    assert {lanes.lane_change for lanes in seen} == {"none", "left"}
    assert seen[-1].lane_change == "none"
    assert {lanes.lane_changes for lanes in seen} == {0}
    assert seen[-1].side("left").offset_m == pytest.approx(1.75 - MARKING_M / 2, abs=0.05)


def test_the_boundary_under_the_car_is_lost():
    seen = drive((0.0, 0.0, *np.linspace(0.0, 1.72, 15)))
    left = seen[-1].side("left")
    assert (left.status, left.offset_m) == ("lost", None)
    assert left.reason == Reason("lanes", "car_on_boundary", ("left",))
    assert left.reason in seen[-1].reasons


def test_a_boundary_of_a_lane_too_narrow_is_lost_with_a_reason():
    road = Road(left_m=0.7, right_m=-0.9)
    _, lanes = look(road)
    (lost,) = (boundary for boundary in lanes.boundaries if boundary.status == "lost")
    assert lost.reason.code == "lane_width"
    assert lost.reason.values[1:] == (pytest.approx(1.6, abs=0.05), 2.0, 7.0)


def test_a_line_across_the_lane_is_not_a_boundary():
    road = Road(width=1280, height=960)
    tags = road.tags()
    x, y, _ = np.moveaxis(road.ground()[1], -1, 0)
    tags[tags == LINE] = ROAD
    tags[(np.abs(y - (2.0 - 0.6 * x)) < 0.1) & (y > -1.8) & (x > 0)] = LINE
    _, lanes = look(road, tags)
    left, right = lanes.boundaries
    assert (left.status, right.status) == ("lost", "measured")
    assert left.reason is not None


def test_another_scene_clears_the_lanes():
    near, far = Road(left_m=1.2, right_m=-2.4), Road(left_m=1.6, right_m=-2.0)
    state, _ = look(near)
    lost = Odometry("lost", np.eye(4), reason=Reason("odometry", "too_few_inliers"))
    _, lanes = look(far, None, state, 1, motion=lost)
    assert [boundary.offset_m for boundary in lanes.boundaries] == [b.raw_offset_m for b in lanes.boundaries]
    _, later = look(far, None, state, 100)
    assert [boundary.offset_m for boundary in later.boundaries] == [b.raw_offset_m for b in later.boundaries]


def test_a_frame_without_an_image_holds_the_lanes():
    road = Road()
    state, _ = look(road)
    lost = Odometry("lost", np.eye(4), reason=Reason("odometry", "no_image"))
    after, lanes = look(road, np.full_like(road.tags(), ROAD), state, 1, motion=lost)
    assert [boundary.status for boundary in lanes.boundaries] == ["held", "held"]
    assert after.left is not None
