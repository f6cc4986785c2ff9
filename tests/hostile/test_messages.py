"""Messages beyond a limit are skipped, with a reason that names the limit."""

import time
import zlib

import cv2
import numpy as np
import pytest

from roadperc_stream.config import LimitsConfig
from roadperc_stream.errors import DecodeError
from roadperc_stream.formats import images
from roadperc_stream.geometry import Camera
from roadperc_stream.input.decoding import Context, decode
from roadperc_stream.input.stream import Problems, RoleAssignment, decoded_messages
from roadperc_stream.input.transforms import TransformTree
from roadperc_stream.log import Channel, Message
from roadperc_stream.model import Transform
from roadperc_stream.output import encoding
from tests import logs
from tests.analytic import box
from tests.commands import run_forked
from tests.hostile import inputs

pytestmark = pytest.mark.commands
STAMP = logs.START_NS
JPEG = cv2.imencode(".jpg", np.zeros((16, 16, 3), np.uint8))[1].tobytes()
NOISE = cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 255, (240, 320, 3)).astype(np.uint8))[1].tobytes()
HUGE_PNG = inputs.png(30_000, 30_000)


def replayed(tmp_path, items, *options):
    source = logs.write(tmp_path / "in.mcap", items)
    return run_forked("roadperc-replay", source, tmp_path / "out.mcap", *options, memory_bytes=inputs.GROWTH_BYTES)


def read(kind, schema, data, limits):
    return decode(kind, schema, "protobuf", data, STAMP, Context(limits=limits))


@pytest.mark.parametrize("data", [HUGE_PNG, inputs.jpeg_of_size(JPEG, 30_000, 30_000)], ids=["png", "jpeg"])
def test_the_size_in_a_header_is_checked_before_decoding(data):
    for decoder in (images.decode_bgr, images.decode_grey):
        with pytest.raises(DecodeError, match=r"30000x30000, 900 megapixels: expected limits\.image_megapixels 40"):
            decoder(data)


def test_an_oversized_image_is_skipped(tmp_path):
    data = inputs.png(30_000, 30_000, mode=3)
    done = replayed(
        tmp_path, inputs.replaced("segmentation", encoding.encode_image(STAMP, "camera", "png", data), frames=1)
    )
    assert done.returncode == 0, done.stderr
    assert "in the only frame" in done.stdout
    assert "expected limits.image_megapixels 40 at most" in done.stdout


def test_an_oversized_calibration_is_refused(tmp_path):
    """The depth image of a lidar has the size of the calibration."""
    camera = Camera("camera", 40_000, 40_000, 2e4, 2e4, 2e4, 2e4)
    points = np.ones((100, 4), np.float32)
    items = inputs.replaced("calibration", encoding.encode_calibration(STAMP, camera))
    items = [item for item in items if item.role in ("calibration", "tf", "image")]
    items += [
        logs.Item("lidar", i.stamp_ns, encoding.encode_points(i.stamp_ns, "camera", points))
        for i in items
        if i.role == "image"
    ]
    done = replayed(tmp_path, items)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "calibration of 40000x40000, 1600 megapixels: expected limits.image_megapixels 40 at most" in done.stderr


def test_compressed_texts_in_an_image_are_not_expanded():
    zeros = zlib.compress(bytes(100_000_000), 9)
    extra = ((b"iCCP", b"x\0\0" + zeros), (b"zTXt", b"c\0\0" + zeros))
    started = time.process_time()
    for decoder in (images.decode_bgr, images.decode_indices, images.image_size):
        try:
            decoder(inputs.png(32, 24, mode=0, extra=extra))
        except DecodeError:
            continue
    assert time.process_time() - started < 5


def of_detections(boxes):
    return "detections", "roadperc.Detections", encoding.encode_detections(STAMP, "camera", boxes)


CLOUD = encoding.encode_points(STAMP, "lidar", np.zeros((5, 4), np.float32))
BEYOND = {
    "detections": (of_detections([box("Car", 1, 1, 9, 9)] * 5), {"detections": 4}, "5 detections"),
    "points": (("points", "foxglove.PointCloud", CLOUD), {"points": 4}, "5 points"),
    "size": (of_detections([box("x" * 600_000, 1, 1, 9, 9)] * 2), {"message_bytes": 1_000_000}, "bytes"),
}  # fmt: skip


@pytest.mark.parametrize(("message", "limit", "found"), BEYOND.values(), ids=BEYOND)
def test_a_message_beyond_a_limit_is_skipped(monkeypatch, message, limit, found):
    ((name, most),) = limit.items()
    assert read(*message, LimitsConfig())
    monkeypatch.setattr(LimitsConfig, name, most)
    with pytest.raises(DecodeError, match=rf"{found}: expected {most} at most"):
        read(*message, LimitsConfig())


def test_transforms_beyond_the_limit_are_skipped(monkeypatch):
    """With one edge per message the tree grows up to the limit; further edges are reported once."""
    edges = [Transform(f"f{k}", f"f{k + 1}", np.eye(4)) for k in range(20_000)]
    channel = Channel("/tf", "protobuf", "foxglove.FrameTransforms")
    messages = (Message(channel, k, k, 0, encoding.encode_transforms(k, [edge])) for k, edge in enumerate(edges))
    monkeypatch.setattr(LimitsConfig, "transforms", 300)
    problems, started = Problems(), time.process_time()
    assert len(list(decoded_messages(messages, RoleAssignment({"tf": "/tf"}), problems=problems))) == 300
    assert "1 transforms to more frames than 300: left out" in problems.first["/tf, in part"]
    assert time.process_time() - started < 10


def test_a_full_tree_still_updates_known_edges():
    tree = TransformTree().updated([Transform("a", "b", np.eye(4))])
    again = (Transform("a", "b", np.eye(4)), Transform("a", "c", np.eye(4)))
    assert [edge.child for edge in tree.fitting(again, 1)] == ["b"]
