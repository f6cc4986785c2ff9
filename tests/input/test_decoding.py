"""Messages that lie: numbers that are not finite, stamps beyond time, images that are not PNG."""

import io

import numpy as np
import pytest
from PIL import Image as PillowImage

from roadperc_stream.errors import DecodeError
from roadperc_stream.formats import images
from roadperc_stream.input.decoding import Context, decode
from roadperc_stream.model import Boundary, Lanes, Transform
from roadperc_stream.model.tag_tables import CARLA_BEFORE_0_9_14 as TABLE
from roadperc_stream.output import encoding
from roadperc_stream.schemas import roadperc_pb2 as pb
from tests.analytic import box

STAMP = 1_600_000_000_000_000_000


def read(kind, schema, data, encoding_name="protobuf", log_time_ns=STAMP):
    return decode(kind, schema, encoding_name, data, log_time_ns, Context(TABLE))


@pytest.mark.parametrize("wild", [np.nan, np.inf, 1e300])
def test_a_box_that_is_not_finite_is_refused(wild):
    data = encoding.encode_detections(STAMP, "c", [box("Car", 0, 0, wild, 5)])
    with pytest.raises(DecodeError, match="detection 'Car': a number is not finite"):
        read("detections", "roadperc.Detections", data)


def test_a_transform_that_is_not_finite_is_refused():
    T = np.eye(4)
    T[0, 3] = np.nan
    with pytest.raises(DecodeError, match="not finite"):
        read("tf", "foxglove.FrameTransforms", encoding.encode_transforms(STAMP, [Transform("ego", "c", T)]))


def test_boundaries_of_an_unknown_side_are_left_out():
    message = pb.Lanes(boundaries=[pb.Boundary(side=7), pb.Boundary(side=-1), pb.Boundary(side=2, offset_m=-1.5)])
    lanes = read("lanes", "roadperc.Lanes", message.SerializeToString()).payload
    assert [(b.side, b.offset_m) for b in lanes.boundaries] == [("right", -1.5)]


def test_a_stamp_beyond_64_bits_is_refused():
    message = pb.Detections()
    message.timestamp.seconds = 2**62
    with pytest.raises(DecodeError, match="does not fit"):
        read("detections", "roadperc.Detections", message.SerializeToString())
    with pytest.raises(DecodeError, match="does not fit"):
        read("detections", "roadperc.Detections", b"", log_time_ns=2**64 - 1)


def test_a_message_without_a_stamp_gets_its_log_time():
    assert read("detections", "roadperc.Detections", b"", log_time_ns=77).stamp_ns == 77


def test_lanes_survive_a_round_trip():
    line = np.array([[0.0, 1.8, 0.0], [1.0, 1.8, 0.0]])
    lanes = Lanes((Boundary("left", "measured", None, None, 1.8, 0.1, 0.01, line_ego_m=line, outside="road"),))
    back = read("lanes", "roadperc.Lanes", encoding.encode_lanes(STAMP, "c", lanes)).payload.side("left")
    assert (back.offset_m, back.heading, back.curvature_per_m, back.outside) == (1.8, 0.1, 0.01, "road")
    np.testing.assert_array_equal(back.line_ego_m, line)


def packed(image, fmt):
    stream = io.BytesIO()
    image.save(stream, fmt)
    return stream.getvalue()


GREY = PillowImage.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (packed(GREY, "JPEG"), "format JPEG: expected png"),
        (packed(GREY, "GIF"), "format GIF: expected png"),
        (packed(GREY.convert("RGB"), "PNG"), "mode RGB"),
        (packed(GREY, "PNG")[:50], "not a complete PNG"),
        (b"", "0 bytes are not an image"),
    ],
    ids=["jpeg", "gif", "rgb", "cut", "empty"],
)
def test_tags_are_read_only_from_indexed_pngs(data, words):
    with pytest.raises(DecodeError, match=words) as caught:
        images.decode_indices(data)
    assert "0x" not in str(caught.value), "an address would differ from run to run"


def surface(**grid):
    known = {"x_min_m": 2.0, "y_min_m": -1.0, "step_m": 0.5, "rows": 2, "columns": 3, "z_m": range(6)}
    message = pb.Surface(camera_height_m=1.5, height_grid=pb.HeightGrid(**known | grid))
    message.normal.y = -1.0
    return read("surface", "roadperc.Surface", message.SerializeToString()).payload


def test_a_height_grid_survives_a_round_trip():
    grid = surface().height_grid
    assert (grid.x_min_m, grid.y_min_m, grid.step_m) == (2.0, -1.0, 0.5)
    np.testing.assert_array_equal(grid.z_m, [[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize(
    ("grid", "words"),
    [
        ({"rows": 1, "columns": 6}, "1 rows of 6, 6 heights"),
        ({"rows": 6, "columns": 1}, "6 rows of 1, 6 heights"),
        ({"z_m": range(5)}, "2 rows of 3, 5 heights"),
        ({"rows": 2**32 - 1, "columns": 2**32 - 1}, "6 heights"),
        ({"step_m": -0.5}, "in steps of -0.5 m"),
        ({"step_m": np.nan}, "not finite"),
        ({"z_m": [0, 1, 2, 3, 4, np.nan]}, "not finite"),
        ({"step_m": 1e300}, "not finite in 32 bits"),
    ],
    ids=str,
)
def test_an_invalid_height_grid_is_refused(grid, words):
    with pytest.raises(DecodeError, match=f"height grid: .*{words}"):
        surface(**grid)
