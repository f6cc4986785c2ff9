"""ROS 2 messages of another project's writer: what they say comes through, and what cannot be used is said."""

import math

import cv2
import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from roadperc_stream.errors import DecodeError
from roadperc_stream.input.decoding import Context, context_of_channel, decode
from roadperc_stream.log import Channel
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14, CARLA_FROM_0_9_14
from roadperc_stream.schemas import cdr, ros2
from tests import rosbag
from tests.analytic import box

STAMP = 1_700_000_000_123_456_789
BGR = np.random.default_rng(5).integers(0, 256, (3, 5, 3), np.uint8)
GREY = np.arange(15, dtype=np.uint8).reshape(3, 5)
K = [300.0, 0.0, 160.0, 0.0, 300.0, 120.0, 0.0, 0.0, 1.0]
COMPRESSED = "sensor_msgs/msg/CompressedImage"
INFO = "sensor_msgs/msg/CameraInfo"
CLOUD = "sensor_msgs/msg/PointCloud2"


def read(kind, name, message, definition=None, table=None):
    text = definition or rosbag.definition_of(name)
    data = rosbag.serialised(name, message, definition)
    return decode(kind, name, "cdr", data, STAMP, Context(table, text.encode()))


def image(encoding, pixels, padding=0, **other):
    return rosbag.image(STAMP, "camera", encoding, pixels, padding) | other


def camera_pixels(encoding, pixels, padding=0, **other):
    return read("image", ros2.IMAGE, image(encoding, pixels, padding, **other)).payload


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("bgr8", BGR),
        ("8UC3", BGR),
        ("rgb8", BGR[..., ::-1]),
        ("bgra8", np.dstack((BGR, GREY))),
        ("8UC4", np.dstack((BGR, GREY))),
        ("rgba8", np.dstack((BGR[..., ::-1], GREY))),
    ],
)
def test_colours_are_decoded_in_any_order_and_padding(encoding, pixels, padding):
    found = camera_pixels(encoding, pixels, padding)
    np.testing.assert_array_equal(found.bgr, BGR)
    np.testing.assert_array_equal(found.grey, cv2.cvtColor(BGR, cv2.COLOR_BGR2GRAY))
    assert found.frame_id == "camera"


@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("mono8", GREY),
        ("8UC1", GREY),
        ("mono16", GREY.astype("<u2") * 256 + 7),
        ("mono16", GREY.astype(">u2") * 256 + 7),
    ],
)
def test_grey_images_are_decoded(encoding, pixels):
    dtype = pixels.dtype.str.replace("=", "<")
    found = camera_pixels(encoding, np.asarray(pixels, dtype), 1)
    np.testing.assert_array_equal(found.grey, GREY)
    np.testing.assert_array_equal(found.bgr, np.dstack([GREY] * 3))


COLOURS = np.repeat(np.array([[(200, 100, 30), (20, 60, 220)]], np.uint8), 8, axis=1).repeat(8, axis=0)
"""(8, 16, 3) red, green and blue of two halves."""
YUV = cv2.cvtColor(COLOURS, cv2.COLOR_RGB2YUV_I420)
Y, U, V = YUV[:8], YUV[8:10].reshape(4, 8), YUV[10:].reshape(4, 8)


