"""Encodes the ROS 2 messages that this project writes: depth images and occupancy grids."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from roadperc_stream.errors import LogError
from roadperc_stream.model import Occupancy
from roadperc_stream.model.sample import LAST_ROS_STAMP_NS
from roadperc_stream.schemas import cdr
from roadperc_stream.schemas.topics import ROS_GRID_SCHEMA, ROS_IMAGE_SCHEMA
from roadperc_stream.system.time import NS_PER_S

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


@dataclass(frozen=True)
class RosImage:
    """An image message with its pixels as an (H, W) array, or (H, W, channels)."""

    stamp_ns: int
    frame_id: str
    encoding: str
    pixels: NDArray[Any]


def pack_occupancy_grid(stamp_ns: int, frame_id: str, grid: Occupancy) -> bytes:
    """Return CDR bytes of a grid along the axes of its frame: columns along x, rows along y.

    Raises:
        LogError: a ROS 2 message cannot hold its stamp.
    """
    layout = cdr.layout_of(OCCUPANCY_GRID, OCCUPANCY_GRID_DEFINITION)
    types = layout.types
    rows, columns = grid.cells.shape
    header = _header(types, stamp_ns, frame_id)
    position = types["geometry_msgs/msg/Point"](grid.x_min_m, grid.y_min_m, 0.0)
    origin = types["geometry_msgs/msg/Pose"](position, types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0))
    info = types["nav_msgs/msg/MapMetaData"](header.stamp, grid.resolution_m, columns, rows, origin)
    message = types[OCCUPANCY_GRID](header, info, np.ascontiguousarray(grid.cells).reshape(-1))
    return bytes(layout.serialize_cdr(message, OCCUPANCY_GRID))


def pack_image(image: RosImage) -> bytes:
    """Return CDR bytes of a single-channel image.

    Raises:
        LogError: a ROS 2 message cannot hold its stamp.
    """
    layout = cdr.layout_of(IMAGE, IMAGE_DEFINITION)
    height, width = image.pixels.shape
    header, step = _header(layout.types, image.stamp_ns, image.frame_id), image.pixels.itemsize * width
    data = np.ascontiguousarray(image.pixels).reshape(-1).view(np.uint8)
    message = layout.types[IMAGE](header, height, width, image.encoding, 0, step, data)
    return bytes(layout.serialize_cdr(message, IMAGE))


def unpack_header(data: bytes, name: str) -> tuple[int, str]:
    """Return stamp in nanoseconds and frame_id of a message that this module encoded.

    Raises:
        DecodeError: the bytes are not such a message.
    """
    header = cdr.read(data, name, DEFINITIONS[name]).header
    return cdr.stamp_ns(header.stamp), header.frame_id


def _header(types: Mapping[str, Any], stamp_ns: int, frame_id: str) -> Any:
    if stamp_ns > LAST_ROS_STAMP_NS:
        raise LogError(
            f"stamp {stamp_ns} ns: expected at most {LAST_ROS_STAMP_NS} ns, the largest stamp of a ROS 2 message"
        )
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, NS_PER_S))
    return types["std_msgs/msg/Header"](stamp, frame_id)
