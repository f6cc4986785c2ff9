"""Logs with video become logs with images, frame by frame."""

import base64
import shlex
from functools import partial

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from mcap_protobuf.schema import build_file_descriptor_set

from roadperc_stream import log
from roadperc_stream.cli import replay
from roadperc_stream.cli.convert import main
from roadperc_stream.log import LogWriter, Message
from roadperc_stream.output.encoding import encode_calibration
from roadperc_stream.schemas import cdr
from roadperc_stream.schemas.protobuf import set_stamp
from tests import logs, rosbag
from tests.foxglove_json import as_json
from tests.tools.test_conversion import failure

TOPIC = "/dashcam/video"
FRAMES = 34
"""The second key frame of the video is frame 30."""


@pytest.fixture(scope="module")
def video(data_dir):
    return data_dir / "highway_video" / "solidWhiteRight.mp4"


@pytest.fixture(scope="module")
def packets(video):
    """The first frames of the video as H.264 in the form of Annex B, with parameter sets in each key frame."""
    capture = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    return [capture.read()[1].tobytes() for _ in range(FRAMES)]


def write_log(path, packets, form="h264", topic=TOPIC):
    definition = build_file_descriptor_set(CompressedVideo).SerializeToString()
    channel = log.Channel(topic, "protobuf", "foxglove.CompressedVideo", "protobuf", definition)
    camera = logs.Item("calibration", logs.START_NS, encode_calibration(logs.START_NS, logs.SMALL.camera))
    with LogWriter(path) as writer:
        writer.write(logs.foreign())
        writer.write(logs.message(camera, 0))
        for number, packet in enumerate(packets):
            stamp_ns = logs.START_NS + number * 40_000_000
            frame = CompressedVideo(frame_id="camera", data=packet, format=form)
            set_stamp(frame, stamp_ns)
            writer.write(Message(channel, stamp_ns + 1000, stamp_ns, number, frame.SerializeToString()))
    return path


H265 = [
    base64.b64decode(text)
    for text in (
        "AAAAAUABDAH//wFgAAADAJAAAAMAAAMAPJKAkAAAAAFCAQEBYAAAAwCQAAADAAADADygCggPFlkqSTK5oCAAAAMAIAAAAwFBAAAAAUQBwXK0YkAA"
        "AAEoAa9yFok86wIB//SiSC4RUYR7klu4A6AM4JOApb0VkBbgrxOJyJMDNGUAACkghwAAAwAAAwAH+A==",
        "AAAAAQIB0Al+KSYFxhGR1uD4NMP39/ujt5nXln/dQIcE5A==",
        "AAAAAUABDAH//wFgAAADAJAAAAMAAAMAPJKAkAAAAAFCAQEBYAAAAwCQAAADAAADADygCggPFlkqSTK5oCAAAAMAIAAAAwFBAAAAAUQBwXK0YkAA"
        "AAEqAawI9caIWyjw4wmjlszaLDgqY0fO+8yOiJx7kAXgG3CkuhX4AQYDxEQXsJMBphIgAAKahwAAAwAAAwABUw==",
        "AAAAAQIB0Bl+KSYHZhER1uD4NMP39/ujt5nXln/dQIcE5A==",
    )
]
"""Four frames of 320x240 pixels, of the greys in ``GREYS``, with two key frames."""
GREYS = [40, 90, 140, 200]
VIDEO_MSG = "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n"
VIDEO_MSG += "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
IN_ROS = {"foxglove_msgs/msg/CompressedVideo": VIDEO_MSG}
IN_ROS["sensor_msgs/msg/CompressedImage"] = rosbag.definition_of("sensor_msgs/msg/CompressedImage")


def in_foxglove(message_type, encoding, stamp_ns, packet, form):
    frame = message_type(frame_id="camera", data=packet, format=form)
    set_stamp(frame, stamp_ns)
    data = as_json(frame) if encoding == "json" else frame.SerializeToString()
    text = b"{}" if encoding == "json" else build_file_descriptor_set(message_type).SerializeToString()
    name = message_type.DESCRIPTOR.full_name
    return log.Channel(TOPIC, encoding, name, "jsonschema" if encoding == "json" else encoding, text), data


def in_ros(name, encoding, stamp_ns, packet, form):
    head = rosbag.header(stamp_ns, "camera")
    head = {"header": head} if "Image" in name else {"timestamp": head["stamp"], "frame_id": head["frame_id"]}
    data = rosbag.serialised(name, head | {"data": packet, "format": form}, IN_ROS[name])
    if encoding == "cdr":
        return log.Channel(TOPIC, "cdr", name, "ros2msg", IN_ROS[name].encode()), data
    store = cdr.layout_of(name, IN_ROS[name].encode())
    text = store.generate_msgdef(name, ros_version=1)[0].encode()
    return log.Channel(TOPIC, "ros1", name.replace("/msg/", "/"), "ros1msg", text), bytes(store.cdr_to_ros1(data, name))


FORMS = {
    **{
        f"{t.__name__} {e}": partial(in_foxglove, t, e)
        for t in (CompressedVideo, CompressedImage)
        for e in ("protobuf", "json")
    },
    **{f"{name} {encoding}": partial(in_ros, name, encoding) for name in IN_ROS for encoding in ("cdr", "ros1")},
}