def mosaic(tiles):
    """What a sensor with this pattern of filters in its first two rows sees."""
    seen = np.empty((8, 16), np.uint8)
    for place, colour in enumerate(tiles):
        rows = slice(place // 2, None, 2), slice(place % 2, None, 2)
        seen[rows] = COLOURS[(*rows, "rgb".index(colour))]
    return seen


def interleaved(*planes):
    return np.stack(planes, axis=-1).reshape(len(planes[0]), -1)


def in_turns(first, second, *, is_colour_first):
    """4:2:2: brightness, and both colours in turns."""
    colours = interleaved(first, second).repeat(2, axis=0)
    return interleaved(*((colours, Y) if is_colour_first else (Y, colours)))


MOSAICS = {f"bayer_{tiles}8": mosaic(tiles) for tiles in ("rggb", "bggr", "gbrg", "grbg")}
DEEP = {name.replace("8", "16"): seen.astype("<u2") * 256 + 9 for name, seen in MOSAICS.items()}
DEEP |= {"rgb16": COLOURS.astype(">u2") * 256 + 9, "bgr16": COLOURS[..., ::-1].astype("<u2") * 256 + 9}
UYVY, YUYV = (in_turns(U, V, is_colour_first=first) for first in (True, False))
BRIGHTNESS_FIRST = {"nv12": np.vstack((Y, interleaved(U, V))), "nv21": np.vstack((Y, interleaved(V, U)))}
RAW = {**MOSAICS, **DEEP, "yuv422": UYVY, "uyvy": UYVY, "yuv422_yuy2": YUYV, "yuyv": YUYV, **BRIGHTNESS_FIRST}


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize("encoding", RAW)
def test_the_colours_of_sensors_are_decoded(encoding, padding):
    found = camera_pixels(encoding, RAW[encoding], padding, height=8, width=16)
    inside = np.s_[2:-2, [3, 12]]  # away from edges, where a mosaic is interpolated
    np.testing.assert_allclose(found.bgr[inside], COLOURS[inside][..., ::-1], atol=3)
    np.testing.assert_array_equal(found.grey, cv2.cvtColor(found.bgr, cv2.COLOR_BGR2GRAY))
    assert found.size == (16, 8)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("padding", [0, 2])
def test_depth_in_millimetres_and_metres(order, padding):
    metres = np.array([[1.5, 0.0, 65.0]])
    for encoding, kind, scale in (("16UC1", "u2", 1000), ("mono16", "u2", 1000), ("32FC1", "f4", 1)):
        pixels = np.asarray(metres * scale, order + kind)
        depth = read("depth", ros2.IMAGE, image(encoding, pixels, padding)).payload
        np.testing.assert_allclose(depth.depth_m, [[1.5, np.nan, 65.0]], rtol=1e-6)
        assert depth.limit_m == (65.535 if kind == "u2" else np.inf)


def test_tags_are_numbers_of_a_table_or_its_colours():
    tags = np.array([[1, 14, 24]], np.uint8)
    found = read("tags", ros2.IMAGE, image("mono8", tags), table=CARLA_FROM_0_9_14).payload
    np.testing.assert_array_equal(found.tags, tags)
    colours = np.array(CARLA_FROM_0_9_14.colours, np.uint8)[tags]
    for encoding, pixels in (("rgb8", colours), ("bgra8", np.dstack((colours[..., ::-1], tags)))):
        found = read("tags", ros2.IMAGE, image(encoding, pixels)).payload
        assert found.table == CARLA_FROM_0_9_14
        np.testing.assert_array_equal(found.tags, tags)
    before = read("tags", ros2.IMAGE, image("rgb8", colours), table=CARLA_BEFORE_0_9_14).payload
    assert [before.table.name_of(tag) for tag in before.tags[0]] == ["road", "vehicle", "road_line"]


@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
def test_tags_of_16_bits_are_the_numbers_themselves(encoding):
    tags = np.array([[0, 1, 24]], "<u2")
    found = read("tags", ros2.IMAGE, image(encoding, tags), table=CARLA_FROM_0_9_14).payload.tags
    assert (found.dtype, found.tolist()) == (np.uint8, tags.tolist())
    with pytest.raises(DecodeError, match=r"6144.*0 to 255"):
        _ = read("tags", ros2.IMAGE, image(encoding, tags * 256), table=CARLA_FROM_0_9_14).payload.tags


def test_instance_masks_are_numbers_in_green_and_blue():
    pixels = np.array([[(2, 1, 14, 255), (0, 7, 12, 255)]], np.uint8)
    found = read("instances", ros2.IMAGE, image("bgra8", pixels)).payload
    np.testing.assert_array_equal(found.ids, np.array([[513, 7]], np.uint16))
    assert found.ids.dtype == np.uint16
    numbers = np.array([[0, 1, 513]], "<u2")
    assert read("instances", ros2.IMAGE, image("mono16", numbers)).payload.ids.tolist() == numbers.tolist()


def test_tags_of_an_unknown_table_or_colour_are_an_error():
    with pytest.raises(DecodeError, match="names no tag table"):
        read("tags", ros2.IMAGE, image("mono8", GREY))
    found = read("tags", ros2.IMAGE, image("rgb8", np.full((2, 2, 3), (1, 2, 3), np.uint8))).payload
    with pytest.raises(DecodeError, match=r"colour \(1, 2, 3\) \(4 pixels\) is no class's"):
        _ = found.tags


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (image("nv24", BGR), "image encoding 'nv24': expected one of bgr8"),
        (image("nv12", np.zeros((5, 5), np.uint8), height=3), "'nv12' image 5x3: expected an even number"),
        (image("bgr8", BGR, step=14), "'bgr8' image 5x3 with step 14: expected 45 bytes or more, found 45"),
        (image("bgr8", BGR, height=4), "expected 60 bytes or more, found 45"),
        (image("bgr8", BGR, width=2**31), "expected"),
        (image("bgr8", BGR, width=0), "image 0x3"),
        (image("16UC1", GREY.astype("<u2")), "'16UC1': expected colours, mono8 or mono16"),
    ],
    ids=["encoding", "odd", "step", "height", "huge", "empty", "depth"],
)
def test_impossible_pixels_are_an_error(message, words):
    found = read("image", ros2.IMAGE, message).payload
    for pixels in ("bgr", "grey"):
        with pytest.raises(DecodeError, match=words):
            getattr(found, pixels)


