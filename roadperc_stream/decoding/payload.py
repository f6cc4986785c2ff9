"""What a decoder gives, and what it may need beside the bytes."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from roadperc_stream.datatypes import (
    CameraImage,
    DepthImage,
    Detection,
    Lanes,
    Objects,
    PointCloud,
    Surface,
    TagImage,
)
from roadperc_stream.errors import DecodeError
from roadperc_stream.geometry import Camera, Float, rigid, rotation_from_quaternion
from roadperc_stream.semantics import TagTable


@dataclass(frozen=True)
class Transform:
    """One edge of the transform tree: ``parent_T_child``."""

    parent: str
    child: str
    parent_T_child: Float


Payload = (
    CameraImage
    | TagImage
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


@dataclass(frozen=True)
class Decoded:
    """A message's own stamp (0 where it has none) and its content."""

    stamp_ns: int
    payload: Payload


@dataclass(frozen=True)
class Context:
    """What a decoder may need beside the bytes."""

    tag_table: TagTable | None = None


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


def require_finite(what: str, *values: float | None) -> None:
    """Refuse numbers that are none; unknown ones are None.

    Raises:
        DecodeError: one is NaN or infinite.
    """
    if not np.isfinite([value for value in values if value is not None]).all():
        raise DecodeError(f"{what}: a number is not finite")


def optional(message: Any, name: str) -> Any:
    """A field of a protobuf message; None where it is not set."""
    return getattr(message, name) if message.HasField(name) else None
