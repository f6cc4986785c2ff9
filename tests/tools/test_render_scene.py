"""Compare rendered dumps with independent geometry."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from roadperc_stream.cli.convert import main as convert
from roadperc_stream.cli.render import main
from roadperc_stream.tools.scene.options import SCENES, SENSORS, RenderOptions
from roadperc_stream.tools.scene.scenes import make_scene
from tests.tools.rendered import CAMERA_X, CAMERA_Z, TAG


@pytest.fixture
def three_frames(rendered):
    """Three frames of a scene, one second apart."""

    def render(scene, size="320x240"):
        options = ("--scene", scene, "--seconds", "3", "--weave", "0.5", "--size", size)
        return rendered(*options, colour=size == "640x480")

    return render


def test_flat_road_depth_is_true_to_a_millimetre(rendered):
    dump = rendered("--scene", "straight", "--static", "--seconds", "0.1")
    f, _, cy = dump.pinhole
    tags, depth = dump.tags("000000"), dump.depth("000000")
    _, v = dump.pixels()
    road = (tags == TAG["road"]) | (tags == TAG["road_line"])
    expected = CAMERA_Z / ((v[road] - cy) / f)
    assert road.mean() > 0.2
    near = expected < 80
    assert depth[road][near] == pytest.approx(expected[near], abs=1e-3)
    assert (depth[tags == TAG["sky"]] == 1000).all()


@pytest.mark.parametrize("scene", SCENES)
def test_road_pixels_lie_on_the_terrain_through_the_written_pose(three_frames, scene):
    dump = three_frames(scene)
    terrain = make_scene(RenderOptions(scene=scene), 30.0).terrain
    for name in dump.names:
        tags, points = dump.tags(name), dump.world_points(name)
        near = dump.depth(name) < 60
        road = near & ((tags == TAG["road"]) | (tags == TAG["road_line"]))
        assert points[road][:, 2] == pytest.approx(terrain.height(points[road][:, 0]), abs=1e-3)
        walk = near & (tags == TAG["sidewalk"])
        above = points[walk][:, 2] - terrain.height(points[walk][:, 0])
        assert above.min() > -1e-3
        assert above.max() < 0.15 + 1e-3
        assert np.mean(np.abs(above - 0.15) < 1e-3) > 0.5


@pytest.mark.parametrize("scene", SCENES)
def test_lane_truth_lies_on_the_borders_of_the_tags(three_frames, scene):
    dump = three_frames(scene, "640x480")
    checked = 0
    for name in dump.names:
        for side, away in (("left", 1), ("right", -1)):
            boundary = dump.truth["lanes"][name][side]
            marking = "sidewalk" if boundary["outside"] == "sidewalk" else "road_line"
            points = np.array(boundary["line_ego_m"])[4:13]
            inside, outside = ([dump.tag_at(name, p, step * away) for p in points] for step in (-0.05, 0.05))
            checked += sum(tag is not None for tag in inside)
            assert set(inside) <= {TAG["road"], None}
            broken = scene in ("bend", "town") and side == "right"
            allowed = {TAG[marking], TAG["road"]} if broken else {TAG[marking]}
            assert set(outside) <= allowed | {None}
    assert checked > 20


@pytest.mark.parametrize("scene", SCENES)
def test_offset_heading_and_curvature_describe_the_line(three_frames, scene):
    dump = three_frames(scene)
    for name in dump.names:
        for side in ("left", "right"):
            boundary = dump.truth["lanes"][name][side]
            line = np.array(boundary["line_ego_m"])
            assert line[:, 0] == pytest.approx(np.arange(61.0), abs=1e-4)
            assert line[0, 1] == pytest.approx(boundary["offset_m"], abs=1e-5)
            x = line[:7, 0]
            parabola = boundary["offset_m"] + boundary["heading"] * x + boundary["curvature_per_m"] * x**2 / 2
            assert line[:7, 1] == pytest.approx(parabola, abs=0.01)
        width = [dump.truth["lanes"][name][side]["offset_m"] for side in ("left", "right")]
        assert width[0] - width[1] == pytest.approx(3.6 - 0.225, abs=0.02)


@pytest.mark.parametrize("scene", SCENES)
def test_surface_truth_is_the_plane_and_the_heights_of_the_road_pixels(three_frames, scene):
    dump = three_frames(scene)
    for name in dump.names:
        surface, points = dump.truth["surface"][name], dump.ego_points(name)
        points = points[dump.tags(name) == TAG["road"]]
        ahead = points[:, 0] - CAMERA_X
        x, y, z = points[(ahead > 3) & (ahead < 15) & (np.abs(points[:, 1]) < 4)].T
        curved = 0.05 if scene in ("hill", "town") else 1e-3
        assert surface["a"] * x + surface["b"] * y + z == pytest.approx(surface["d"], abs=curved)
        normal = np.array([surface["a"], surface["b"], 1.0]) / np.linalg.norm([surface["a"], surface["b"], 1.0])
        optical = np.array([-normal[1], -normal[2], normal[0]])
        assert surface["normal"] == pytest.approx(optical, abs=1e-6)
        height = normal @ [CAMERA_X, 0, CAMERA_Z] - surface["d"] * normal[2]
        assert surface["camera_height_m"] == pytest.approx(height, abs=1e-5)
        assert surface["pitch"] == pytest.approx(-np.arcsin(optical[2]), abs=1e-6)
        grid = surface["height_grid"]
        heights = np.array(grid["z_m"]).reshape(grid["rows"], grid["columns"])
        points = points[(points[:, 0] < 50) & (np.abs(points[:, 1]) < 7)]
        off = points[:, :2] - [grid["x_min_m"], grid["y_min_m"]]
        j, i = np.rint(off).astype(int).T
        close = np.hypot(off[:, 0] - j, off[:, 1] - i) < 0.05
        assert close.sum() > 5
        assert points[close][:, 2] == pytest.approx(heights[i, j][close], abs=0.01)


@pytest.mark.parametrize("scene", SCENES)
def test_right_picture_is_the_left_one_shifted_by_depth(three_frames, scene):
    dump = three_frames(scene, "640x480")
    f, _, _ = dump.pinhole
    u, v = dump.pixels()
    for name in dump.names[:2]:
        depth, left, right = dump.depth(name), dump.rgb(name), dump.rgb(name, "right")
        there = (u - f * dump.calibration["baseline_m"] / depth).astype(np.float32)
        warped = cv2.remap(right.astype(np.float32), there, v.astype(np.float32), cv2.INTER_LINEAR)
        difference = np.abs(warped - left).mean(axis=2)[(there > 1) & (depth < 200)]
        assert np.percentile(difference, 90) < 4
        unshifted = np.abs(right - left).mean(axis=2)[(there > 1) & (depth < 200)]
        assert np.percentile(unshifted, 90) > 20


def test_objects_are_boxed_tightly_and_measured_to_their_nearest_pixel(three_frames):
    dump = three_frames("town")
    f, cx, cy = dump.pinhole
    u, v = dump.pixels()
    seen = 0
    for name in dump.names:
        tags, depth = dump.tags(name), dump.depth(name)
        ranges = depth * np.sqrt(((u - cx) / f) ** 2 + ((v - cy) / f) ** 2 + 1)
        covered = np.zeros_like(tags, bool)
        for entry in dump.truth["objects"][name]:
            x0, y0, x1, y1 = entry["box_px"]
            own = tags[y0:y1, x0:x1] == TAG["car" if entry["label"] == "Car" else "pedestrian"]
            assert all(side.any() for side in (own[0], own[-1], own[:, 0], own[:, -1]))
            inside = np.where(own, ranges[y0:y1, x0:x1], np.inf)
            assert np.abs(inside - entry["distance_m"]).min() < 1e-3
            covered[y0:y1, x0:x1] = True
            seen += 1
        stray = np.isin(tags, (TAG["car"], TAG["pedestrian"])) & ~covered
        assert stray.sum() < 0.002 * tags.size
    assert seen > 10


def test_closing_speed_is_the_change_of_the_distance(rendered):
    dump = rendered("--scene", "bend", "--seconds", "1", "--rate", "20", "--size", "320x240")
    objects = [{o["id"]: o for o in frame} for frame in dump.truth["objects"].values()]
    compared = 0
    for before, now, after in zip(objects, objects[1:], objects[2:], strict=False):
        for name in before.keys() & now.keys() & after.keys():
            if not name.startswith("leader") and not name.startswith("oncoming"):
                continue
            x0, _, x1, _ = now[name]["box_px"]
            if x0 <= 1 or x1 >= 319 or now[name]["distance_m"] > 25:
                continue
            change = (before[name]["distance_m"] - after[name]["distance_m"]) / 0.1
            assert now[name]["closing_speed_mps"] == pytest.approx(change, abs=1.0)
            compared += 1
    assert compared >= 10
    speeds = [o["closing_speed_mps"] for frame in objects for n, o in frame.items() if n.startswith("oncoming")]
    assert np.median(speeds) == pytest.approx(19, abs=1.5)


def overlap(a, b):
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    common = max(width, 0) * max(height, 0)
    return common / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - common)


def test_detector_finds_nearly_all_and_more(rendered):
    dump = rendered("--scene", "town", "--seconds", "4", "--rate", "5", "--size", "320x240")
    found, right = [], []
    for name, detections in dump.json("detections").items():
        truth = dump.truth["objects"][name]
        for entry in truth:
            same = [d["box_px"] for d in detections if d["label"] == entry["label"]]
            if entry["box_px"][2] - entry["box_px"][0] > 6:
                found.append(any(overlap(box, entry["box_px"]) > 0.6 for box in same))
        right += [any(overlap(d["box_px"], o["box_px"]) > 0.4 for o in truth) for d in detections]
        assert all(0 < d["score"] < 1 and d["box_px"][0] < d["box_px"][2] for d in detections)
    assert 0.85 < np.mean(found) < 0.99
    assert 0.4 < np.mean(right) < 0.9


def contents(folder):
    return {p.relative_to(folder): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


TINY = ("--seconds", "0.2", "--rate", "10", "--size", "160x120")
SPOILED = (*TINY, "--tag-noise", "0.02", "--depth-noise", "0.01", "--rgb-noise", "2")


def test_equal_options_give_equal_bytes_and_another_seed_others(rendered, tmp_path):
    for name, seed in (("b", "0"), ("c", "4")):
        assert main([str(tmp_path / name), *SPOILED, "--seed", seed]) == 0
    a, b, c = (contents(folder) for folder in (rendered(*SPOILED, colour=True).folder, tmp_path / "b", tmp_path / "c"))
    assert a == b
    assert a.keys() == c.keys()
    assert a[Path("rgb/000000.png")] != c[Path("rgb/000000.png")]


def test_spoiled_pictures_have_their_clean_ones_beside_them(rendered):
    clean, spoiled = (rendered(*options, colour=True) for options in (TINY, SPOILED))
    assert not (clean.folder / "truth").exists()
    for name in clean.names:
        assert (spoiled.tags(name, "truth/segmentation") == clean.tags(name)).all()
        assert (spoiled.depth(name, "truth/depth") == clean.depth(name)).all()
        assert 0.005 < np.mean(spoiled.tags(name) != clean.tags(name)) < 0.15
        near = clean.depth(name) < 100
        assert np.std((spoiled.depth(name) / clean.depth(name))[near]) == pytest.approx(0.01, rel=0.1)
        for camera in ("rgb", "right"):
            assert np.std(spoiled.rgb(name, camera) - clean.rgb(name, camera)) == pytest.approx(2, rel=0.1)


def test_drop_leaves_out_files_but_none_of_the_first_frame_nor_of_the_truth(rendered):
    dump = rendered("--seconds", "2", "--rate", "10", "--size", "64x48", "--drop", "0.3", colour=True)
    present = [{path.stem for path in (dump.folder / sensor).iterdir()} for sensor in SENSORS]
    assert all("000000" in names and 10 < len(names) < 18 for names in present)
    assert present[0] != present[1]
    assert [len(list((dump.folder / "truth" / name).iterdir())) for name in ("segmentation", "depth")] == [20, 20]


def test_files_of_a_dump(rendered):
    dump = rendered("--seconds", "0.5", "--rate", "4", "--size", "160x120", "--jpeg", colour=True)
    assert dump.names == ["000000", "000001"]
    assert sorted(p.name for p in (dump.folder / "rgb").iterdir()) == ["000000.jpg", "000001.jpg"]
    assert (dump.folder / "right" / "000001.jpg").exists()
    assert (dump.folder / "timestamps.txt").read_text() == "000000 0.000000000\n000001 0.250000000\n"
    assert dump.calibration["K"] == [[80, 0, 80], [0, 80, 60], [0, 0, 1]]
    assert dump.calibration["mounting"]["right"] == {"x": 1.5, "y": 0.5, "z": 1.4, "roll": 0, "pitch": 0, "yaw": 0}
    assert dump.calibration["carla_tags"] == "0.9.15"
    seen = {int(tag) for name in dump.names for tag in np.unique(dump.tags(name))}
    assert {TAG[name] for name in ("road", "road_line", "sidewalk", "building", "pole", "sky", "car")} <= seen


def test_a_full_folder_or_a_file_is_refused_and_force_replaces_only_the_dump(tmp_path, capsys):
    tiny = ["--size", "64x48", "--rate", "2"]
    assert main([str(tmp_path), *tiny, "--seconds", "2"]) == 0
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    for folder, words in ((tmp_path, "--force"), (notes, "expected a folder")):
        assert main([str(folder), *tiny]) == 1
        assert words in capsys.readouterr().err
    assert main([str(tmp_path), *tiny, "--seconds", "1", "--force"]) == 0
    assert len(list((tmp_path / "rgb").iterdir())) == 2
    assert notes.read_text() == "mine"


def carla_points(path):
    """Read (N, 4) points from a file of carla.LidarMeasurement.save_to_disk."""
    header, _, body = path.read_text().partition("end_header\n")
    points = np.array(body.split(), float).reshape(-1, 4)
    assert header.splitlines() == [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(points)}",
        *(f"property float32 {name}" for name in "xyzI"),
    ]
    return points


def test_the_converter_says_what_it_reads_from_a_dump(rendered, tmp_path, capsys):
    dump = rendered("--size", "64x64", "--seconds", "0.2", "--rate", "10", "--lidar", "--instances", colour=True)
    capsys.readouterr()
    assert convert([str(dump.folder), str(tmp_path / "in.mcap")]) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert lines[1:8] == [
        "role from frames missing size encoding",
        "image rgb 2 0 64x64 png RGB 8 bit",
        "depth depth 2 0 64x64 carla 24 bit",
        "segmentation segmentation 2 0 64x64 raw in red",
        "instances instance_segmentation 2 0 64x64",
        "right right 2 0 64x64 png RGB 8 bit",
        "lidar lidar 2 0 ply, left-handed",
    ]
    assert "tags carla-from-0.9.14 (CARLA 0.9.15)" in lines
    assert "truth poses 2, surface 2, lanes 2, objects 2" in lines


@pytest.mark.parametrize("scene", ["straight", "town"])
def test_the_lidars_points_lie_on_what_the_depth_shows(rendered, scene):
    dump = rendered("--scene", scene, "--seconds", "0.05", "--lidar", "--size", "320x240")
    place = dump.calibration["mounting"]["lidar"]
    points = carla_points(dump.folder / "lidar" / "000000.ply")
    assert len(points) > 15_000
    forward, right, up, intensity = points.T
    distance = np.linalg.norm(points[:, :3], axis=1)
    np.testing.assert_allclose(intensity, np.exp(-0.004 * distance), atol=1e-3)
    elevation = np.degrees(np.arcsin(up / distance))
    assert -30.2 < elevation.min() < -29 < 9 < elevation.max() < 10.2
    assert np.abs(np.degrees(np.arctan2(right, forward))).max() < 45.1
    ahead, aside, above = forward + place["x"] - CAMERA_X, right, up + place["z"] - CAMERA_Z
    f, cx, cy = dump.pinhole
    u, v = np.rint(f * aside / ahead + cx).astype(int), np.rint(cy - f * above / ahead).astype(int)
    depth = dump.depth("000000")
    seen = (ahead > 0.1) & (u >= 0) & (u < depth.shape[1]) & (v >= 0) & (v < depth.shape[0])
    difference = ahead[seen] - depth[v[seen], u[seen]]
    assert seen.sum() > 10_000
    assert np.mean(np.abs(difference) < 0.02 * ahead[seen] + 0.02) > 0.8
    assert np.mean(difference < -0.1 * ahead[seen]) < 0.05, "hidden points are behind visible ones"


def test_sensors_left_out_leave_the_truth_and_change_no_other_file(rendered):
    two_frames = ("--seconds", "0.1", "--rate", "20")
    whole = rendered(*two_frames, "--lidar", colour=True)
    part = rendered(*two_frames, "--without", "depth", "--without", "right", colour=True)
    names = {path.name for path in part.folder.iterdir()}
    assert {"rgb", "segmentation", "truth"} <= names
    assert not {"depth", "right", "lidar"} & names
    for path in ("rgb/000001.png", "segmentation/000001.png", "detections.json", "truth.json"):
        assert (whole.folder / path).read_bytes() == (part.folder / path).read_bytes()
    np.testing.assert_array_equal(whole.depth("000001"), part.depth("000001", "truth/depth"))
    assert "lidar" not in part.calibration["mounting"]


def test_a_dump_without_truth_has_no_poses_either(tmp_path):
    options = ("--size", "160x120", "--seconds", "0.1", "--tag-noise", "0.05", "--without", "truth")
    assert main([str(tmp_path / "dump"), *options]) == 0
    names = {path.name for path in (tmp_path / "dump").iterdir()}
    assert {"rgb", "depth", "segmentation", "detections.json"} <= names
    assert not {"truth", "truth.json", "poses.json"} & names


WITHOUT_CAMERAS = [word for sensor in SENSORS for word in ("--without", sensor)]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--seconds", "nan"), "--seconds"),
        (("--drop", "1"), "--drop"),
        (("--size", "2x2"), "--size width"),
        (("--seed", "-1"), "--seed"),
        (("--change-back",), "--change-lane"),
        (("--change-lane", "left", "--change-back", "--change-broken-off"), "--change-broken-off"),
        (("--lead-brakes", "--stop-and-go"), "--stop-and-go"),
        (("--static", "--turn"), "--static"),
        (("--turn", "--lead-brakes"), "--turn"),
        (("--turn", "--change-lane", "left"), "--change-lane"),
        (("--lane", "ends", "--crossing-cars"), "--lane"),
        (("--bumps", "--turn"), "--bumps"),
        (("--bumps", "--scene", "bend"), "--bumps"),
        (("--fov", "120", "--scene", "town"), "not level"),
        (("--mount", "9,0,1,0,0,0"), "--mount x"),
        (("--worn-lines", "30,20"), "--worn-lines"),
        (("--lidar", *WITHOUT_CAMERAS), "--without: no camera is left"),
    ],
)
def test_values_out_of_range_and_options_that_exclude_each_other_are_refused(tmp_path, capsys, options, text):
    assert main([str(tmp_path / "dump"), *options]) == 1
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1
    assert not (tmp_path / "dump").exists()


def test_a_camera_that_sees_no_sky(tmp_path):
    """Its whole view is below the horizon."""
    mount = ("--mount", "1.5,0,1.4,0,-40,0", "--fov", "60")
    options = ("--scene", "straight", "--size", "64x48", "--seconds", "0.5", "--rate", "2", *mount)
    assert main([str(tmp_path / "dump"), *options]) == 0


@pytest.mark.parametrize("arguments", [[], ["x", "--size", "big"], ["x", "--mount", "1,2,3"]])
def test_wrong_usage_is_exit_2(arguments):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