def test_colours_are_refused_as_depth():
    with pytest.raises(DecodeError, match="depth of encoding 'bgr8': expected one of 16UC1"):
        _ = read("depth", ros2.IMAGE, image("bgr8", BGR)).payload.depth_m


def compressed(layout, data):
    return {"header": rosbag.header(STAMP, "camera"), "format": layout, "data": data}


def png(pixels):
    return cv2.imencode(".png", pixels)[1].tobytes()


@pytest.mark.parametrize("layout", ["png", "bgr8; png compressed bgr8", "rgb8; jpeg compressed bgr8"])
def test_a_compressed_image_is_decoded_by_its_bytes(layout):
    found = read("image", COMPRESSED, compressed(layout, png(BGR)))
    assert found.stamp_ns == STAMP
    np.testing.assert_array_equal(found.payload.bgr, BGR)


def test_compressed_depth_of_both_kinds():
    mm = np.array([[1500, 0, 65535]], np.uint16)
    for layout, head in (("16UC1; compressedDepth png", bytes(12)), ("16UC1; png compressed", b"")):
        depth = read("depth", COMPRESSED, compressed(layout, head + png(mm))).payload
        np.testing.assert_allclose(depth.depth_m, [[1.5, np.nan, 65.535]], rtol=1e-6)
        assert depth.limit_m == 65.535
    scale, offset = 5000.0, 90.0
    head = np.int32(0).tobytes() + np.float32([scale, offset]).tobytes()
    quantised = np.array([[scale / 2.5 + offset, 0, 50]], np.uint16)
    depth = read("depth", COMPRESSED, compressed("32FC1; compressedDepth", head + png(quantised))).payload
    np.testing.assert_allclose(depth.depth_m, [[2.5, np.nan, np.nan]], rtol=1e-6)
    assert depth.limit_m == np.inf


