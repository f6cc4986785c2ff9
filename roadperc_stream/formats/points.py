"""Decodes packed points of foxglove.PointCloud and sensor_msgs/msg/PointCloud2."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Float, Float32, transform

FIELDS: Final = ("x", "y", "z", "intensity")
"""Columns of written points; a cloud without intensities has the first three."""
_AXES: Final = FIELDS[:3]


def unpack_points(
    data: bytes, stride: int, fields: Mapping[str, tuple[int, str]], frame_T_points: Float | None = None
) -> Float32:
    """(N, 3) float32 metres; points that are not finite stay.

    ``fields`` has the offset in a point of ``stride`` bytes and numpy's type of x, y, z and others, an empty type if it
    is unknown. ``frame_T_points`` is the pose of the points.

    Raises:
        DecodeError: a field is missing, has an unknown type or exceeds the stride, or the data end within a point.
    """
    if not stride or len(data) % stride:
        raise DecodeError(f"{len(data)} bytes of points: expected a multiple of the stride, {stride} bytes")
    columns = [_column(axis, data, stride, fields) for axis in _AXES]
    points_m = np.empty((len(data) // stride, 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for k, column in enumerate(columns):
            points_m[:, k] = column
        if frame_T_points is not None and not np.array_equal(frame_T_points, np.eye(4)):
            points_m = transform(frame_T_points, points_m.astype(float)).astype(np.float32)
    return points_m


def _column(axis: str, data: bytes, stride: int, fields: Mapping[str, tuple[int, str]]) -> NDArray[Any]:
    """(N,) one coordinate of every point, in the message's type of number."""
    if axis not in fields:
        raise DecodeError(f"fields {', '.join(fields) or 'none'}: expected x, y and z among them")
    offset, kind = fields[axis]
    if not kind:
        raise DecodeError(f"field {axis}: expected a known type of number")
    end = offset + np.dtype(kind).itemsize
    if end > stride:
        raise DecodeError(f"field {axis}: ends at byte {end} of a point, expected at most its stride, {stride}")
    return np.ndarray((len(data) // stride,), kind, data, offset if data else 0, (stride,))
