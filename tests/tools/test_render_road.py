"""Compare dumps with other cameras, bumps, markings, crossings and lanes with independent geometry."""

import numpy as np
import pytest

from tests.tools.rendered import TAG, carla_rotation

PATH_KEYS = {"lateral_m", "in_path", "time_to_impact_s"}


def test_road_seen_by_a_turned_camera_lies_on_the_level_ground(rendered):
    mount = ("--mount", "0.5,-0.4,2,5,-8,15", "--fov", "80")
    dump = rendered("--scene", "straight", *mount, "--seconds", "1", "--weave", "0")
    assert 2 * np.degrees(np.arctan(80 / dump.calibration["K"][0][0])) == pytest.approx(80)
    place = dump.calibration["mounting"]["depth"]
    assert [place[axis] for axis in ("x", "y", "z", "roll", "pitch", "yaw")] == [0.5, -0.4, 2, 5, -8, 15]
    f, cx, cy = dump.pinhole
    u, v = dump.pixels()
    z = dump.depth("000000")
    # Unreal's axes: x forward, y right, z up.
    forward = np.stack((z, (u - cx) / f * z, -(v - cy) / f * z), axis=-1)
    heights = (forward @ carla_rotation(5, -8, 15).T)[..., 2] + 2
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


def test_markings_are_missing_or_worn_in_the_given_stretches(rendered):
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
    dump = rendered(*options, "--speed", "5", "--rate", "2", "--size", "64x48")
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


def lanes(dump):
    return [dump.truth["lanes"][name] for name in dump.names]


def test_path_truth_adds_keys_and_changes_nothing_else(rendered):
    plain, more = (rendered("--seconds", "2", *option, colour=True) for option in ((), ("--path-truth",)))
    for file in ("detections.json", "rgb/000001.png", "segmentation/000001.png"):
        assert (plain.folder / file).read_bytes() == (more.folder / file).read_bytes()
    for before, after in zip(lanes(plain), lanes(more), strict=True):
        assert after == before | {"lane_change": "none", "lane_changes": 0}
    for name in plain.names:
        for before, after in zip(plain.truth["objects"][name], more.truth["objects"][name], strict=True):
            assert after.items() >= before.items()
            assert after.keys() - before.keys() == PATH_KEYS


@pytest.mark.parametrize(("scene", "side"), [("bend", "left"), ("hill", "right"), ("town", "left")])
def test_lane_truth_follows_the_car_and_its_edges_lie_on_the_tags(rendered, scene, side):
    dump = rendered("--scene", scene, "--change-lane", side, "--seconds", "6", "--size", "320x240", "--weave", "0")
    found = lanes(dump)
    assert [lane["lane_changes"] for lane in found] == [0, 0, 0, 0, 1, 1]
    assert {lane["lane_change"] for lane in found[:3]} == {"none"} == {found[5]["lane_change"]}
    on_line = 0
    for name, lane in zip(dump.names, found, strict=True):
        assert lane["left"]["offset_m"] > 0 > lane["right"]["offset_m"]
        for edge, away in ((lane["left"], 1), (lane["right"], -1)):
            for point in np.array(edge["line_ego_m"])[3:10]:
                inside, outside = (dump.tag_at(name, point, step) for step in (-0.07 * away, 0.07 * away))
                if None not in (inside, outside):
                    assert inside == TAG["road"]
                    assert outside in (TAG["road"], TAG["road_line"], TAG["sidewalk"])
                    on_line += outside != TAG["road"]
    assert on_line > 20


@pytest.mark.parametrize(
    ("event", "offsets"),
    [
        ("begins", [-3.6, -3.6, -3.6, -3.6]),
        ("ends", [-3.6, -3.6, -3.6, -3.6]),
        ("splits", [-3.6, -3.6 - 1.25, -3.6 - 2.5, -3.6]),
        ("merges", [-3.6, -7.35 + 1.25, -7.35 + 2.5, -3.6]),
    ],
)
def test_the_right_edge_follows_added_and_removed_lanes(rendered, event, offsets):
    dump = rendered("--scene", "straight", "--lane", event, "--seconds", "9", "--weave", "0", "--size", "240x180")
    middle = -(3.6 + 0.225) / 2
    found = [dump.truth["lanes"][dump.names[k]]["right"]["offset_m"] + middle for k in (3, 5, 6, 8)]
    assert found == pytest.approx(offsets, abs=0.02)
    points, tags = dump.ego_points(dump.names[7]), dump.tags(dump.names[7])
    curb = points[(tags == TAG["sidewalk"]) & (points[..., 1] < 0) & (points[..., 0] < 60), 1].max() + middle
    assert curb == pytest.approx(-6.0 if event in ("ends", "merges") else -9.75, abs=0.1)
