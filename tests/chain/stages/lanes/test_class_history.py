"""The majority of the classes beside a boundary: single frames do not make them flicker."""

import pickle
from itertools import pairwise

from roadperc_stream.chain.stages.lanes import LanesState
from roadperc_stream.chain.stages.lanes.tracking import ClassHistory
from roadperc_stream.config import LanesConfig
from tests.analytic import ROAD, STEP_NS, VEHICLE, Road
from tests.chain.stages.lanes.test_ego_lane import look

CFG = LanesConfig()


def after(*names, step_ns=STEP_NS, cfg=CFG):
    history, majorities = ClassHistory(), []
    for k, name in enumerate(names):
        history = history.add(cfg, k * step_ns, name)
        majorities.append(history.majority)
    return history, majorities


def test_a_single_frame_changes_nothing():
    _, majorities = after("road", "road", "vehicle", "road", "vehicle", "road")
    assert majorities == ["road"] * 6


def test_a_change_that_lasts_wins_after_half_the_window_in_seconds():
    for step_ns, frames in ((STEP_NS, 6), (STEP_NS // 2, 11)):
        _, majorities = after(*["road"] * 40, *["sidewalk"] * 20, step_ns=step_ns)
        assert majorities[40:].index("sidewalk") + 1 == frames


def test_equal_counts_are_decided_by_the_latest():
    assert after("road", "vehicle")[1] == ["road", "vehicle"]
    assert after("vehicle", "road", "road", "vehicle")[1][-1] == "vehicle"


def test_out_of_sight_adds_nothing_and_too_long_out_of_sight_is_nothing():
    _, majorities = after("road", *[""] * 12)
    assert majorities == ["road"] * 11 + [""] * 2


def test_without_a_window_the_last_frame_alone_counts():
    assert after("road", "road", "vehicle", cfg=CFG.model_copy(update={"hold_s": 0.0}))[1][-1] == "vehicle"


def test_memory_is_bounded():
    history, _ = after(*["road"] * 1000, step_ns=1000)
    assert len(history.observations) <= 256


def test_the_lanes_classes_do_not_flicker():
    """For one frame in three something covers the ground beyond the left line: it stays road, until it lasts."""
    road = Road()
    tags = road.tags()
    covered, y = tags.copy(), road.ground()[1][..., 1]
    covered[(y > 2.0) & (y < 4) & (tags == ROAD)] = VEHICLE
    state, outside = LanesState(), []
    for k in range(24):
        state, lanes = look(road, covered if k % 3 == 2 or k >= 12 else tags, state, k)
        state = pickle.loads(pickle.dumps(state))
        outside.append(lanes.side("left").outside)
    assert set(outside[:12]) == {"road"}
    assert outside[-1] == "vehicle"
    assert sum(a != b for a, b in pairwise(outside)) == 1


def test_a_held_boundary_keeps_what_was_voted():
    road = Road()
    state, _ = look(road)
    blank = road.tags() * 0 + ROAD
    for k in range(1, 11):
        state, lanes = look(road, blank, state, k)
        assert (lanes.side("right").status, lanes.side("right").outside) == ("held", "sidewalk")
