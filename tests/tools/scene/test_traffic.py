"""How the ego car moves."""

import numpy as np
import pytest

from roadperc_stream.tools.scene.ego import Ego
from roadperc_stream.tools.scene.options import RenderOptions
from roadperc_stream.tools.scene.world import make_world

WORLD = make_world(RenderOptions(scene="straight"), 300.0)
MIDDLE_M = WORLD.section.lane_centre_m


def heading(ego, time_s):
    pose = ego.pose(time_s)
    return float(np.arctan2(pose[1, 0], pose[0, 0]))


@pytest.mark.parametrize(
    ("speed_mps", "weave_m", "slope"),
    [(10.0, 0.5, 2 * np.pi * 0.5 / 6.0 / 10.0), (1.0, 0.5, 0.15), (2.0, 3.0, 0.15), (10.0, 0.0, 0.0)],
)
def test_it_weaves_in_six_seconds_but_turns_out_of_the_lane_by_no_more_than_a_car_would(speed_mps, weave_m, slope):
    ego = Ego(WORLD, speed_mps, weave_m, static=False)
    assert np.tan(heading(ego, 0.0)) == pytest.approx(slope)
    times_s = np.linspace(0.0, 60.0, 601)
    assert max(abs(np.tan(heading(ego, t))) for t in times_s) == pytest.approx(slope, abs=1e-6)
    sideways_m = [ego.pose(t)[1, 3] - MIDDLE_M for t in times_s]
    assert max(np.abs(sideways_m)) <= weave_m + 1e-9
    assert [ego.pose(t)[0, 3] for t in (0.0, 3.0)] == pytest.approx([0.0, 3.0 * speed_mps], abs=1e-6)


def test_it_heads_where_it_goes():
    ego = Ego(WORLD, 8.0, 0.7, static=False)
    for time_s in (0.4, 1.3, 2.9):
        step = ego.pose(time_s + 1e-4)[:2, 3] - ego.pose(time_s - 1e-4)[:2, 3]
        assert heading(ego, time_s) == pytest.approx(np.arctan2(step[1], step[0]), abs=1e-4)


def test_a_static_one_stands_in_the_middle_of_its_lane():
    ego = Ego(WORLD, 8.0, 0.7, static=True)
    for time_s in (0.0, 5.0):
        np.testing.assert_allclose(ego.pose(time_s)[:3, 3], [0.0, MIDDLE_M, 0.0], atol=1e-9)
        assert heading(ego, time_s) == 0.0
