"""ROS 2 messages as CDR."""

import numpy as np

from roadperc_stream import images
from roadperc_stream.datatypes import DepthImage
from roadperc_stream.decoding.payload import Context, Decoded
from roadperc_stream.geometry import Float32
from roadperc_stream.schemas import ros2


def depth(data: bytes, _: Context) -> Decoded:
    """sensor_msgs/msg/Image of 16UC1 millimetres or 32FC1 metres."""
    stamp, frame_id = ros2.unpack_header(data)
    return Decoded(stamp, DepthImage(frame_id, lambda: _depth_m(data)))


def _depth_m(data: bytes) -> tuple[Float32, float]:
    image = ros2.unpack_image(data)
    if image.pixels.dtype.kind == "u":
        return images.depth_from_mm(image.pixels), images.DEPTH_LIMIT_MM / 1000
    depth_m = image.pixels.astype(np.float32)
    depth_m[~(depth_m > 0)] = np.nan
    return depth_m, np.inf