@pytest.mark.parametrize(
    ("layout", "data", "words"),
    [
        ("16UC1; compressedDepth rvl", bytes(30), "18 bytes are not an image"),
        ("16UC1; compressedDepth", b"abc", "3 bytes, expected a header"),
        ("16UC1; compressedDepth", bytes(12) + png(GREY), "16 bits a pixel"),
        ("32FC1; png compressed", png(GREY.astype(np.uint16)), "expected 16UC1, or compressedDepth"),
    ],
    ids=["rvl", "short", "8 bits", "floats"],
)
def test_unreadable_compressed_depth_is_an_error(layout, data, words):
    found = read("depth", COMPRESSED, compressed(layout, data)).payload
    with pytest.raises(DecodeError, match=words):
        _ = found.depth_m


def test_compressed_depth_is_refused_as_image():
    with pytest.raises(DecodeError, match="that is depth"):
        read("image", COMPRESSED, compressed("16UC1; compressedDepth", b""))


def test_compressed_tags_in_colours():
    colours = np.array(CARLA_FROM_0_9_14.colours, np.uint8)[[[1, 2]]]
    found = read("tags", COMPRESSED, compressed("png", png(np.ascontiguousarray(colours[..., ::-1])))).payload
    np.testing.assert_array_equal(found.tags, [[1, 2]])


def info(**other):
    return rosbag.camera_info(STAMP, "camera", 320, 240, K, **other)


def test_a_camera_info_is_a_camera():
    camera = read("calibration", INFO, info()).payload
    assert (camera.frame_id, camera.size, camera.fx, camera.cy) == ("camera", (240, 320), 300.0, 120.0)
    whole = {"x_offset": 0, "y_offset": 0, "height": 240, "width": 320, "do_rectify": True}
    assert read("calibration", INFO, info(roi=whole, binning_x=1, binning_y=1)).payload == camera
    right = info(p=[300.0, 0, 160, -150.0, 0, 300.0, 120, 0, 0, 0, 1, 0])
    assert read("calibration", INFO, right).payload.baseline_m == 0.5


def test_the_principal_point_of_the_carla_bridge_is_shifted_to_pixel_centres():
    """On a road of CARLA's the half pixel is a tenth of a degree of pitch."""
    topics = {"/carla/hero/rgb_front/camera_info": (159.5, 119.5), "/cam/camera_info": (160, 120)}
    for topic, centre in topics.items():
        channel = Channel(topic, "cdr", INFO, "ros2msg", rosbag.definition_of(INFO).encode())
        context = context_of_channel(channel, "auto")
        camera = decode("calibration", INFO, "cdr", rosbag.serialised(INFO, info()), STAMP, context).payload
        assert (camera.cx, camera.cy) == centre
        assert camera.lens is None


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ({"k": [0.0] * 9, "p": [0.0] * 12}, "expected a pinhole camera"),
        ({"k": [math.nan] * 9, "p": [math.nan] * 12}, "expected a pinhole camera"),
        ({"binning_x": 2, "binning_y": 2}, "binning 2x2"),
        (
            {"roi": {"x_offset": 4, "y_offset": 0, "height": 100, "width": 50, "do_rectify": False}},
            "region of interest 50x100 at 4, 0",
        ),
    ],
    ids=["zero", "nan", "binned", "part"],
)
def test_a_camera_info_of_a_cut_or_binned_image_is_an_error(other, words):
    with pytest.raises(DecodeError, match=words):
        read("calibration", INFO, info(**other))


def cloud(rows, padding=0, **other):
    return rosbag.cloud(STAMP, "lidar", rows, padding, **other)


def test_points_are_decoded_row_by_row():
    rows = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    for padding in (0, 5):
        found = read("points", CLOUD, cloud(rows, padding)).payload
        assert found.frame_id == "lidar"
        np.testing.assert_array_equal(found.points_m, rows[..., :3].reshape(-1, 3))


