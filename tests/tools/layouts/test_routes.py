"""nuScenes, routes of CARLA's leaderboard, and Bench2Drive."""

import ast
import gzip
import json

import numpy as np
import pytest

from roadperc_stream.cli.convert import main
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.cli.report import main as report_main
from tests.tools.dump_writer import HEIGHT, TAGS, WIDTH, alpha, camera_pixels, jpeg, png
from tests.tools.test_conversion import convert, failure, payloads, printed_by

AHEAD = (0.5, -0.5, 0.5, -0.5)
UNTURNED = (1.0, 0.0, 0.0, 0.0)
SECONDS_US = 1_000_000
IMAGES = {0.97: 0.0, 1.25: 2.5, 1.48: 4.8}
"""Position of the car by the stamp of an image in seconds."""


def table(folder, name, rows):
    (folder / f"{name}.json").write_text(json.dumps(rows))


@pytest.fixture
def nuscenes(tmp_path):
    """One scene with three images, two sweeps and a car that drives 20 m/s; another scene has no files."""
    root = tmp_path / "nuscenes"
    version = root / "v1.0-mini"
    version.mkdir(parents=True)
    placed = {"translation": (0, 0, 1.8), "rotation": UNTURNED}
    camera = {
        "translation": (1.7, 0, 1.5),
        "rotation": AHEAD,
        "camera_intrinsic": ((8, 0, 7.5), (0, 8, 5.5), (0, 0, 1)),
    }
    table(version, "sensor", [{"token": name, "channel": name} for name in ("CAM_FRONT", "LIDAR_TOP", "CAM_BACK")])
    sensors = {"CAM_FRONT": camera, "LIDAR_TOP": {**placed, "camera_intrinsic": []}, "CAM_BACK": camera}
    table(
        version,
        "calibrated_sensor",
        [{"token": f"calibrated {name}", "sensor_token": name, **found} for name, found in sensors.items()],
    )
    table(version, "scene", [{"token": "s1", "name": "scene-0001"}, {"token": "s2", "name": "scene-0002"}])
    times = {"a": 1.0, "b": 1.5, "other": 9.0}
    table(
        version,
        "sample",
        [
            {"token": token, "timestamp": round(at * SECONDS_US), "scene_token": "s2" if token == "other" else "s1"}
            for token, at in times.items()
        ],
    )
    data, poses = [], []
    for channel, at, sample in [
        *(("CAM_FRONT", at, "a") for at in reversed(IMAGES)),
        ("CAM_BACK", 1.0, "a"),
        ("LIDAR_TOP", 1.0, "a"),
        ("LIDAR_TOP", 1.5, "b"),
        ("CAM_FRONT", 9.0, "other"),
    ]:
        token, us = f"{channel}{at}", round(at * SECONDS_US)
        name = f"samples/{channel}/{us}.{'pcd.bin' if channel == 'LIDAR_TOP' else 'jpg'}"
        row = {"token": token, "sample_token": sample, "ego_pose_token": token, "timestamp": us, "filename": name}
        data.append({**row, "calibrated_sensor_token": f"calibrated {channel}"})
        poses.append({"token": token, "translation": (IMAGES.get(at, 0.0), 0, 0), "rotation": UNTURNED})
        if sample != "other":
            jpeg(root / name, camera_pixels())
        if channel == "LIDAR_TOP":
            (root / name).write_bytes(np.array([[1, 2, 3, 40, 7], [4, 5, 6, 50, 8]], "<f4").tobytes())
    table(version, "sample_data", data)
    table(version, "ego_pose", poses)
    table(
        version, "category", [{"token": "c", "name": "vehicle.car"}, {"token": "p", "name": "human.pedestrian.adult"}]
    )
    table(version, "instance", [{"token": "car", "category_token": "c"}, {"token": "hidden", "category_token": "p"}])
    box = {"size": (1.8, 4.0, 3.0), "rotation": UNTURNED, "num_radar_pts": 0}
    table(
        version,
        "sample_annotation",
        [
            {
                **box,
                "token": s + name,
                "sample_token": s,
                "instance_token": name,
                "translation": (x, 0, 1.5),
                "num_lidar_pts": points,
            }
            for s, x in (("a", 20), ("b", 30))
            for name, points in (("car", 9), ("hidden", 0))
        ],
    )
    return root


