"""Stamps of any message are read with the schema of its channel."""

import json

import pytest

from roadperc_stream.geometry import mounting
from roadperc_stream.info.stamps import stamp_reader
from roadperc_stream.log import Channel
from roadperc_stream.model import Transform
from roadperc_stream.output import encoding
from roadperc_stream.schemas.protobuf import schema
from roadperc_stream.schemas.roadperc_pb2 import Detections
from tests.info.odd import STAMPED, message
from tests.logs import SMALL, channel, frame_items

STAMP_NS = 1_700_000_000_123_456_789
MESSAGES = {item.role: item.data for item in frame_items(STAMP_NS, SMALL)}


@pytest.mark.parametrize("role", MESSAGES)
def test_the_stamp_of_every_role_is_read(role):
    assert stamp_reader(channel(role))(MESSAGES[role]) == STAMP_NS


def test_the_stamp_of_transforms_is_that_of_the_first_one():
    data = encoding.encode_transforms(STAMP_NS, [Transform("ego", "camera", mounting(z=1.4))])
    assert stamp_reader(channel("tf"))(data) == STAMP_NS


def test_stamps_of_ros_transforms_are_read():
    definition = b"# a comment\ngeometry_msgs/TransformStamped[] transforms\n"
    listed = Channel("/tf", "cdr", "tf2_msgs/msg/TFMessage", "ros2msg", definition)
    data = bytes([0, 1, 0, 0]) + (1).to_bytes(4, "little") + (17).to_bytes(4, "little") + (5).to_bytes(4, "little")
    assert stamp_reader(listed)(data) == 17_000_000_005
    big = bytes([0, 0, 0, 0]) + (1).to_bytes(4, "big") + (17).to_bytes(4, "big") + (5).to_bytes(4, "big")
    assert stamp_reader(listed)(big) == 17_000_000_005


def test_stamps_of_json_messages_are_read():
    read = stamp_reader(Channel("/a", "json", "Text", "jsonschema", json.dumps(STAMPED).encode()))
    assert read(message(STAMP_NS)) == STAMP_NS
    assert [read(data) for data in (b"", b"[]", b'{"timestamp": 3}', b"\xff", message(0))] == [None] * 5


def test_a_message_without_a_stamp_has_none():
    read = stamp_reader(channel("detections"))
    assert read(Detections().SerializeToString()) is None
    assert read(b"\xff\xff") is None


@pytest.mark.parametrize(
    "unknown",
    [
        Channel("/a", "raw"),
        Channel("/a", "protobuf"),
        Channel("/a", "protobuf", "a.B", "protobuf", b"\xff"),
        Channel("/a", "cdr", "std_msgs/msg/String", "ros2msg", b"string data"),
        Channel("/a", "json", "Text", "jsonschema", b"[1]"),
        Channel("/a", "json"),
        Channel("/a", "protobuf", "foxglove.SceneUpdate", "protobuf", schema("foxglove.SceneUpdate").data),
    ],
    ids=lambda c: f"{c.message_encoding} {c.schema_name}",
)
def test_a_schema_without_a_stamp_has_no_reader(unknown):
    assert stamp_reader(unknown) is None
