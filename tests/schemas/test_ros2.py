"""CDR images and grids: our packing against a public ROS 2 reader's definition, and broken bytes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from roadperc_stream.errors import DecodeError, LogError
from roadperc_stream.input.decoding.ros import unpack_image
from roadperc_stream.model import Occupancy
from roadperc_stream.schemas import ros2


def image(frame_id="camera", dtype=np.uint16, encoding="16UC1"):
    return ros2.RosImage(1_500_000_000, frame_id, encoding, np.arange(12).reshape(3, 4).astype(dtype))


@given(st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=9))
def test_roundtrip_with_every_alignment(frame_id):
    packed = unpack_image(ros2.pack_image(image(frame_id)))
    assert (packed.frame_id, packed.stamp_ns, packed.encoding) == (frame_id, 1_500_000_000, "16UC1")
    np.testing.assert_array_equal(packed.pixels, image().pixels)


def test_floats():
    packed = unpack_image(ros2.pack_image(image(dtype=np.float32, encoding="32FC1")))
    assert packed.pixels.dtype == np.float32
    np.testing.assert_array_equal(packed.pixels, image().pixels)


@pytest.mark.parametrize("frame_id", ["", "a", "ab", "abc", "camera_front"])
def test_a_public_reader_reads_it(frame_id):
    schema = Schema(1, ros2.IMAGE_DEFINITION, "ros2msg", ros2.IMAGE)
    message = DecoderFactory().decoder_for("cdr", schema)(ros2.pack_image(image(frame_id)))
    assert (message.width, message.height, message.step) == (4, 3, 8)
    assert (message.header.frame_id, message.encoding) == (frame_id, "16UC1")
    assert message.header.stamp.sec == 1
    assert bytes(message.data) == image().pixels.tobytes()


@given(st.integers(0, 60))
def test_cut_bytes_are_an_error(length):
    with pytest.raises(DecodeError):
        unpack_image(ros2.pack_image(image())[:length])


def test_an_unknown_encoding_is_an_error():
    with pytest.raises(DecodeError, match="'bgr8'"):
        unpack_image(ros2.pack_image(image(encoding="bgr8")))


@pytest.mark.parametrize("frame_id", ["", "e", "eg", "ego", "ego_", "ego_x", "ego_xy", "ego_xyz"])
def test_a_public_reader_reads_a_grid(frame_id):
    cells = np.asfortranarray(np.array([[-1, 0, 100], [0, -1, 100]], np.int8))
    data = ros2.pack_occupancy_grid(1_500_000_007, frame_id, Occupancy(1.5, -15.0, 0.2, cells))
    schema = Schema(2, ros2.OCCUPANCY_GRID_DEFINITION, "ros2msg", ros2.OCCUPANCY_GRID)
    message = DecoderFactory().decoder_for("cdr", schema)(data)
    assert (message.header.frame_id, message.header.stamp.sec, message.header.stamp.nanosec) == (frame_id, 1, 500000007)
    assert message.info.map_load_time.nanosec == 500000007
    assert (message.info.width, message.info.height) == (3, 2)
    assert message.info.resolution == pytest.approx(0.2)
    origin = message.info.origin
    assert (origin.position.x, origin.position.y, origin.position.z) == (1.5, -15.0, 0.0)
    assert (origin.orientation.x, origin.orientation.y, origin.orientation.z, origin.orientation.w) == (0, 0, 0, 1)
    assert list(message.data) == cells.ravel().tolist()
    assert ros2.unpack_header(data, ros2.OCCUPANCY_GRID) == (1_500_000_007, frame_id)


@pytest.mark.parametrize("stamp_ns", [2**31 * 10**9, 2**62])
def test_stamps_from_2038_on_are_refused(stamp_ns):
    last_ns = 2**31 * 10**9 - 1
    assert ros2.unpack_header(ros2.pack_image(replace(image(), stamp_ns=last_ns)), ros2.IMAGE)[0] == last_ns
    expected = f"stamp {stamp_ns} ns: expected at most {last_ns} ns"
    with pytest.raises(LogError, match=expected):
        ros2.pack_image(replace(image(), stamp_ns=stamp_ns))
    with pytest.raises(LogError, match=expected):
        ros2.pack_occupancy_grid(stamp_ns, "ego", Occupancy(1.5, -15.0, 0.2, np.zeros((2, 3), np.int8)))