def test_a_scene_has_the_boxes_of_its_images(nuscenes, capsys):
    """At 1.25 s the car is at 25 m, its end at 23 m, the camera at 2.5 + 1.7 m."""
    found = payloads(convert(nuscenes, "--sequence", "scene-0001"))
    start_ns = found["image"][0][0]
    assert [(ns - start_ns) // 10**6 for ns, _, _ in found["image"]] == [0, 280, 510]
    assert [(ns - start_ns) // 10**6 for ns, _, _ in found["lidar"]] == [30, 530]
    np.testing.assert_allclose(found["lidar"][0][2].points_m, [(1, 2, 3), (4, 5, 6)])
    assert [pose.parent_T_child[0, 3] for _, _, pose in found["truth_pose"]] == list(IMAGES.values())
    objects = [entry.objects for _, _, entry in found["truth_objects"]]
    assert [[item.detection.label for item in entry] for entry in objects] == [["car"]] * 3
    np.testing.assert_allclose([entry[0].distance_m for entry in objects], (16.3, 18.8, 21.1))
    edges = {edge.child: edge.parent_T_child for edge in found["tf"][0][2]}
    np.testing.assert_allclose(edges["camera_front"][:3, 3], (1.7, 0, 1.5))
    np.testing.assert_allclose(edges["camera_front"][:3, 2], (1, 0, 0), atol=1e-9)
    assert "CAM_BACK are left out" in printed_by(capsys, nuscenes, nuscenes / "o.mcap", "--sequence", "scene-0001")


def test_the_tables_name_what_is_wrong(nuscenes, capsys):
    assert "found scene-0001, scene-0002; choose" in failure(capsys, nuscenes, nuscenes / "o.mcap")
    version, chosen = nuscenes / "v1.0-mini", (nuscenes, nuscenes / "o.mcap", "--sequence", "scene-0001")
    table(version, "ego_pose", [])
    assert "ego_pose.json: no row has the token 'CAM_FRONT0.97'" in failure(capsys, *chosen)
    table(version, "ego_pose", [{"token": "t", "translation": (0, 0), "rotation": UNTURNED}])
    assert "ego_pose.json: [0].translation[2]: " in failure(capsys, *chosen)


def carla_matrix(x, y, z=0.0):
    """CARLA's matrix of a car that faces along +y, to the right of +x."""
    return [[0, -1, 0, x], [1, 0, 0, y], [0, 0, 1, z], [0, 0, 0, 1]]


def packed(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(json.dumps(content).encode()))


def test_carla_garage(tmp_path, capsys):
    """The end of the car is 18 m ahead of the ego origin, the camera 1.5 m behind that."""
    route = tmp_path / "route"
    for name in ("rgb", "rgb_augmented"):
        jpeg(route / name / "0000.jpg", camera_pixels())
    png(route / "depth" / "0000.png", np.full((HEIGHT, WIDTH), 51, np.uint8))
    png(route / "semantics" / "0000.png", TAGS)
    packed(route / "measurements" / "0000.json.gz", {"theta": 0.5 * np.pi, "ego_matrix": carla_matrix(10, 5)})
    boxes = [
        {"class": "ego_car", "extent": [2, 1, 1], "distance": -1, "matrix": carla_matrix(10, 5)},
        {"class": "car", "extent": [2, 1, 1.5], "num_points": 3, "id": 7, "matrix": carla_matrix(10, 25)},
        {"class": "walker", "extent": [0.2, 0.2, 0.9], "num_points": 0, "matrix": carla_matrix(10, 15, 0.9)},
        {"class": "traffic_light", "extent": [2, 2, 1]},
    ]
    packed(route / "boxes" / "0000.json.gz", boxes)
    found = payloads(convert(tmp_path, "--carla", "0.9.15"))
    np.testing.assert_allclose(found["depth"][0][2].depth_m, 10.0)
    pose = found["truth_pose"][0][2].parent_T_child
    np.testing.assert_allclose(pose[:2], [(0, 1, 0, 10), (-1, 0, 0, -5)], atol=1e-9)
    (car,) = found["truth_objects"][0][2].objects
    assert (car.detection.label, car.track_id, car.distance_m) == ("car", "7", pytest.approx(19.5))
    camera = found["calibration"][0][2]
    assert camera.fx == pytest.approx(WIDTH / 2 / np.tan(np.deg2rad(55)))
    text = printed_by(capsys, tmp_path, tmp_path / "o.mcap", "--carla", "0.9.15")
    assert "assumed: level camera -1.5 m forward, 2 m up, 110 degrees, 4 Hz, as in carla_garage" in text
    (route / "measurements" / "0000.json.gz").write_text("{}")
    assert "0000.json.gz: Not a gzipped file" in failure(capsys, route, tmp_path / "p.mcap", "--carla", "0.9.15")


def test_the_middle_one_of_three_cameras_is_used(tmp_path):
    side_by_side = np.repeat(np.array([0, 100, 200], np.uint8), WIDTH)
    png(tmp_path / "rgb" / "0000.png", np.dstack([np.tile(side_by_side, (HEIGHT, 1))] * 3))
    png(tmp_path / "semantics" / "0000.png", np.hstack((TAGS * 0, TAGS, TAGS * 0)))
    (tmp_path / "label_raw").mkdir()
    labels = [{"class": "Car", "extent": [3, 4, 2], "id": 1, "ego_matrix": carla_matrix(0, 20)}]
    (tmp_path / "label_raw" / "0000.json").write_text(json.dumps(labels))
    (tmp_path / "measurements").mkdir()
    measurement = {"x": 0, "y": 0, "theta": 1.6, "ego_matrix": carla_matrix(0, 0)}
    (tmp_path / "measurements" / "0000.json").write_text(json.dumps(measurement))
    found = payloads(convert(tmp_path, "--carla", "0.9.15", "--allow-lossy-tags"))
    np.testing.assert_allclose(found["image"][0][2].decode_bgr(), np.full((HEIGHT, WIDTH, 3), 100), atol=2)
    np.testing.assert_array_equal(found["segmentation"][0][2].tags, TAGS)
    assert found["truth_objects"][0][2].objects[0].distance_m == pytest.approx(20 - 2 - 1.3)


def test_bench2drive(tmp_path, capsys):
    clip = tmp_path / "Town01_Route1"
    jpeg(clip / "camera" / "rgb_front" / "00000.jpg", camera_pixels())
    jpeg(clip / "camera" / "rgb_back" / "00000.jpg", camera_pixels())
    png(clip / "camera" / "depth_front" / "00000.png", np.full((HEIGHT, WIDTH), 20, np.uint8))
    png(clip / "camera" / "semantic_front" / "00000.png", TAGS)
    png(clip / "camera" / "instance_front" / "00000.png", alpha(camera_pixels()))
    (clip / "lidar").mkdir()
    laspy = pytest.importorskip("laspy")
    points = laspy.create(point_format=0)
    points.x, points.y, points.z = [5.0], [2.0], [1.0]
    points.write(str(clip / "lidar" / "00000.laz"))
    mounted = [[1, 0, 0, 0.8], [0, 1, 0, 0], [0, 0, 1, 1.6], [0, 0, 0, 1]]
    inverse = np.linalg.inv(carla_matrix(10, 25)).tolist()
    car = {"class": "vehicle", "id": "3", "base_type": "truck", "center": [10, 25, 2], "extent": [3, 1, 2]}
    annotation = {
        "theta": np.pi,
        "speed": None,
        "sensors": {"CAM_FRONT": {"intrinsic": [[8, 0, 8], [0, 8, 6], [0, 0, 1]], "cam2ego": mounted}},
        "bounding_boxes": [
            {"class": "ego_vehicle", "location": [10, 5, 0]},
            {**car, "world2vehicle": inverse, "num_points": 4},
            {**car, "world2vehicle": inverse, "num_points": 0},
            {"class": "traffic_light", "center": [0, 0, 0]},
        ],
    }
    packed(clip / "anno" / "00000.json.gz", annotation)
    found = payloads(convert(tmp_path))
    assert {"image", "depth", "segmentation", "instances", "truth_pose", "truth_objects"} <= set(found)
    np.testing.assert_allclose(found["lidar"][0][2].points_m, [(5, -2, 1)], atol=0.01)
    assert (found["calibration"][0][2].cx, found["calibration"][0][2].cy) == (7.5, 5.5)
    np.testing.assert_allclose(found["depth"][0][2].depth_m, 20.0)
    by_compass = found["truth_pose"][0][2].parent_T_child
    np.testing.assert_allclose(by_compass[:2], [(0, 1, 0, 10), (-1, 0, 0, -5)], atol=1e-9)
    (truck,) = found["truth_objects"][0][2].objects
    assert (truck.detection.label, truck.distance_m) == ("truck", pytest.approx(20 - 3 - 0.8))
    (clip / "lidar" / "00000.laz").write_bytes(b"not points")
    annotation["bounding_boxes"][0]["world2ego"] = np.linalg.inv(carla_matrix(10, 5)).tolist()
    packed(clip / "anno" / "00000.json.gz", annotation)
    text = printed_by(capsys, tmp_path, tmp_path / "o.mcap")
    assert "rgb_back are left out" in text
    assert "lidar/ is left out" in text
    exact = payloads(tmp_path / "o.mcap")["truth_pose"][0][2].parent_T_child
    np.testing.assert_allclose(exact, by_compass, atol=1e-9)
    del annotation["sensors"]["CAM_FRONT"]["intrinsic"]
    packed(clip / "anno" / "00000.json.gz", annotation)
    assert "00000.json.gz: sensors.CAM_FRONT.intrinsic: " in failure(capsys, clip, tmp_path / "p.mcap")


def test_a_measurement_that_is_no_literal_names_its_line(tmp_path, capsys):
    png(tmp_path / "rgb" / "0000.png", camera_pixels())
    (tmp_path / "measurements").mkdir()
    (tmp_path / "measurements" / "0000.json").write_text("{'x': 1,\n'y': }")
    assert "0000.json: line 2: neither JSON nor" in failure(capsys, tmp_path, tmp_path / "o.mcap")
    (tmp_path / "measurements" / "0000.json").write_text("{'x': nan}")
    assert " object at 0x" not in failure(capsys, tmp_path, tmp_path / "o.mcap")
    (tmp_path / "measurements" / "0000.json").write_text("{'x': 1, 'theta': 'north'}")
    assert "0000.json: theta: " in failure(capsys, tmp_path, tmp_path / "o.mcap")


def test_theta_of_the_course_of_2020_is_the_direction_of_motion(data_dir, tmp_path):
    """To 0.1 degrees in the median over frames that move 2 m; CARLA's y and theta are mirrored."""
    route = data_dir / "carla_leaderboard" / "route_00"
    assert main([str(route), str(tmp_path / "in.mcap"), "--quiet"]) == 0
    poses = [pose.parent_T_child for _, _, pose in payloads(tmp_path / "in.mcap")["truth_pose"]]
    first = ast.literal_eval((route / "measurements" / "0040.json").read_text())
    np.testing.assert_allclose(poses[0][:2, 3], (first["x"], -first["y"]))
    off_deg = []
    for before, now, after in zip(poses, poses[1:], poses[2:], strict=False):
        way = now[:3, :3].T @ (after - before)[:3, 3]
        off_deg += [np.rad2deg(np.arctan2(way[1], way[0]))] if np.linalg.norm(way) > 2 else []
    assert len(off_deg) > 40
    assert np.median(np.abs(off_deg)) < 0.1


@pytest.mark.parametrize("name", ["nuscenes_sample", "carla_leaderboard/route_00"])
def test_samples_convert_replay_and_report(data_dir, tmp_path, name, capsys):
    source, result = tmp_path / "in.mcap", tmp_path / "out.mcap"
    assert main([str(data_dir / name), str(source), "--quiet"]) == 0
    assert replay_main([str(source), str(result), "--quiet", "--frames", "4", "--only", "surface"]) == 0
    assert report_main([str(result)]) == 0
    assert "surface" in capsys.readouterr().out
