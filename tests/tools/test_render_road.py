"""Dumps of other cameras, bumps, worn markings and a crossing, against geometry worked out here."""

import numpy as np
import pytest

from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14

TAG = {name: tag for tag, name in enumerate(CARLA_FROM_0_9_14.names)}


def test_a_camera_sees_as_far_aside_as_its_field_of_view(rendered):
    dump = rendered("--fov", "60", "--seconds", "1")
    assert 2 * np.degrees(np.arctan(80 / dump.calibration["K"][0][0])) == pytest.approx(60)


def test_road_seen_by_a_turned_camera_lies_on_the_level_ground(rendered):
    dump = rendered("--scene", "straight", "--mount", "0.5,-0.4,2,5,-8,15", "--seconds", "1", "--weave", "0")
    place = dump.calibration["mounting"]["depth"]
    assert [place[axis] for axis in ("x", "y", "z", "roll", "pitch", "yaw")] == [0.5, -0.4, 2, 5, -8, 15]
    f, cx, cy = dump.pinhole
    u, v = dump.pixels()
    z = dump.depth("000000")
    # Unreal's axes: x forward, y right, z up, and carla.Transform.get_matrix.
    forward = np.stack((z, (u - cx) / f * z, -(v - cy) / f * z), axis=-1)
    (cr, cp, cw), (sr, sp, sw) = (fn(np.radians([5, -8, 15])) for fn in (np.cos, np.sin))
    R = np.array(
        [
            [cp * cw, cw * sp * sr - sw * cr, -cw * sp * cr - sw * sr],
            [cp * sw, sw * sp * sr + cw * cr, -sw * sp * cr + cw * sr],
            [sp, -cp * sr, cp * cr],
        ]
    )
    heights = (forward @ R.T)[..., 2] + 2
    road = (dump.tags("000000") == TAG["road"]) & (z < 60)
    assert road.mean() > 0.2
    assert np.abs(heights[road]).max() < 1e-3


def test_a_speed_bump_is_in_depth_and_truth(rendered):
    dump = rendered("--scene", "straight", "--bumps", "--seconds", "1", "--weave", "0", "--size", "320x240")
    points, road = dump.ego_points("000000"), dump.tags("000000") == TAG["road"]
    on_top = road & (np.abs(points[..., 0] - 22) < 0.3)
    assert points[on_top][:, 2] == pytest.approx(0.1, abs=0.01)
    before = road & (points[..., 0] < 20)
    assert np.abs(points[before][:, 2]).max() < 1e-3
    line = np.array(dump.truth["lanes"]["000000"]["left"]["line_ego_m"])
    assert line[22, 2] == pytest.approx(0.1, abs=1e-3)
    assert line[18, 2] == pytest.approx(0.0, abs=1e-6)


def test_markings_are_missing_or_worn_where_they_should_be(rendered):
    options = ("--scene", "straight", "--worn-lines", "8,14", "--missing-lines", "16,22", "--size", "960x720")
    dump = rendered(*options, "--seconds", "1", "--weave", "0")
    points, tags = dump.ego_points("000000"), dump.tags("000000")
    y = points[..., 1] - (3.6 + 0.225) / 2
    yellow = (np.abs(np.abs(y) - 0.15) < 0.07) & np.isin(tags, (TAG["road"], TAG["road_line"]))

    def share(from_m, to_m):
        there = yellow & (points[..., 0] > from_m) & (points[..., 0] < to_m)
        assert there.sum() > 50
        return np.mean(tags[there] == TAG["road_line"])

    assert share(5, 7.9) == 1
    assert 0.15 < share(8.1, 13.9) < 0.6
    assert share(16.1, 21.9) == 0
    assert dump.truth["lanes"]["000000"]["left"]["offset_m"] == pytest.approx(1.6875, abs=0.01)


@pytest.mark.parametrize(("side", "sign"), [("left", 1), ("right", -1)])
def test_a_turn_has_the_radius_and_no_lanes_or_markings_in_it(rendered, side, sign):
    options = ("--scene", "straight", "--turn", side, "--seconds", "11", "--weave", "0")
    dump = rendered(*options, "--speed", "5", "--rate", "2")
    poses = dump.json("poses").values()
    x, y = np.array([(p["location"]["x"], -p["location"]["y"]) for p in poses]).T
    yaw = np.array([-p["rotation"]["yaw"] for p in poses])
    assert yaw[0] == pytest.approx(0, abs=0.1)
    assert yaw[-1] == pytest.approx(sign * 90, abs=0.1)
    turning = (np.abs(yaw) > 1) & (np.abs(yaw) < 89)
    centre = (10.0, -(3.6 + 0.225) / 2 + sign * 12.0)
    assert np.hypot(x - centre[0], y - centre[1])[turning] == pytest.approx(12.0, abs=1e-3)
    assert turning.sum() >= 5
    for name, inside in zip(dump.names, turning, strict=True):
        if inside:
            assert dump.truth["lanes"][name]["left"] is dump.truth["lanes"][name]["right"] is None
    assert dump.truth["lanes"][dump.names[0]]["left"] is not None
    assert dump.truth["lanes"][dump.names[-1]]["right"]["offset_m"] == pytest.approx(-1.6875, abs=0.01)
    line = dump.truth["lanes"][dump.names[0]]["left"]["line_ego_m"]
    assert line[-1][0] <= 10, "a line ends where the crossing begins"
