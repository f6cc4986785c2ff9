"""ROS 2 messages that this project writes, packed by hand: a depth frame costs 0.2 ms, with a generic writer 6.

Layout after the 4-byte encapsulation header (OMG CDR, little endian, each number aligned to its size from there):

- sensor_msgs/msg/Image: stamp (int32, uint32), frame_id, height, width, encoding, is_bigendian, step, data.
- nav_msgs/msg/OccupancyGrid: stamp, frame_id, map_load_time, resolution (float32), width, height, origin (a pose: seven
  float64), data.

Strings and the data carry their length (strings with a closing zero byte) as uint32.
"""

import struct
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.core.time import NS_PER_S
from roadperc_stream.errors import LogError
from roadperc_stream.schemas import cdr
from roadperc_stream.schemas.names import ROS_GRID_SCHEMA, ROS_IMAGE_SCHEMA

_HEADER_DEFINITION: Final = b"""================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMAGE: Final = ROS_IMAGE_SCHEMA
IMAGE_DEFINITION: Final = (
    b"""std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
"""
    + _HEADER_DEFINITION
)
OCCUPANCY_GRID: Final = ROS_GRID_SCHEMA
OCCUPANCY_GRID_DEFINITION: Final = (
    b"""std_msgs/Header header
nav_msgs/MapMetaData info
int8[] data
"""
    + _HEADER_DEFINITION
    + b"""================================================================================
MSG: nav_msgs/MapMetaData
builtin_interfaces/Time map_load_time
float32 resolution
uint32 width
uint32 height
geometry_msgs/Pose origin
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
)
DEFINITIONS: Final = {IMAGE: IMAGE_DEFINITION, OCCUPANCY_GRID: OCCUPANCY_GRID_DEFINITION}
LAST_STAMP_NS: Final = 2**31 * NS_PER_S - 1
"""The seconds of builtin_interfaces/Time, an int32, end on 2038-01-19."""
_LITTLE_ENDIAN: Final = b"\x00\x01\x00\x00"


@dataclass(frozen=True)
class RosImage:
    """An image message with its pixels as an (H, W) array, or (H, W, channels)."""

    stamp_ns: int
    frame_id: str
    encoding: str
    pixels: NDArray[Any]


@dataclass(frozen=True)
class RosGrid:
    """An occupancy grid message with its cells as a (rows, columns) int8 array; x, y is the first cell's corner."""

    stamp_ns: int
    frame_id: str
    resolution_m: float
    x_m: float
    y_m: float
    cells: NDArray[np.int8]


def pack_occupancy_grid(grid: RosGrid) -> bytes:
    """CDR bytes of a grid whose axes are those of its frame, columns along x and rows along y.

    Raises:
        LogError: its stamp has no place in a ROS 2 message.
    """
    rows, columns = grid.cells.shape
    stamp = _pack_stamp(grid.stamp_ns)
    body = _aligned(stamp + _pack_string(grid.frame_id), 4) + stamp
    body += struct.pack("<fII", grid.resolution_m, columns, rows)
    origin = struct.pack("<7d", grid.x_m, grid.y_m, 0.0, 0.0, 0.0, 0.0, 1.0)
    return _LITTLE_ENDIAN + _aligned(body, 8) + origin + struct.pack("<I", grid.cells.size) + grid.cells.tobytes()


def pack_image(image: RosImage) -> bytes:
    """CDR bytes of a single-channel image.

    Raises:
        LogError: its stamp has no place in a ROS 2 message.
    """
    height, width = image.pixels.shape
    body = _pack_stamp(image.stamp_ns) + _pack_string(image.frame_id)
    body = _aligned(body, 4) + struct.pack("<II", height, width) + _pack_string(image.encoding)
    body = _aligned(body + b"\x00", 4) + struct.pack("<I", image.pixels.itemsize * width)
    return _LITTLE_ENDIAN + body + struct.pack("<I", image.pixels.nbytes) + image.pixels.tobytes()


def unpack_header(data: bytes, name: str) -> tuple[int, str]:
    """Stamp in nanoseconds and frame_id of a message of this module's.

    Raises:
        DecodeError: the bytes are no such message.

    """
    header = cdr.read(data, name, DEFINITIONS[name]).header
    return cdr.stamp_ns(header.stamp), header.frame_id


def _aligned(body: bytes, size: int) -> bytes:
    return body + b"\x00" * (-len(body) % size)


def _pack_stamp(stamp_ns: int) -> bytes:
    if stamp_ns > LAST_STAMP_NS:
        raise LogError(f"stamp {stamp_ns} ns: expected at most {LAST_STAMP_NS} ns, the last one ROS 2 messages hold")
    return struct.pack("<iI", *divmod(stamp_ns, NS_PER_S))


def _pack_string(text: str) -> bytes:
    encoded = text.encode() + b"\x00"
    return struct.pack("<I", len(encoded)) + encoded
