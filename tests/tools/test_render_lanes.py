"""Dumps of drives that change their lane, or whose lanes change, against geometry worked out here."""

import numpy as np
import pytest

from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14

TAG = {name: tag for tag, name in enumerate(CARLA_FROM_0_9_14.names)}
PATH_KEYS = {"lateral_m", "in_path", "time_to_impact_s"}


def lanes(dump):
    return [dump.truth["lanes"][name] for name in dump.names]


def test_path_truth_adds_keys_and_changes_nothing_else(rendered):
    plain, more = (rendered("--seconds", "2", *option) for option in ((), ("--path-truth",)))
    for file in ("detections.json", "rgb/000001.png", "segmentation/000001.png"):
        assert (plain.folder / file).read_bytes() == (more.folder / file).read_bytes()
    for before, after in zip(lanes(plain), lanes(more), strict=True):
        assert after == before | {"lane_change": "none", "lane_changes": 0}
    for name in plain.names:
        for before, after in zip(plain.truth["objects"][name], more.truth["objects"][name], strict=True):
            assert after.items() >= before.items()
            assert after.keys() - before.keys() == PATH_KEYS


@pytest.mark.parametrize("scene", ["bend", "hill", "town"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_the_lane_is_the_one_the_car_is_in_and_its_edges_lie_on_the_tags(rendered, scene, side):
    dump = rendered("--scene", scene, "--change-lane", side, "--seconds", "6", "--size", "320x240", "--weave", "0")
    found = lanes(dump)
    assert [lane["lane_changes"] for lane in found] == [0, 0, 0, 0, 1, 1]
    assert {lane["lane_change"] for lane in found[:3]} == {"none"} == {found[5]["lane_change"]}
    f, cx, cy = dump.pinhole
    on_line = 0
    for name, lane in zip(dump.names, found, strict=True):
        assert lane["left"]["offset_m"] > 0 > lane["right"]["offset_m"]
        tags, points = dump.tags(name), dump.ego_points(name)
        for edge, away in ((lane["left"], 1), (lane["right"], -1)):
            for point in np.array(edge["line_ego_m"])[3:10]:
                seen = []
                for step in (-0.07 * away, 0.07 * away):
                    x, y, z = point[0] - 1.5, point[1] + step, point[2] - 1.4
                    u, v = round(cx - f * y / x), round(cy - f * z / x)
                    if 0 <= u < 320 and 0 <= v < 240 and abs(points[v, u, 0] - point[0]) < 0.05 * x:
                        seen.append(tags[v, u])
                if len(seen) == 2:
                    assert seen[0] == TAG["road"]
                    assert seen[1] in (TAG["road"], TAG["road_line"], TAG["sidewalk"])
                    on_line += seen[1] != TAG["road"]
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
def test_the_right_edge_follows_lanes_that_change(rendered, event, offsets):
    dump = rendered("--scene", "straight", "--lane", event, "--seconds", "9", "--weave", "0", "--size", "240x180")
    middle = -(3.6 + 0.225) / 2
    found = [dump.truth["lanes"][dump.names[k]]["right"]["offset_m"] + middle for k in (3, 5, 6, 8)]
    assert found == pytest.approx(offsets, abs=0.02)
    points, tags = dump.ego_points(dump.names[7]), dump.tags(dump.names[7])
    curb = points[(tags == TAG["sidewalk"]) & (points[..., 1] < 0) & (points[..., 0] < 60), 1].max() + middle
    assert curb == pytest.approx(-6.0 if event in ("ends", "merges") else -9.75, abs=0.1)
