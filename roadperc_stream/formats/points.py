"""Decodes the packed points of a foxglove.PointCloud."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Float, Float32, transform

FIELDS: Final = ("x", "y", "z", "intensity")
"""Columns of written points; a cloud without intensities has the first three."""
_AXES: Final = FIELDS[:3]
_TYPES: Final[Mapping[int, str]] = {1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<f4", 8: "<f8"}
"""numpy's names of foxglove.PackedElementField.NumericType, all little-endian."""


def unpack_points(message: Any, frame_T_points: Float) -> Float32:
    """(N, 3) float32 metres of a foxglove.PointCloud, in its frame; points that are not finite stay.

    The fields x, y and z may have any type of number. ``frame_T_points`` is the pose of the points.

    Raises:
        DecodeError: a field is missing, has an unknown type or exceeds the stride, or the data end within a point.
    """
    stride, data = int(message.point_stride), message.data
    if not stride or len(data) % stride:
        raise DecodeError(f"{len(data)} bytes of points: expected a multiple of the stride, {stride} bytes")
    columns = [_column(message, axis, stride, data) for axis in _AXES]
    points_m = np.empty((len(data) // stride, 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for k, column in enumerate(columns):
            points_m[:, k] = column
        if not np.array_equal(frame_T_points, np.eye(4)):
            points_m = transform(frame_T_points, points_m.astype(float)).astype(np.float32)
    return points_m


def _column(message: Any, axis: str, stride: int, data: bytes) -> NDArray[Any]:
    """(N,) one coordinate of every point, in the message's type of number."""
    field = next((field for field in message.fields if field.name == axis), None)
    if field is None:
        there = ", ".join(field.name for field in message.fields) or "none"
        raise DecodeError(f"fields {there}: expected x, y and z among them")
    if field.type not in _TYPES:
        raise DecodeError(f"field {axis}: type {field.type}, expected one of {min(_TYPES)} to {max(_TYPES)}")
    kind = np.dtype(_TYPES[field.type])
    if field.offset + kind.itemsize > stride:
        end = field.offset + kind.itemsize
        raise DecodeError(f"field {axis}: ends at byte {end} of a point, expected at most its stride, {stride}")
    return np.ndarray((len(data) // stride,), kind, data, field.offset if data else 0, (stride,))
