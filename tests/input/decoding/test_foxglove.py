"""Foxglove's messages as JSON say what they say as protobuf; raw images as what compressed ones do."""

import base64
import json

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from roadperc_stream.errors import DecodeError
from roadperc_stream.input.decoding import Context, decode
from roadperc_stream.model import Transform
from roadperc_stream.model.tag_tables import CARLA_FROM_0_9_14 as TABLE
from roadperc_stream.output import encoding
from roadperc_stream.schemas.protobuf import MESSAGE_TYPES, set_stamp
from tests import foxglove_json
from tests.analytic import Road

STAMP = 1_700_000_000_123_456_789
BGR = np.random.default_rng(5).integers(0, 256, (3, 5, 3), np.uint8)
TURN = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])


def png(pixels):
    return cv2.imencode(".png", pixels)[1].tobytes()


def raw(name, pixels, step=0):
    height, width = pixels.shape[:2]
    stride = step or pixels.itemsize * pixels.size // height
    message = RawImage(frame_id="c", width=width, height=height, encoding=name, step=stride, data=pixels.tobytes())
    set_stamp(message, STAMP)
    return message.SerializeToString()


def one_transform():
    message = FrameTransform.FromString(b"")
    message.parent_frame_id, message.child_frame_id = "ego", "c"
    message.translation.x, message.rotation.w = 1.5, 1.0
    set_stamp(message, STAMP)
    return message.SerializeToString()


TYPES = MESSAGE_TYPES | {"foxglove.RawImage": RawImage, "foxglove.FrameTransform": FrameTransform}
MESSAGES = {
    "calibration": ("foxglove.CameraCalibration", encoding.encode_calibration(STAMP, Road(320, 240).camera)),
    "tf": ("foxglove.FrameTransforms", encoding.encode_transforms(STAMP, [Transform("ego", "c", TURN)])),
    "one tf": ("foxglove.FrameTransform", one_transform()),
    "pose": ("foxglove.PoseInFrame", encoding.encode_pose(STAMP, "map", TURN)),
    "image": ("foxglove.CompressedImage", encoding.encode_image(STAMP, "c", "png", png(BGR))),
    "raw image": ("foxglove.RawImage", raw("rgb8", BGR[..., ::-1])),
    "depth": ("foxglove.RawImage", raw("16UC1", np.array([[1500, 0]], "<u2"))),
    "depth in metres": ("foxglove.RawImage", raw("32FC1", np.array([[1.5, -1]], "<f4"))),
    "tags": ("foxglove.CompressedImage", encoding.encode_image(STAMP, "c", "png", png(np.array([[1, 7]], np.uint8)))),
    "raw tags": ("foxglove.RawImage", raw("mono8", np.array([[1, 7]], np.uint8))),
    "raw tag colours": ("foxglove.RawImage", raw("rgb8", np.array(TABLE.colours, np.uint8)[[[1, 7]]])),
    "points": ("foxglove.PointCloud", encoding.encode_points(STAMP, "l", np.arange(8, dtype=np.float32).reshape(2, 4))),
}


def kind_of(key):
    return next(kind for kind in ("image", "tags", "depth", "tf", "pose", "points", "calibration") if kind in key)


KINDS = {key: "tags" if "tag" in key else kind_of(key) for key in MESSAGES}


def as_json(name, data):
    """The message in Foxglove's JSON, with one field that nobody knows."""
    return foxglove_json.as_json(TYPES[name].FromString(data), unknown_to_all={"sec": "?"})


def numbers(payload):
    """The content of a payload as what compares exactly."""
    for name in ("bgr", "tags", "depth_m", "points_m"):
        if hasattr(payload, name):
            return [payload.frame_id, getattr(payload, name).tolist()]
    edges = [payload] if isinstance(payload, Transform) else payload if isinstance(payload, tuple) else []
    return [[e.parent, e.child, e.parent_T_child.tolist()] for e in edges] or payload


@pytest.mark.parametrize("key", MESSAGES)
def test_json_and_protobuf_decode_equally(key):
    name, data = MESSAGES[key]
    proto = decode(KINDS[key], name, "protobuf", data, 5, Context(TABLE))
    said = decode(KINDS[key], name, "json", as_json(name, data), 5, Context(TABLE))
    assert proto.stamp_ns == said.stamp_ns == STAMP
    np.testing.assert_equal(numbers(said.payload), numbers(proto.payload))


def payload(key):
    name, data = MESSAGES[key]
    return decode(KINDS[key], name, "protobuf", data, 5, Context(TABLE)).payload


def test_raw_and_compressed_images_decode_equally():
    np.testing.assert_array_equal(payload("raw image").bgr, payload("image").bgr)
    np.testing.assert_array_equal(payload("raw tags").tags, payload("tags").tags)
    np.testing.assert_array_equal(payload("raw tag colours").tags, [[1, 7]])
    np.testing.assert_allclose(payload("depth").depth_m, payload("depth in metres").depth_m, rtol=1e-6)
    assert payload("one tf")[0].parent_T_child[0, 3] == 1.5


STAMPED = {"timestamp": {"sec": 1, "nsec": 2}}


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{",
        b"\xff\xfe",
        b"[]",
        b"[" * 100_000,
        json.dumps(STAMPED | {"width": "wide"}).encode(),
        json.dumps({"timestamp": {"sec": 2**70, "nsec": 0}}).encode(),
        b'{"timestamp": "\\ud800"}',
    ],
    ids=range(8),
)
def test_invalid_json_is_an_error(data):
    with pytest.raises(DecodeError, match=r"bytes are not a valid foxglove\.CameraCalibration as JSON"):
        decode("calibration", "foxglove.CameraCalibration", "json", data, 5, Context())


def test_a_missing_time_becomes_the_log_time():
    text = json.dumps({"timestamp": None, "frame_id": "c", "data": base64.b64encode(png(BGR)).decode()})
    found = decode("image", "foxglove.CompressedImage", "json", text.encode(), 77, Context())
    assert found.stamp_ns == 77
    np.testing.assert_array_equal(found.payload.bgr, BGR)


def test_a_schema_of_another_kind_is_named():
    with pytest.raises(DecodeError, match=r"expected roadperc.Objects \(protobuf\); found std_msgs/msg/String \(cdr\)"):
        decode("objects", "std_msgs/msg/String", "cdr", b"", STAMP, Context())