def log_in(form, path, packets, codec="h265"):
    camera = logs.Item("calibration", logs.START_NS, encode_calibration(logs.START_NS, logs.SMALL.camera))
    with LogWriter(path) as writer:
        writer.write(logs.message(camera, 0))
        for number, packet in enumerate(packets):
            stamp_ns = logs.START_NS + number * 40_000_000
            channel, data = FORMS[form](stamp_ns, packet, codec)
            writer.write(Message(channel, stamp_ns, stamp_ns, number, data))
    return path


@pytest.mark.parametrize("form", FORMS)
def test_the_command_in_the_error_of_a_replay_makes_a_log_that_replays(tmp_path, capsys, form):
    path, out = log_in(form, tmp_path / "in.mcap", H265), tmp_path / "images.mcap"
    assert replay.main([str(path), str(tmp_path / "out.mcap")]) == 1
    error = capsys.readouterr().err
    command = shlex.split(error[error.index("roadperc-convert") :].replace("IMAGES.mcap", str(out)))
    assert main([*command[1:], "--quiet"]) == 0
    images = [m for m in log.read(log.summarise(out)) if m.channel.topic == TOPIC]
    assert [pixels(m).mean() for m in images] == pytest.approx(GREYS, abs=3)
    stamps = [CompressedImage.FromString(m.data).timestamp.ToNanoseconds() for m in images]
    assert stamps == [m.log_time_ns for m in images]
    assert replay.main([str(out), str(tmp_path / "out.mcap"), "--quiet"]) == 0


def test_a_bag_with_video_is_converted(tmp_path):
    (tmp_path / "bag").mkdir()
    log_in("foxglove_msgs/msg/CompressedVideo cdr", tmp_path / "bag" / "bag.mcap", H265)
    text = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths: [bag.mcap]\n"
    (tmp_path / "bag" / "metadata.yaml").write_text(text)
    assert len(converted(tmp_path / "bag")[1]) == len(H265)


def converted(path, *options):
    out = path.with_name("out.mcap")
    assert main([str(path), str(out), "--quiet", *options]) == 0
    return out, [message for message in log.read(log.summarise(out)) if message.channel.topic == TOPIC]


def pixels(message):
    content = CompressedImage.FromString(message.data)
    return cv2.imdecode(np.frombuffer(content.data, np.uint8), cv2.IMREAD_COLOR)


def test_each_frame_becomes_an_image_with_its_times(tmp_path, video, packets):
    out, images = converted(write_log(tmp_path / "in.mcap", packets))
    assert [m.log_time_ns for m in images] == [logs.START_NS + k * 40_000_000 + 1000 for k in range(FRAMES)]
    assert [m.publish_time_ns + 1000 for m in images] == [m.log_time_ns for m in images]
    capture = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG)
    for message in images:
        _, expected = capture.read()
        assert np.abs(pixels(message).astype(int) - expected).mean() < 1  # the next frame differs by more than 3
    first = next(iter(log.read(log.summarise(out))))
    assert (first.channel.topic, first.data) == (logs.foreign().channel.topic, logs.foreign().data)
    before = out.read_bytes()
    converted(tmp_path / "in.mcap", "--force")
    assert out.read_bytes() == before


def test_after_damage_frames_still_belong_to_their_messages(tmp_path, capsys, video, packets):
    lost = [packet for number, packet in enumerate(packets) if number != 0]  # up to the next key frame nothing is known
    _, images = converted(write_log(tmp_path / "in.mcap", lost))
    assert len(images) == FRAMES - 30
    assert f"{TOPIC}: 29 frames from {logs.START_NS} ns on are missing" in capsys.readouterr().err
    capture = cv2.VideoCapture(str(video), cv2.CAP_FFMPEG)
    for _ in range(30):
        capture.grab()
    assert np.abs(pixels(images[0]).astype(int) - capture.read()[1]).mean() < 1


def test_other_formats_and_logs_without_video_are_errors(tmp_path, capsys, packets):
    path = write_log(tmp_path / "in.mcap", packets[:1], form="theora")
    assert f"{TOPIC}: video of codec 'theora', expected h264" in failure(capsys, path, tmp_path / "out.mcap")
    for schema, form in (("foxglove.CompressedVideo", "flatbuffer"), ("foxglove_msgs/msg/CompressedVideo", "json")):
        channel = log.Channel(TOPIC, form, schema, "", b"")
        with LogWriter(tmp_path / f"{form}.mcap") as writer:
            writer.write(Message(channel, logs.START_NS, logs.START_NS, 0, b"{}"))
        line = failure(capsys, tmp_path / f"{form}.mcap", tmp_path / "out.mcap")
        assert f"found {schema} ({form})" in line
        assert "foxglove_msgs/msg/CompressedVideo (cdr)" in line
    plain = logs.write(tmp_path / "plain.mcap", logs.items(1))
    assert f"replay it with: roadperc-replay {plain} OUT.mcap" in failure(capsys, plain, tmp_path / "out.mcap")


@pytest.mark.parametrize("form", FORMS)
def test_a_codec_that_cannot_be_decoded_is_named(tmp_path, capsys, form):
    path = log_in(form, tmp_path / "in.mcap", H265[:1], "av1")
    assert "codec 'av1', expected h264 or h265" in failure(capsys, path, tmp_path / "out.mcap")


def test_a_replay_of_video_says_what_to_do(tmp_path, capsys, packets):
    for name, topic in (("a.mcap", TOPIC), ("b.mcap", "/camera/front/image")):
        path = write_log(tmp_path / name, packets[:1], topic=topic)
        assert replay.main([str(path), str(tmp_path / "out.mcap")]) == 1
        error = capsys.readouterr().err
        assert topic in error
        assert f"roadperc-convert {path}" in error
