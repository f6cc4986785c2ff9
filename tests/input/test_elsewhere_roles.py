"""Topics of other recorders: which role they fill, which are candidates, and what the vehicle's frame is called."""

import numpy as np
import pytest

from roadperc_stream.errors import ChannelError
from roadperc_stream.geometry import Camera
from roadperc_stream.input.assemble import ego_T_camera_of
from roadperc_stream.input.roles import SeveralTopicsError, assign_roles, candidates
from roadperc_stream.input.stream import RoleAssignment
from roadperc_stream.input.transforms import TransformTree
from roadperc_stream.log import Channel
from roadperc_stream.model import Transform
from roadperc_stream.schemas.record import PRODUCER

IMAGE, INFO, CLOUD = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/PointCloud2"
TF = "tf2_msgs/msg/TFMessage"


def ros(**schemas_of):
    """Channels by topic."""
    return [Channel("/" + topic.replace("__", "/"), "cdr", schema) for topic, schema in schemas_of.items()]


def test_topics_of_the_carla_bridge_are_known():
    names = {"rgb_front": IMAGE, "depth_front": IMAGE, "semantic_segmentation_front": IMAGE}
    channels = [Channel(f"/carla/hero/{name}/image", "cdr", schema) for name, schema in names.items()]
    channels += [Channel(f"/carla/hero/{name}/camera_info", "cdr", INFO) for name in names]
    channels += [Channel("/carla/hero/odometry", "cdr", "nav_msgs/msg/Odometry"), *ros(tf=TF, tf_static=TF)]
    channels += [Channel("/carla/hero/lidar", "cdr", CLOUD), Channel("/carla/hero/radar_front", "cdr", CLOUD)]
    roles = assign_roles(channels, {})
    assert dict(roles.topics) == {
        "image": "/carla/hero/rgb_front/image",
        "calibration": "/carla/hero/rgb_front/camera_info",
        "depth": "/carla/hero/depth_front/image",
        "depth_calibration": "/carla/hero/depth_front/camera_info",
        "segmentation": "/carla/hero/semantic_segmentation_front/image",
        "lidar": "/carla/hero/lidar",
        "tf": "/tf",
        "tf_static": "/tf_static",
        "truth_pose": "/carla/hero/odometry",
    }
    assert roles.notes == ()


def test_a_camera_info_is_taken_from_the_namespace_of_its_images():
    channels = ros(
        cam0__image_raw=IMAGE, cam0__camera_info=INFO, cam1__image_raw=IMAGE, cam1__camera_info=INFO, cam1__depth=IMAGE
    )
    topics = assign_roles(channels, {"image": "/cam1/image_raw"}).topics
    assert (topics["calibration"], topics["depth"]) == ("/cam1/camera_info", "/cam1/depth")
    assert "depth_calibration" not in topics


def calibrations(channels, **overrides):
    topics = assign_roles(channels, overrides).topics
    return {name: topic for name, topic in topics.items() if name.endswith("calibration")}


PAIR = {"image": "/robot/cam0/color", "right": "/robot/cam1/color"}


def test_each_camera_of_a_pair_gets_its_own_calibration():
    channels = ros(robot__cam0__color=IMAGE, robot__cam1__color=IMAGE, robot__cam0__calib=INFO, robot__cam1__calib=INFO)
    own = {"calibration": "/robot/cam0/calib", "right_calibration": "/robot/cam1/calib"}
    assert calibrations(channels, **PAIR) == own
    swapped = {"image": PAIR["right"], "right": PAIR["image"]}
    assert calibrations(channels, **swapped) == {
        "calibration": "/robot/cam1/calib",
        "right_calibration": "/robot/cam0/calib",
    }
    assert assign_roles(channels, PAIR).notes == (
        "role calibration: /robot/cam0/calib, the only topic that fits",
        "role right_calibration: /robot/cam1/calib, the only topic that fits",
    )


def test_a_separate_left_camera_has_its_own_calibration():
    names = {f"{camera}/{part}": kind for camera in "abc" for part, kind in (("rgb", IMAGE), ("info", INFO))}
    channels = [Channel(f"/{name}", "cdr", schema) for name, schema in names.items()]
    assert calibrations(channels, image="/a/rgb", left="/b/rgb", right="/c/rgb") == {
        "calibration": "/a/info",
        "left_calibration": "/b/info",
        "right_calibration": "/c/info",
    }


@pytest.mark.parametrize("named", [PAIR, {"image": PAIR["image"], "left": PAIR["right"]}])
def test_a_calibration_beside_another_camera_is_never_taken(named):
    """The front camera has none: that of the other one is not the only topic that fits."""
    channels = ros(robot__cam0__color=IMAGE, robot__cam1__color=IMAGE, robot__cam1__calib=INFO)
    assert "calibration" not in calibrations(channels, **named)
    channels = ros(robot__cam0__color=IMAGE, robot__cam1__color=IMAGE, robot__cam0__calib=INFO)
    assert calibrations(channels, **named) == {"calibration": "/robot/cam0/calib"}


