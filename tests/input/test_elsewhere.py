"""A ROS 2 bag with the frames of the sample gives the same metrics."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import polars as pl
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from polars.testing import assert_frame_equal
from scipy.spatial.transform import Rotation

from roadperc_stream import log
from roadperc_stream.cli.replay import main as replay_main
from roadperc_stream.config import load_config
from roadperc_stream.formats import images
from roadperc_stream.geometry import rigid
from roadperc_stream.input.decoding.payload import pose_matrix
from roadperc_stream.input.decoding.ros import unpack_image
from roadperc_stream.model import reason_of
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14 as TABLE
from roadperc_stream.output.tables import sidecar_path
from roadperc_stream.schemas import ros2
from roadperc_stream.schemas.protobuf import stamp_ns
from roadperc_stream.schemas.roadperc_pb2 import Detections
from tests import rosbag
from tests.replaying import replay
from tests.resume.parts import write

SAMPLE = Path(__file__).parents[2] / "logs" / "sample.mcap"
FRAMES = 5
CFG = load_config()
TOPICS = {
    "/camera/front/image": "rgb_front/image",
    "/camera/front/calibration": "rgb_front/camera_info",
    "/camera/front/depth": "depth_front/image",
    "/camera/front/segmentation": "semantic_segmentation_front/image",
    "/camera/front/detections": "detections",
    "/tf": "/tf",
    "/truth/pose": "odometry",
}
EGO = {"ego": "ego_vehicle"}


@pytest.fixture(scope="module")
def recorded():
    """The messages of the sample's first frames that ROS has a type for."""
    messages = [m for m in log.read(log.summarise(SAMPLE)) if m.channel.topic in TOPICS]
    times = sorted({m.log_time_ns for m in messages})
    return [m for m in messages if m.log_time_ns <= times[FRAMES - 1]]


def in_metres(message):
    """The same depth as 32FC1."""
    if message.channel.topic != "/camera/front/depth":
        return message
    image = unpack_image(message.data)
    image = replace(image, encoding="32FC1", pixels=images.depth_from_mm(image.pixels))
    return replace(message, data=ros2.pack_image(image))


def in_ros(message, colours):
    """Return (type, message) of a message of the sample, as the CARLA bridge and a detector publish it."""
    topic, data = message.channel.topic, message.data
    if topic == "/camera/front/image":
        picture = CompressedImage.FromString(data)
        bgr = images.decode_bgr(picture.data)
        return ros2.IMAGE, of_colours(stamp_ns(picture.timestamp), picture.frame_id, bgr, colours)
    if topic == "/camera/front/segmentation":
        picture = CompressedImage.FromString(data)
        rgb = np.array(TABLE.colours, np.uint8)[images.decode_indices(picture.data)]
        return ros2.IMAGE, of_colours(stamp_ns(picture.timestamp), picture.frame_id, rgb[..., ::-1], colours)
    if topic == "/camera/front/depth":
        depth = unpack_image(data)
        return ros2.IMAGE, rosbag.image(depth.stamp_ns, depth.frame_id, depth.encoding, depth.pixels)
    if topic == "/camera/front/calibration":
        camera = CameraCalibration.FromString(data)
        stamp = stamp_ns(camera.timestamp)
        info = rosbag.camera_info(stamp, camera.frame_id, camera.width, camera.height, camera.K)
        return "sensor_msgs/msg/CameraInfo", info
    return of_objects(topic, data)


def of_colours(stamp, frame_id, bgr, encoding):
    pixels = cv2.cvtColor(np.ascontiguousarray(bgr), cv2.COLOR_BGR2BGRA) if encoding == "bgra8" else bgr
    return rosbag.image(stamp, frame_id, encoding, pixels)


def of_objects(topic, data):
    if topic == "/camera/front/detections":
        found = Detections.FromString(data)
        detections = [rosbag.detection(d.box_px, d.label, d.score, d.id) for d in found.detections]
        return rosbag.DETECTIONS, {"header": rosbag.header(stamp_ns(found.timestamp), ""), "detections": detections}
    if topic == "/tf":
        edges = [transform(edge) for edge in FrameTransforms.FromString(data).transforms]
        return "tf2_msgs/msg/TFMessage", {"transforms": edges}
    pose = PoseInFrame.FromString(data)
    inner = {"position": rosbag.xyz(pose.pose.position), "orientation": rosbag.xyzw(pose.pose.orientation)}
    return "nav_msgs/msg/Odometry", rosbag.odometry(stamp_ns(pose.timestamp), "ego_vehicle", inner)


def transform(edge):
    return {
        "header": rosbag.header(stamp_ns(edge.timestamp), EGO.get(edge.parent_frame_id, edge.parent_frame_id)),
        "child_frame_id": edge.child_frame_id,
        "transform": {"translation": rosbag.xyz(edge.translation), "rotation": rosbag.xyzw(edge.rotation)},
    }


