"""Motions of the ego car and the car ahead: lane changes, braking, queues, pitching."""

import itertools

import numpy as np
import pytest

from roadperc_stream.tools.scene.atlas import CAR_M
from roadperc_stream.tools.scene.ego import Ego, pitching
from roadperc_stream.tools.scene.motions import SpeedProfile, hard_braking, queue
from roadperc_stream.tools.scene.options import RenderOptions
from roadperc_stream.tools.scene.scenario import Scenario
from roadperc_stream.tools.scene.scenes import make_scene


def ego_of(**settings):
    options = RenderOptions(**{"scene": "straight", "weave_m": 0.0, "seconds": 20.0} | settings)
    return Scenario.of(make_scene(options, 300.0), options).ego


@pytest.mark.parametrize(("side", "aside_m"), [("left", 3.6375), ("right", -3.6375)])
def test_a_lane_is_changed_after_two_seconds_over_three(side, aside_m):
    ego = ego_of(change_lane=side)
    start = ego.d(0.0)
    assert ego.d(2.0) == start
    assert ego.d(3.5) == pytest.approx(start + aside_m / 2, abs=0.02)
    assert ego.d(5.0) == ego.d(9.0) == pytest.approx(start + aside_m, abs=0.01)
    for time_s in (2.3, 3.1, 4.8):
        step = ego.pose(time_s + 1e-4)[:2, 3] - ego.pose(time_s - 1e-4)[:2, 3]
        pose = ego.pose(time_s)
        assert np.arctan2(pose[1, 0], pose[0, 0]) == pytest.approx(np.arctan2(step[1], step[0]), abs=1e-4)


def states(ego, times):
    found = [ego.lane_change(float(t), 0.89) for t in times]
    return [s.direction for s in found], [s.count for s in found]


def test_a_lane_change_is_stated_while_the_car_is_over_the_line():
    ego = ego_of(change_lane="left", change_back=True)
    times = np.arange(0.0, 12.0, 0.01)
    directions, counts = states(ego, times)
    changed = [b for a, b in itertools.pairwise(directions) if a != b]
    assert changed == ["left", "none", "right", "none"]
    crossed = [float(t) for t, a, b in zip(times, counts, counts[1:], strict=False) if b == a + 1]
    assert crossed == pytest.approx([3.5, 8.5], abs=0.05)
    assert counts[-1] == 2
    over = [float(t) for t, d in zip(times, directions, strict=True) if d == "left"]
    assert all(abs(ego.d(t) + 3.675) < 0.89 + 0.075 + 1e-6 for t in over)
    assert all(ego.d(t) + 0.89 <= -3.75 or ego.d(t) - 0.89 >= -3.6 for t in set(times[times < 7]) - set(over))


def test_an_aborted_change_touches_the_line_and_returns():
    ego = ego_of(change_lane="right", change_broken_off=True)
    times = np.arange(0.0, 8.0, 0.01)
    directions, counts = states(ego, times)
    assert set(counts) == {0}
    assert set(directions) == {"none", "right"}
    assert ego.d(0.0) == ego.d(8.0)
    assert directions[-1] == "none"


def test_the_car_ahead_brakes_hard_and_the_ego_car_nearly_hits_it():
    times = np.arange(0.0, 14.0, 0.01)
    ego, leader = (np.array([profile.at(float(t)) for t in times]) for profile in hard_braking(10.0))
    room = leader[:, 0] - ego[:, 0] - CAR_M[0]
    assert room.min() == pytest.approx(0.8, abs=0.01)
    closing = ego[:, 1] - leader[:, 1]
    impact = np.where(closing > 0.5, room / np.maximum(closing, 0.5), np.inf)
    assert 0.2 < impact.min() < 1.0
    assert ego[-1, 1] == leader[-1, 1] == pytest.approx(10.0)
    assert np.diff(leader[:, 1]).min() / 0.01 == pytest.approx(-6.0, abs=0.1)
    assert (ego[:, 1] >= -1e-9).all()


