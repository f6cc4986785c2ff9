"""Which roles are worth a line."""

import pytest

from roadperc_stream.info.replay_printing import _worth_a_line
from roadperc_stream.info.role_states import RoleState


@pytest.mark.parametrize(
    ("state", "filled", "worth"),
    [
        (RoleState("image", "filled", "/a"), set(), True),
        (RoleState("depth", "missing", cost="no scale"), set(), True),
        (RoleState("lidar", "missing"), set(), False),
        (RoleState("lidar", "missing", candidates=("/points",)), set(), True),
        (RoleState("lidar", "missing", why="damaged"), set(), True),
        (RoleState("left_calibration", "missing", cost="no stereo"), {"left"}, True),
        (RoleState("left_calibration", "missing", cost="no stereo"), {"right"}, False),
        (RoleState("depth_calibration", "missing", cost="no depth"), {"depth"}, True),
        (RoleState("right_calibration", "missing", cost="no stereo"), set(), False),
    ],
)
def test_a_role_is_listed_where_it_is_filled_or_missed(state, filled, worth):
    assert _worth_a_line(state, filled) == worth
