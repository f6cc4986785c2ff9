"""True poses of KITTI's inertial unit and satellite navigation, from the packets of ``oxts``.

Source: A. Geiger, development kit of KITTI raw, ``latlonToMercator.m`` and ``convertOxtsToPose.m``.
"""

from collections.abc import Mapping
from math import asinh, cos, radians, tan
from typing import Final

import numpy as np

from roadperc_stream.errors import DumpError
from roadperc_stream.geometry import Float, inverse, rigid
from roadperc_stream.geometry.rotations import rotation_from_rpy

from ..carla_dump.json_files import numbers

_RADIUS_M: Final = 6_378_137.0
_NUMBERS: Final = 30


def packet(where: str, line: str) -> Float:
    """Return latitude and longitude in degrees, altitude in metres, and roll, pitch and yaw in radians of a line.

    Raises:
        DumpError: the line is not a packet; the message starts with ``where``.
    """
    words = line.split()
    values = numbers(where, words[:6])
    if len(words) != _NUMBERS or abs(values[0]) >= 90:
        raise DumpError(f"{where}: expected {_NUMBERS} numbers, a latitude first; found {len(words)}: {line[:60]!r}")
    return values


def poses_of(packets: Mapping[int, Float], ego_T_imu: Float) -> dict[int, Float]:
    """Return (4, 4) odom_T_ego by number; the odom frame is the ego frame of the first packet.

    Positions are those of the Mercator projection, with the scale of the first latitude.
    """
    if not packets:
        return {}
    first = packets[min(packets)]
    imu_T_ego = inverse(ego_T_imu)
    odom_T_world = ego_T_imu @ inverse(_world_T_imu(first, first))
    return {number: odom_T_world @ _world_T_imu(values, first) @ imu_T_ego for number, values in packets.items()}


def _world_T_imu(values: Float, first: Float) -> Float:
    """Return the pose in a world with x to the east, y to the north and z up, its origin at the first packet."""
    scale_m = cos(radians(first[0])) * _RADIUS_M
    north = asinh(tan(radians(values[0]))) - asinh(tan(radians(first[0])))
    position_m = (scale_m * radians(values[1] - first[1]), scale_m * north, values[2] - first[2])
    return rigid(rotation_from_rpy(*values[3:]), np.array(position_m))
