"""Packed points: every kind of number, any stride, a pose, and messages that do not hold what they promise."""

import numpy as np
import pytest
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud as PointCloudProto
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry.rotations import quaternion, rotation_from_rpy
from roadperc_stream.input.decoding import Context, decode
from roadperc_stream.output.encoding import encode_points
from roadperc_stream.schemas.topics import POINTS_SCHEMA

STAMP = 1_600_000_000_000_000_000
TYPES = {
    "UINT8": np.uint8,
    "INT8": np.int8,
    "UINT16": np.uint16,
    "INT16": np.int16,
    "UINT32": np.uint32,
    "INT32": np.int32,
    "FLOAT32": np.float32,
    "FLOAT64": np.float64,
}


def read(message):
    data = message if isinstance(message, bytes) else message.SerializeToString()
    return decode("points", POINTS_SCHEMA, "protobuf", data, STAMP, Context()).payload


def cloud(records, names="xyz", stride=None, **changes):
    """A message of a structured array."""
    fields = [
        PackedElementField(name=n, offset=records.dtype.fields[n][1], type=number(records.dtype[n])) for n in names
    ]
    stride = records.dtype.itemsize if stride is None else stride
    return PointCloudProto(
        frame_id="lidar", **{"point_stride": stride, "fields": fields, "data": records.tobytes()} | changes
    )


def number(dtype):
    return PackedElementField.NumericType.Value(next(n for n, kind in TYPES.items() if np.dtype(kind) == dtype))


def records(dtype=np.float32, count=4):
    made = np.zeros(count, [(name, dtype) for name in "xyz"])
    for k, name in enumerate("xyz"):
        made[name] = np.arange(count) + 10 * k
    return made


@given(hnp.arrays(np.float32, st.tuples(st.integers(0, 20), st.sampled_from([3, 4])), elements=st.floats(width=32)))
def test_written_points_are_read(points):
    expected = points[np.isfinite(points[:, :3]).all(axis=1), :3]
    np.testing.assert_array_equal(read(encode_points(STAMP, "lidar", points)).points_m, expected)


@pytest.mark.parametrize("dtype", TYPES.values())
def test_every_kind_of_number_is_read(dtype):
    points = read(cloud(records(dtype))).points_m
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points, [(k, 10 + k, 20 + k) for k in range(4)])


@given(st.permutations(["x", "y", "z", "ring", "intensity"]), st.integers(0, 9), st.randoms())
def test_fields_lie_anywhere_in_a_point(order, gap, random):
    kinds = [random.choice(["<f4", "<f8", "<i2"]) for _ in order]
    offsets = np.cumsum([gap, *(np.dtype(kind).itemsize for kind in kinds[:-1])])
    dtype = np.dtype({"names": order, "formats": kinds, "offsets": offsets.tolist(), "itemsize": 60})
    made = np.zeros(3, dtype)
    for name, value in zip("xyz", (1, -2, 3), strict=True):
        made[name] = value
    np.testing.assert_array_equal(read(cloud(made, order)).points_m, [(1, -2, 3)] * 3)


def test_points_are_transformed_by_their_pose():
    message = PointCloudProto.FromString(encode_points(STAMP, "lidar", np.array([[1, 0, 0]], np.float32)))
    x, y, z, w = quaternion(rotation_from_rpy(0.0, 0.0, np.pi / 2))
    message.pose.orientation.x, message.pose.orientation.y = x, y
    message.pose.orientation.z, message.pose.orientation.w = z, w
    message.pose.position.z = 5.0
    np.testing.assert_allclose(read(message).points_m, [(0, 1, 5)], atol=1e-6)


@pytest.mark.parametrize("w", [0.0, np.nan, np.inf])
def test_an_invalid_quaternion_is_an_error(w):
    message = PointCloudProto.FromString(encode_points(STAMP, "lidar", np.array([[1, 2, 3]], np.float32)))
    message.pose.orientation.w = w
    with pytest.raises(DecodeError, match=rf"pose without an orientation: quaternion \(0, 0, 0, {w:g}\)"):
        _ = read(message).points_m


def test_points_that_are_not_finite_are_counted():
    points = read(encode_points(STAMP, "lidar", np.float32([[1, 2, 3], [np.nan, 0, 0], [0, 0, -np.inf]])))
    assert (points.points_m.tolist(), points.left_out) == ([[1, 2, 3]], 2)


def test_a_cloud_without_a_pose_or_points_is_read():
    assert read(cloud(records(count=0))).points_m.shape == (0, 3)
    assert read(cloud(records())).frame_id == "lidar"


def lying(**changes):
    return cloud(records(), **changes)


FIELD = PackedElementField(name="x", offset=0, type=PackedElementField.FLOAT32)


@pytest.mark.parametrize(
    ("message", "fault"),
    [
        (lying(stride=0), "48 bytes of points: expected a multiple of the stride, 0 bytes"),
        (lying(stride=13), "48 bytes of points: expected a multiple of the stride, 13 bytes"),
        (lying(stride=8), "field z: ends at byte 12 of a point, expected at most its stride, 8"),
        (lying(data=b"1234567"), "7 bytes of points: expected a multiple of the stride, 12 bytes"),
        (lying(fields=[FIELD]), "fields x: expected x, y and z among them"),
        (lying(fields=[]), "fields none: expected x, y and z among them"),
        (lying(fields=[PackedElementField(name="x")]), "field x: expected a known type of number"),
        (lying(fields=[PackedElementField(name="x", offset=2**32 - 1, type=7)]), "field x: ends at byte 4294967299"),
        (lying(pose={"position": {"x": 1.0}}), "pose without an orientation"),
        (lying(pose={"position": {"x": np.nan}, "orientation": {"w": 1.0}}), "pose: a number is not finite"),
    ],
)
def test_missing_fields_are_reported_when_points_are_read(message, fault):
    points = read(message)
    with pytest.raises(DecodeError, match=fault):
        _ = points.points_m


def test_invalid_bytes_are_refused():
    with pytest.raises(DecodeError, match=r"3 bytes are not a valid foxglove\.PointCloud"):
        read(b"\xff\xff\xff")


@given(st.binary(max_size=64), st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1), st.integers(0, 9))
def test_any_message_gives_points_or_one_error(data, stride, offset, kind):
    fields = [PackedElementField(name=name, offset=offset, type=kind) for name in "xyz"]
    try:
        assert read(PointCloudProto(point_stride=stride, fields=fields, data=data)).points_m.shape[1] == 3
    except DecodeError:
        return
