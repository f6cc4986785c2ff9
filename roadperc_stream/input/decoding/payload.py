"""What a decoder gives, and what it may need besides the bytes."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from roadperc_stream.core.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.core.datatypes import (
    CameraImage,
    DepthImage,
    Detection,
    InstanceImage,
    Lanes,
    Objects,
    PointCloud,
    Surface,
    TagImage,
    Transform,
)
from roadperc_stream.core.geometry import Camera, Float, rigid
from roadperc_stream.core.rotations import rotation_from_quaternion
from roadperc_stream.core.semantics import TagTable
from roadperc_stream.errors import DecodeError
from roadperc_stream.schemas.fields import require_finite

Payload = (
    CameraImage
    | TagImage
    | InstanceImage
    | DepthImage
    | PointCloud
    | Camera
    | tuple[Detection, ...]
    | tuple[Transform, ...]
    | Transform
    | Surface
    | Lanes
    | Objects
)


def names_in(payload: Payload | Transform | Detection) -> Iterator[str]:
    """What a message calls frames and things."""
    match payload:
        case CameraImage() | TagImage() | InstanceImage() | DepthImage() | PointCloud() | Camera() | Surface():
            yield payload.frame_id
        case Transform():
            yield from (payload.parent, payload.child)
        case Detection():
            yield from (payload.label, payload.id)
        case Lanes():
            for boundary in payload.boundaries:
                yield from (boundary.inside, boundary.outside)
        case Objects():
            for item in payload.objects:
                yield from (item.detection.label, item.detection.id, item.track_id)
        case tuple():
            for part in payload:
                yield from names_in(part)


@dataclass(frozen=True)
class Decoded:
    """A message's own stamp (0 where it has none) and its content."""

    stamp_ns: int
    payload: Payload


@dataclass(frozen=True)
class Context:
    """What a decoder may need besides the bytes."""

    tag_table: TagTable | None = None
    definition: bytes = b""
    """How the log defines the message, where its encoding does not say by itself (cdr); empty: as ROS 2 defines it."""
    definition_encoding: str = "ros2msg"
    limits: LimitsConfig = DEFAULT_LIMITS
    carla_bridge: bool = False
    """Whether CARLA's ROS bridge wrote it: its principal point, half the image's size, counts from a pixel's corner."""


def pose_matrix(position: Any, orientation: Any) -> Float:
    """(4, 4) of a message's position and quaternion.

    Raises:
        DecodeError: a number is not finite, or the quaternion is no rotation.
    """
    try:
        rotation = rotation_from_quaternion(orientation.x, orientation.y, orientation.z, orientation.w)
    except ValueError as error:
        raise DecodeError(f"pose without an orientation: {error}") from error
    require_finite("pose", position.x, position.y, position.z)
    return rigid(rotation, np.array([position.x, position.y, position.z]))
