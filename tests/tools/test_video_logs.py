"""Logs with H.264 video become logs with images, frame by frame."""

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
from roadperc_stream.schemas.protobuf import set_stamp
from tests import logs
from tests.tools.test_carla_to_mcap import failure

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


def test_a_replay_of_video_says_what_to_do(tmp_path, capsys, packets):
    for name, topic in (("a.mcap", TOPIC), ("b.mcap", "/camera/front/image")):
        path = write_log(tmp_path / name, packets[:1], topic=topic)
        assert replay.main([str(path), str(tmp_path / "out.mcap")]) == 1
        error = capsys.readouterr().err
        assert topic in error
        assert "run roadperc-convert on the log" in error


def test_other_formats_and_logs_without_video_are_errors(tmp_path, capsys, packets):
    path = write_log(tmp_path / "in.mcap", packets[:1], form="h265")
    assert f"{TOPIC}: message at" in (line := failure(capsys, path, tmp_path / "out.mcap"))
    assert "format 'h265', expected h264" in line
    plain = logs.write(tmp_path / "plain.mcap", logs.items(1))
    assert "roadperc-replay reads it as it is" in failure(capsys, plain, tmp_path / "out.mcap")