def test_points_of_whole_numbers_keep_their_sign():
    rows = np.array([[[-1, 2, 3, 4]]], np.int32)
    fields = [rosbag.field("x", 0, 5), rosbag.field("y", 4, 6), rosbag.field("z", 8, 5)]
    np.testing.assert_array_equal(read("points", CLOUD, cloud(rows, fields=fields)).payload.points_m, [[-1, 2, 3]])


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ({"is_bigendian": True}, "big-endian"),
        ({"row_step": 20}, "with row step 20: expected 96 bytes, found 96"),
        ({"height": 3}, "expected 144 bytes, found 96"),
        ({"fields": [rosbag.field("x", 0), rosbag.field("z", 8)]}, "expected x, y and z"),
        (
            {"fields": [rosbag.field("x", 0, 99), rosbag.field("y", 4), rosbag.field("z", 8)]},
            "field x: expected a known type of number",
        ),
    ],
    ids=["big endian", "step", "height", "no y", "type"],
)
def test_impossible_points_are_an_error(other, words):
    found = read("points", CLOUD, cloud(np.zeros((2, 3, 4), np.float32), **other)).payload
    with pytest.raises(DecodeError, match=words):
        _ = found.points_m


def detections(*items):
    return {"header": rosbag.header(STAMP, "camera"), "detections": list(items)}


def test_detections_of_humble():
    car = rosbag.detection(box("", 10, 20, 50, 40).box_px, "car", 0.5, "7")
    less = {"hypothesis": {"class_id": "bus", "score": 0.25}, "pose": car["results"][0]["pose"]}
    nothing = car | {"results": []}
    found = read("detections", rosbag.DETECTIONS, detections(car | {"results": [less, *car["results"]]}, nothing))
    first, second = found.payload
    assert (first.label, first.score, first.id) == ("car", 0.5, "7")
    assert first.box_px == box("", 10, 20, 50, 40).box_px
    assert (second.label, second.score) == ("", 0.0)


def test_a_rotated_box_becomes_the_box_around_it():
    car = rosbag.detection(box("", 10, 20, 50, 40).box_px, "car", 0.5)
    car["bbox"]["center"]["theta"] = math.pi / 2
    (found,) = read("detections", rosbag.DETECTIONS, detections(car)).payload
    sides = (found.box_px.x_min, found.box_px.y_min, found.box_px.x_max, found.box_px.y_max)
    assert sides == pytest.approx((20, 10, 40, 50))


def test_detections_of_foxy_are_read_by_the_layout_in_the_log():
    old = {
        "header": rosbag.header(STAMP, "camera"),
        "results": [{"id": "person", "score": 0.75}],
        "bbox": {"center": {"x": 30.0, "y": 30.0, "theta": 0.0}, "size_x": 40.0, "size_y": 20.0},
        "is_tracking": True,
        "tracking_id": "12",
    }
    (found,) = read("detections", rosbag.DETECTIONS, detections(old), rosbag.DETECTIONS_FOXY).payload
    assert (found.label, found.score, found.id) == ("person", 0.75, "12")
    assert found.box_px == box("", 10, 20, 50, 40).box_px