@pytest.mark.parametrize("speed_mps", [3.0, 10.0, 20.0])
def test_no_collision_at_any_speed(speed_mps):
    for pair in (hard_braking(speed_mps), queue(speed_mps, 40.0)):
        times = np.arange(0.0, 40.0, 0.05)
        ego, leader = (np.array([profile.at(float(t)) for t in times]) for profile in pair)
        assert (leader[:, 0] - ego[:, 0]).min() > CAR_M[0] + 0.5
        assert (np.diff(ego[:, 0]) >= -1e-9).all()


def test_positions_are_the_integral_of_the_speed():
    profile = SpeedProfile(2.0, 8.0, ((1.0, 0.0), (2.0, -3.0), (1.5, 2.0)))
    times = np.linspace(0.0, 8.0, 8001)
    s, v = np.array([profile.at(float(t)) for t in times]).T
    assert np.gradient(s, times) == pytest.approx(v, abs=5e-3)
    assert profile.at(-1.0) == (-6.0, 8.0)


def test_a_standing_car_neither_weaves_nor_pitches():
    ego = ego_of(lead_brakes=True, weave_m=0.5, pitch_std_deg=1.0)
    stands = [t for t in np.arange(0.0, 10.0, 0.05) if ego.s(t) == ego.s(t + 0.05)]
    assert len(stands) > 10
    np.testing.assert_array_equal(ego.pose(float(stands[0])), ego.pose(float(stands[-1])))


def test_pitching_has_the_given_deviation():
    shake = pitching(1.5, 4)
    pitch = np.degrees([shake(float(t)) for t in np.arange(0.0, 300.0, 0.02)])
    assert pitch.std() == pytest.approx(1.5, rel=0.05)
    assert pitch.mean() == pytest.approx(0.0, abs=0.05)


SCENE = make_scene(RenderOptions(scene="straight"), 300.0)
MIDDLE_M = SCENE.section.lane_centre_m


def heading(ego, time_s):
    pose = ego.pose(time_s)
    return float(np.arctan2(pose[1, 0], pose[0, 0]))


@pytest.mark.parametrize(
    ("speed_mps", "weave_m", "slope"),
    [(10.0, 0.5, 2 * np.pi * 0.5 / 6.0 / 10.0), (1.0, 0.5, 0.15), (2.0, 3.0, 0.15), (10.0, 0.0, 0.0)],
)
def test_it_weaves_with_a_limited_slope(speed_mps, weave_m, slope):
    ego = Ego(SCENE, speed_mps, weave_m, static=False)
    assert np.tan(heading(ego, 0.0)) == pytest.approx(slope)
    times_s = np.linspace(0.0, 60.0, 301)
    assert max(abs(np.tan(heading(ego, t))) for t in times_s) == pytest.approx(slope, abs=1e-6)
    sideways_m = [ego.pose(t)[1, 3] - MIDDLE_M for t in times_s]
    assert max(np.abs(sideways_m)) <= weave_m + 1e-9
    assert [ego.pose(t)[0, 3] for t in (0.0, 3.0)] == pytest.approx([0.0, 3.0 * speed_mps], abs=1e-6)


def test_a_queue_stands_and_goes_again_and_again():
    ego, _ = queue(5.0, 40.0)
    speeds = np.array([ego.at(float(t))[1] for t in np.arange(0.0, 40.0, 0.05)])
    stands = speeds < 1e-9
    assert 0.1 < stands.mean() < 0.6
    assert np.sum(np.diff(stands.astype(int)) == 1) >= 3
    assert speeds.max() == pytest.approx(5.0)


def test_a_static_car_stands_in_the_centre_of_its_lane():
    ego = Ego(SCENE, 8.0, 0.7, static=True)
    for time_s in (0.0, 5.0):
        np.testing.assert_allclose(ego.pose(time_s)[:3, 3], [0.0, MIDDLE_M, 0.0], atol=1e-9)
        assert heading(ego, time_s) == 0.0