FRONT, BACK, DEPTH = "/a/rgb", "/b/rgb", "/a/range"
PLACED = {
    "one beside two cameras": (ros(s__a=IMAGE, s__b=IMAGE, s__info=INFO), {"image": "/s/a", "right": "/s/b"}, {}),
    "one beside one of two cameras": (
        ros(s__a=IMAGE, s__b=IMAGE, s__info=INFO), {"image": "/s/a"}, {"calibration": "/s/info"}
    ),
    "by name in one namespace": (
        ros(s__left_image=IMAGE, s__right_image=IMAGE, s__left_info=INFO, s__right_info=INFO),
        {"image": "/s/left_image", "right": "/s/right_image"},
        {"calibration": "/s/left_info", "right_calibration": "/s/right_info"},
    ),
    "a namespace before a name": (
        ros(a__rgb=IMAGE, a__info=INFO, b__rgb=IMAGE, b__info=INFO, old__right_info=INFO),
        {"image": FRONT, "right": BACK},
        {"calibration": "/a/info", "right_calibration": "/b/info"},
    ),
    "a name without a namespace": (
        ros(a__rgb=IMAGE, a__info=INFO, b__rgb=IMAGE, old__right_info=INFO),
        {"image": FRONT, "right": BACK},
        {"calibration": "/a/info", "right_calibration": "/old/right_info"},
    ),
    "a topic without a namespace": (
        ros(color=IMAGE, other=IMAGE, a__rgb=IMAGE, a__info=INFO, info=INFO),
        {"image": FRONT, "right": "/other"},
        {"calibration": "/a/info"},
    ),
    "depth beside an image": (
        ros(a__rgb=IMAGE, a__range=IMAGE, a__info=INFO), {"image": FRONT, "depth": DEPTH}, {"calibration": "/a/info"}
    ),
    "depth beside another calibration": (
        ros(a__rgb=IMAGE, tof__range=IMAGE, a__info=INFO, tof__info=INFO),
        {"image": FRONT, "depth": "/tof/range"},
        {"calibration": "/a/info", "depth_calibration": "/tof/info"},
    ),
    "depth beside a camera of a pair": (
        ros(a__rgb=IMAGE, a__info=INFO, b__rgb=IMAGE, b__range=IMAGE, b__info=INFO),
        {"image": FRONT, "right": BACK, "depth": "/b/range"},
        {"calibration": "/a/info"},
    ),
    "one left by another camera": (
        ros(s__a=IMAGE, s__b=IMAGE, s__c=IMAGE, s__a_info=INFO, s__c_info=INFO),
        {"image": "/s/a", "right": "/s/b", "calibration": "/s/a_info"},
        {"calibration": "/s/a_info"},
    ),
}  # fmt: skip


@pytest.mark.parametrize(("channels", "named", "expected"), PLACED.values(), ids=PLACED)
def test_a_calibration_is_that_of_its_namespace_then_of_its_name(channels, named, expected):
    assert calibrations(channels, **named) == expected


@pytest.mark.parametrize(
    ("channels", "named", "expected"),
    [
        (
            ros(a__rgb=IMAGE, a__info=INFO, b__rgb=IMAGE, b__info=INFO, b__info_rectified=INFO, c__info=INFO),
            {"image": FRONT, "right": BACK},
            {"right_calibration": ("/b/info", "/b/info_rectified")},
        ),
        (*PLACED["one left by another camera"][:2], {"right_calibration": ("/s/c_info",)}),
    ],
    ids=["two beside the camera", "one left by another camera"],
)
def test_calibrations_that_may_be_of_the_right_camera_are_candidates(channels, named, expected):
    assert candidates(channels, assign_roles(channels, named).topics).items() >= expected.items()


def test_without_a_known_name_every_image_is_a_candidate():
    """A topic of a Segway speaks of no segmentation."""
    channels = ros(segway__left__labels__image=IMAGE)
    assert candidates(channels, {}) == {"image": ("/segway/left/labels/image",)}


def test_the_only_point_cloud_is_the_lidar():
    channels = ros(cam__image=IMAGE, cam__camera_info=INFO, velodyne_points=CLOUD, radar__points=CLOUD)
    assert assign_roles(channels, {}).topics["lidar"] == "/velodyne_points"


def test_compressed_images_use_the_calibration_of_the_raw_ones():
    channels = ros(a__rgb__compressed="sensor_msgs/msg/CompressedImage", a__info=INFO, b__info=INFO)
    assert calibrations(channels, image="/a/rgb/compressed") == {"calibration": "/a/info"}


def test_unassigned_roles_are_listed():
    channels = ros(cam__image=IMAGE, cam__info=INFO, a__depth=IMAGE, b__depth=IMAGE, velodyne=CLOUD, odom=CLOUD)
    roles = assign_roles(channels, {})
    assert roles.unassigned == (
        "role depth: not assigned; candidates: /a/depth (sensor_msgs/msg/Image), /b/depth (sensor_msgs/msg/Image): "
        "--topic depth=/a/depth",
        "role lidar: not assigned; candidates: /odom (sensor_msgs/msg/PointCloud2), "
        "/velodyne (sensor_msgs/msg/PointCloud2): --topic lidar=/odom",
    )
    assert candidates(channels, roles.topics) == {"depth": ("/a/depth", "/b/depth"), "lidar": ("/odom", "/velodyne")}