POSE = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}}
TURNED = [[-1, 0, 0, 1], [0, -1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]


def test_frames_have_no_leading_slash():
    """As in ROS 1: its drivers write ``/cam`` in some messages and ``cam`` in others."""
    edge = {
        "header": rosbag.header(STAMP, "/base_link"),
        "child_frame_id": "/cam",
        "transform": {"translation": POSE["position"], "rotation": POSE["orientation"]},
    }
    (found,) = read("tf", "tf2_msgs/msg/TFMessage", {"transforms": [edge]}).payload
    assert (found.parent, found.child) == ("base_link", "cam")
    cameras = rosbag.camera_info(STAMP, "/cam", 320, 240, [300, 0, 160, 0, 300, 120, 0, 0, 1])
    assert read("calibration", "sensor_msgs/msg/CameraInfo", cameras).payload.frame_id == "cam"
    assert read("image", ros2.IMAGE, rosbag.image(STAMP, "/cam", "mono8", GREY)).payload.frame_id == "cam"
    pose = read("pose", "nav_msgs/msg/Odometry", rosbag.odometry(STAMP, "/base_link", POSE)).payload
    assert pose.child == "base_link"


def test_transforms_and_poses():
    edge = {
        "header": rosbag.header(STAMP, "map"),
        "child_frame_id": "base_link",
        "transform": {"translation": POSE["position"], "rotation": POSE["orientation"]},
    }
    found = read("tf", "tf2_msgs/msg/TFMessage", {"transforms": [edge]})
    assert found.stamp_ns == STAMP
    assert [(e.parent, e.child) for e in found.payload] == [("map", "base_link")]
    np.testing.assert_allclose(found.payload[0].parent_T_child, TURNED, atol=1e-12)
    assert read("tf", "tf2_msgs/msg/TFMessage", {"transforms": []}).payload == ()
    pose = read("pose", "geometry_msgs/msg/PoseStamped", {"header": rosbag.header(STAMP, "map"), "pose": POSE})
    assert (pose.payload.parent, pose.payload.child, pose.stamp_ns) == ("map", "ego", STAMP)
    np.testing.assert_allclose(pose.payload.parent_T_child, TURNED, atol=1e-12)


@pytest.mark.parametrize(
    ("definition", "encoding", "words"),
    [
        (b"", "ros2msg", "the log does not define sensor_msgs/msg/CameraInfo"),
        (b"!!", "ros2msg", "cannot be read"),
        (b"\xff\xfe", "ros2msg", "cannot be read"),
        (b"std_msgs/Header header\n", "ros2msg", "type 'std_msgs/msg/Header' is not defined"),
        (b"uint8 x\n", "protobuf", "definition in encoding protobuf: expected ros2msg, "),
    ],
    ids=["none", "text", "bytes", "part", "encoding"],
)
def test_an_incomplete_definition_is_an_error(definition, encoding, words):
    with pytest.raises(DecodeError, match=words):
        decode("calibration", INFO, "cdr", b"\x00\x01\x00\x00" + bytes(400), STAMP, Context(None, definition, encoding))


def test_definitions_in_idl_are_read():
    rule = "=" * 80 + "\n"
    text = (
        f"{rule}IDL: demo/msg/Point\nmodule demo {{ module msg {{ struct Point {{ double x; double y; }}; }}; }};\n"
        f"{rule}IDL: demo/msg/Pair\n"
        "module demo { module msg { struct Pair { uint8 n; demo::msg::Point at; }; }; };\n"
    )
    body = bytes([5]) + bytes(7) + np.array([1.5, -2.0]).tobytes()
    found = cdr.read(b"\x00\x01\x00\x00" + body, "demo/msg/Pair", text.encode(), "ros2idl")
    assert (found.n, found.at.x, found.at.y) == (5, 1.5, -2.0)


def test_the_first_transforms_of_ros_1_are_read():
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf/msg/tfMessage"))
    edge = store.types["geometry_msgs/msg/TransformStamped"]
    pose = store.types["geometry_msgs/msg/Transform"](
        store.types["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0),
        store.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    header = store.types["std_msgs/msg/Header"](7, store.types["builtin_interfaces/msg/Time"](17, 5), "base_link")
    message = store.types["tf/msg/tfMessage"]([edge(header, "camera", pose)])
    text = store.generate_msgdef(message.__msgtype__)[0].encode()
    data = bytes(store.serialize_ros1(message, message.__msgtype__))
    for name in ("tf/tfMessage", "tf2_msgs/TFMessage"):
        context = context_of_channel(Channel("/tf", "ros1", name, "ros1msg", text), "auto")
        found = decode("tf", name, "ros1", data, STAMP, context)
        ((parent, child, matrix),) = [(e.parent, e.child, e.parent_T_child) for e in found.payload]
        assert (found.stamp_ns, parent, child, *matrix[:3, 3]) == (17_000_000_005, "base_link", "camera", 1, 2, 3)
    with pytest.raises(DecodeError, match="not a valid tf2_msgs/msg/TFMessage"):
        decode("tf", "tf2_msgs/TFMessage", "ros1", data[:-3], STAMP, context)