def bag(path, messages, colours="bgra8", vehicles=("ego_vehicle",), static=False):
    """The messages in a bag under the topic names of CARLA's bridge."""
    with path.open("wb") as stream:
        made = rosbag.Bag(stream)
        for message in messages:
            name, content = in_ros(message, colours)
            topic = TOPICS[message.channel.topic]
            for vehicle in vehicles:
                named = f"/carla/{vehicle}/{topic}" if topic != "/tf" else "/tf_static" if static else topic
                made.write(named, name, message.log_time_ns, content)
        made.finish()
    return path


def run(source, name="out", **options):
    target = source.with_name(f"{source.stem}.{name}.mcap")
    return target, replay(source, target, CFG, **options)


def rows(target, kind="metrics"):
    table = pl.read_parquet(sidecar_path(target, kind))
    return table.drop(["log_id", *[c for c in table.columns if c.endswith("_ms") and c != "sync_skew_ms"]])


@pytest.fixture(scope="module")
def replayed(recorded, tmp_path_factory):
    """A bag of the CARLA bridge, its output, and the summary of its replay."""
    source = bag(tmp_path_factory.mktemp("bag") / "bag.mcap", recorded)
    return source, *run(source)


@pytest.mark.parametrize("depth", ["16UC1", "32FC1"])
def test_a_bag_of_the_carla_bridge_gives_the_same_metrics(tmp_path, recorded, replayed, depth):
    if depth == "32FC1":
        messages = [in_metres(m) for m in recorded]
        found, summary = run(bag(tmp_path / "bag.mcap", messages, "bgr8", static=True))
    else:
        messages, (_, found, summary) = recorded, replayed
    expected, _ = run(write(tmp_path / "ours.mcap", messages))
    assert summary.problems == {}
    assert summary.notes == ("role detections: /carla/ego_vehicle/detections, the only topic that fits",)
    assert rows(found).equals(rows(expected), null_equal=True)
    # a box's centre and size are rounded, so the last bits of its corners differ
    assert_frame_equal(rows(found, "objects"), rows(expected, "objects"), abs_tol=1e-12, rel_tol=0)
    table = rows(found)
    assert table.height == FRAMES
    assert set(table["surface_source"]) == {"depth"}
    assert set(table["lane_left_status"]) == {"measured"}
    assert table["detections_kept"].min() > 0
    assert table["step_error_m"].null_count() == 1


def kept(path):
    return [
        (m.channel.topic, m.log_time_ns, m.data)
        for m in log.read(log.summarise(path))
        if "producer" not in dict(m.channel.metadata)
    ]


IMU = "imu_link"
EGO_T_IMU = rigid(Rotation.from_euler("zyx", (90, 3, -2), degrees=True).as_matrix(), np.array([-1.5, 0.3, 0.4]))


def with_imu(path, messages, *, placed):
    """A bag whose truth is the pose of an inertial unit; ``placed`` adds its transform to /tf."""
    with path.open("wb") as stream:
        made = rosbag.Bag(stream)
        for message in messages:
            name, content = in_ros(message, "bgr8")
            if name == "nav_msgs/msg/Odometry":
                pose = PoseInFrame.FromString(message.data).pose
                odom_T_imu = pose_matrix(pose.position, pose.orientation) @ EGO_T_IMU
                content["child_frame_id"], content["pose"]["pose"] = IMU, rosbag.pose(odom_T_imu)
            elif name == "tf2_msgs/msg/TFMessage" and placed:
                edge = {"header": content["transforms"][0]["header"] | {"frame_id": "ego_vehicle"}}
                place = rosbag.pose(EGO_T_IMU)
                edge["transform"] = {"translation": place["position"], "rotation": place["orientation"]}
                content["transforms"].append(edge | {"child_frame_id": IMU})
            topic = TOPICS[message.channel.topic]
            made.write(topic if topic == "/tf" else f"/carla/ego_vehicle/{topic}", name, message.log_time_ns, content)
        made.finish()
    return path


def test_the_true_pose_may_be_of_any_frame_of_the_vehicle(tmp_path, recorded, replayed):
    found, summary = run(with_imu(tmp_path / "imu.mcap", recorded, placed=True))
    assert not any("truth" in note for note in summary.notes)
    assert_frame_equal(rows(found), rows(replayed[1]), abs_tol=1e-9, rel_tol=0)


def test_the_pose_of_an_unconnected_frame_is_not_used(tmp_path, recorded):
    found, summary = run(with_imu(tmp_path / "imu.mcap", recorded, placed=False))
    topic = "/carla/ego_vehicle/odometry"
    assert f"{topic}: no transform connects the frame of its poses with ego: not used as truth" in summary.notes
    assert rows(found)["true_x_m"].null_count() == rows(found)["step_error_m"].null_count() == FRAMES


