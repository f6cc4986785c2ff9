"""Images whose names say nothing are offered for what is in them, and for nothing else."""

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from roadperc_stream import log
from roadperc_stream.formats import images
from roadperc_stream.input.roles import assignment_of_log
from roadperc_stream.input.topics import probe_first_message
from roadperc_stream.log import Channel, Message
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14
from roadperc_stream.schemas.protobuf import schema
from tests import logs

ROWS, COLUMNS = 4, 6
GREY = np.arange(ROWS * COLUMNS, dtype=np.uint8).reshape(ROWS, COLUMNS) * 10
TAGS = np.arange(ROWS * COLUMNS, dtype=np.uint8).reshape(ROWS, COLUMNS)
RED = np.full((ROWS, COLUMNS, 3), (0, 0, 250), np.uint8)
ROAD = np.full((ROWS, COLUMNS, 3), CARLA_FROM_0_9_14.colours[1], np.uint8)


def raw(encoding, pixels):
    step = pixels.nbytes // ROWS
    return RawImage(width=COLUMNS, height=ROWS, encoding=encoding, step=step, data=pixels.tobytes())


def compressed(data):
    return CompressedImage(format="png", data=data)


def channel(topic, message):
    found = schema("foxglove.CompressedImage")
    name = message.DESCRIPTOR.full_name
    return Channel(topic, "protobuf", name, "protobuf", found.data if name == found.name else b"")


def write(path, **messages):
    """A log with a camera, and one message on each of some topics of a robot."""
    extra = [
        Message(channel(f"/robot/{topic}", message), logs.START_NS, logs.START_NS, 0, message.SerializeToString())
        for topic, message in messages.items()
    ]
    return logs.write(path, logs.items(1, roles=("calibration", "tf", "image")), extra)


@pytest.mark.parametrize(
    ("message", "kinds"),
    [
        (raw("16UC1", GREY.astype(np.uint16)), {"depth"}),
        (raw("mono16", GREY.astype(np.uint16)), {"depth"}),
        (raw("32FC1", GREY.astype(np.float32)), {"depth"}),
        (raw("mono8", TAGS), {"tags"}),
        (raw("mono8", GREY), set()),
        (raw("bgr8", RED), set()),
        (raw("bgr8", np.zeros_like(RED)), set()),
        (raw("rgb8", ROAD), {"tags"}),
        (raw("16UC1", GREY), set()),
        (compressed(images.encode_indices(TAGS, CARLA_FROM_0_9_14.colours)), {"tags"}),
        (compressed(cv2.imencode(".png", GREY)[1].tobytes()), set()),
        (compressed(cv2.imencode(".jpg", RED)[1].tobytes()), set()),
        (compressed(b""), set()),
    ],
)
def test_the_kind_of_the_first_image_is_found(tmp_path, message, kinds):
    summary = log.summarise(write(tmp_path / "a.mcap", thing=message))
    assert {
        kind for kind in ("depth", "tags") if probe_first_message(summary, kind, channel("/robot/thing", message))
    } == kinds


def test_an_empty_channel_and_a_missing_file_have_no_kind(tmp_path):
    depth = raw("32FC1", GREY.astype(np.float32))
    path = write(tmp_path / "a.mcap", thing=depth)
    summary = log.summarise(path)
    assert not probe_first_message(summary, "depth", channel("/robot/other", depth))
    path.unlink()
    assert not probe_first_message(summary, "depth", channel("/robot/thing", depth))


def unassigned(path):
    return assignment_of_log(log.summarise(path), {}).unassigned


def test_unnamed_images_are_candidates_but_not_assigned(tmp_path):
    depth, tags = raw("32FC1", GREY.astype(np.float32)), raw("mono8", TAGS)
    path = write(tmp_path / "a.mcap", range=depth, classes=tags, photo=raw("bgr8", RED), truth_range=depth)
    roles = assignment_of_log(log.summarise(path), {})
    assert {"depth", "segmentation"}.isdisjoint(roles.topics)
    assert roles.unassigned == (
        "role depth: not assigned; candidates: /robot/range (foxglove.RawImage): --topic depth=/robot/range",
        "role segmentation: not assigned; candidates: /robot/classes (foxglove.RawImage): "
        "--topic segmentation=/robot/classes",
    )


def test_a_name_counts_more_than_the_content(tmp_path):
    depth = raw("32FC1", GREY.astype(np.float32))
    path = write(tmp_path / "a.mcap", range=depth, depth_a=depth, depth_b=depth)
    (line,) = unassigned(path)
    assert "/robot/range" not in line
    assert "candidates: /robot/depth_a (foxglove.RawImage), /robot/depth_b (foxglove.RawImage)" in line


def test_images_of_other_cameras_are_not_candidates(tmp_path):
    photo = compressed(cv2.imencode(".jpg", RED)[1].tobytes())
    assert unassigned(write(tmp_path / "a.mcap", back=photo, front=raw("bgr8", RED), infra=raw("mono8", GREY))) == ()