def test_results_truths_and_assigned_topics_are_not_candidates():
    channels = ros(cam__image=IMAGE, odom="nav_msgs/msg/Odometry")
    channels += [Channel("/perception/stereo/depth", "cdr", IMAGE, metadata=(PRODUCER,))]
    assert candidates(channels, {"image": "/cam/image"}) == {}


def test_a_needed_role_must_be_chosen():
    with pytest.raises(
        ChannelError, match="2 topics fit role image: /a/image, /b/image; choose one with --topic image="
    ):
        assign_roles(ros(a__image=IMAGE, b__image=IMAGE), {})
    channels = ros(image=IMAGE, a__info=INFO, b__info=INFO)
    with pytest.raises(ChannelError, match="2 topics fit role calibration: /a/info, /b/info"):
        assign_roles(channels, {})


ZED = {"left/image": IMAGE, "left/camera_info": INFO, "right/image": IMAGE, "right/camera_info": INFO}


def zed(**more):
    topics = ZED | {name.replace("__", "/"): schema for name, schema in more.items()}
    return [Channel(f"/zed/{topic}", "cdr", schema) for topic, schema in topics.items()]


def test_a_stereo_camera_without_another_image_is_the_pair():
    found = assign_roles(zed(), {})
    pair = {"left": "/zed/left/image", "right": "/zed/right/image"}
    infos = {"left_calibration": "/zed/left/camera_info", "right_calibration": "/zed/right/camera_info"}
    assert (found.reference, dict(found.topics)) == ("left", pair | infos)


def test_beside_a_front_camera_left_and_right_are_no_pair():
    found = assign_roles(zed(front__image=IMAGE, front__camera_info=INFO), {}).topics
    assert dict(found) == {"image": "/zed/front/image", "calibration": "/zed/front/camera_info"}


@pytest.mark.parametrize(
    ("channels", "options"),
    [
        (zed(left__raw=IMAGE), {"left": "/zed/left/image"}),
        (ros(a_back__image=IMAGE, a_back__info=INFO, front__image=IMAGE, front__info=INFO), {"image": "/front/image"}),
        (ros(back__image=IMAGE, back__info=INFO, front__image=IMAGE), {"image": "/back/image"}),
        (
            ros(back__image=IMAGE, back__info=INFO, front__image=IMAGE, front__info=INFO, front__info_raw=INFO),
            {"image": "/front/image", "calibration": "/front/info"},
        ),
    ],
    ids=["left", "front", "calibrated", "both"],
)
def test_the_suggestion_for_several_topics_works(channels, options):
    """It prefers calibrated cameras, then those called front."""
    with pytest.raises(SeveralTopicsError) as caught:
        assign_roles(channels, {})
    assert caught.value.options == options
    assert all(f"--topic {role}={topic}" in str(caught.value) for role, topic in options.items())
    topics = assign_roles(channels, options).topics
    assert topics.keys() & {"calibration", "left_calibration"}


def test_a_topic_of_the_wrong_schema_is_named():
    with pytest.raises(
        ChannelError, match=r"/points: role image: found sensor_msgs/msg/PointCloud2 \(cdr\), expected .*Image"
    ):
        assign_roles(ros(points=CLOUD), {"image": "/points"})


def shifted(x_m):
    T = np.eye(4)
    T[0, 3] = x_m
    return T


def tree(*edges):
    return TransformTree().updated(Transform(parent, child, shifted(x_m)) for parent, child, x_m in edges)


def camera(frame_id):
    return Camera(frame_id, 320, 240, 300, 300, 160, 120)


@pytest.mark.parametrize(
    ("frame_id", "edges", "x_m"),
    [
        ("cam", [("ego", "cam", 1)], 1),
        ("cam", [("odom", "base_link", 9), ("base_link", "mast", 1), ("mast", "cam", 2)], 3),
        ("cam", [("base_footprint", "base_link", 1), ("base_link", "cam", 2)], 3),
        ("hero/rgb", [("map", "hero", 50), ("hero", "hero/rgb", 2)], 2),
        ("truck7/rgb", [("map", "truck7", 50), ("truck7", "truck7/rgb", 2)], 2),
        ("cam", [("odom", "base_link", 9)], None),
        ("cam", [("body", "cam", 1)], None),
        ("base_link", [("odom", "base_link", 9)], None),
    ],
)
def test_the_vehicles_frame_is_found_by_its_names(frame_id, edges, x_m):
    found = ego_T_camera_of(tree(*edges), camera(frame_id))
    assert (None if found is None else found[0, 3]) == x_m


def test_the_reference_role():
    assert RoleAssignment({"depth": "/d", "left": "/l"}).reference == "left"
    assert RoleAssignment({"detections": "/x"}).reference is None