def test_every_message_of_a_bag_is_kept(replayed):
    source, first, _ = replayed
    assert kept(first) == kept(source)
    assert log.summarise(first).profile == "ros2"
    again, _ = run(first, "again")
    assert again.read_bytes() == first.read_bytes()


def test_two_vehicles_are_an_error_until_one_is_chosen(tmp_path, recorded, replayed, capsys):
    source = bag(tmp_path / "two.mcap", recorded, vehicles=("hero", "other"))
    target = tmp_path / "out.mcap"
    assert replay_main([str(source), str(target)]) == 1
    words = "2 topics fit role image: /carla/hero/rgb_front/image, /carla/other/rgb_front/image; choose one with: "
    command = f"roadperc-replay {source} OUT.mcap --topic image=/carla/hero/rgb_front/image\n"
    assert capsys.readouterr().err.endswith(words + command)
    chosen = ["--topic", "image=/carla/other/rgb_front/image"]
    assert replay_main([str(source), str(target), *chosen]) == 0
    assert rows(target).equals(rows(replayed[1]), null_equal=True)


def test_a_bag_without_calibration_lists_candidates(tmp_path, recorded, capsys):
    renamed = {"/camera/front/calibration": "rgb_left/camera_info"}
    source = tmp_path / "bag.mcap"
    with source.open("wb") as stream:
        made = rosbag.Bag(stream)
        for message in recorded:
            topic = renamed.get(message.channel.topic, TOPICS[message.channel.topic])
            name, content = in_ros(message, "bgr8")
            made.write(f"/{topic.strip('/')}", name, message.log_time_ns, content)
        made.finish()
    assert replay_main([str(source), str(tmp_path / "out.mcap")]) == 1
    err = capsys.readouterr().err
    assert "no calibration" in err
    assert "role left_calibration: not assigned; candidates: /rgb_left/camera_info (sensor_msgs/msg/CameraInfo)" in err


BROKEN = {
    "/camera/front/image": (
        {"encoding": "nv24"},
        "image encoding 'nv24': expected one of bgr8",
    ),
    "/camera/front/depth": (
        {"step": 10},
        "'16UC1' image 360x270 with step 10: expected 194400 bytes or more",
    ),
    "/camera/front/segmentation": ({"encoding": "rgba8"}, "colour "),
}


def test_undecodable_messages_are_missing_with_a_reason_and_kept(tmp_path, recorded):
    source = tmp_path / "bag.mcap"
    with source.open("wb") as stream:
        made = rosbag.Bag(stream)
        for message in recorded:
            name, content = in_ros(message, "bgra8")
            content |= BROKEN.get(message.channel.topic, ({}, ""))[0]
            topic = TOPICS[message.channel.topic]
            made.write(topic if topic == "/tf" else f"/carla/hero/{topic}", name, message.log_time_ns, content)
        made.finish()
    target, summary = run(source)
    reasons = [reason_of(**reason) for row in rows(target)["reasons"] for reason in row]
    for topic, (_, words) in BROKEN.items():
        of_role = [r for r in reasons if (r.source, r.code) == (topic.split("/")[-1], "undecodable")]
        assert sum(reason.values[0].startswith(words) for reason in of_role) == FRAMES, topic
    assert summary.frames == FRAMES
    assert rows(target)["lane_left_offset_m"].null_count() == FRAMES
    assert kept(target) == kept(source)


def test_a_foreign_log_is_replayed_with_its_topics(data_dir, tmp_path):
    """Its calibration is for 640x480 pixels but its images have 520x360, so no stage uses them. All have one stamp."""
    source = data_dir / "mcap" / "custom-camera-model.mcap"
    target = tmp_path / "out.mcap"
    options = ["--topic", "image=/image/compressed", "--topic", "calibration=/camera_calibration/custom"]
    assert replay_main([str(source), str(target), *options]) == 0
    table = rows(target)
    assert table["odometry_status"].to_list() == ["lost"]
    null = ("surface_inlier_ratio", "drivable_ratio", "lane_left_status", "lane_right_status", "detections")
    assert all(table[column].null_count() == 1 for column in (*null, "stereo_valid_ratio", "lane_left_offset_m"))
    assert set(table["surface_source"]) == {"assumed"}
    assert set(table["reason_codes"].explode()) >= {
        "image.wrong_size",
        "odometry.lost",
        "surface.no_depth_plane_assumed",
        "drivable.no_depth_no_segmentation",
        "lanes.no_segmentation",
        "objects.no_detections",
        "stereo.no_right_image",
        "occupancy.no_depth",
    }
    assert kept(target) == kept(source)
    again = tmp_path / "again.mcap"
    assert replay_main([str(target), str(again)]) == 0  # the result records its topics
    assert again.read_bytes() == target.read_bytes()
