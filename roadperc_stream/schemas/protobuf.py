"""Schemas that this project writes; stamps and optional fields of protobuf messages."""

from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message as ProtobufMessage
from mcap_protobuf.schema import build_file_descriptor_set

from roadperc_stream.errors import DecodeError
from roadperc_stream.model.reason import Reason, reason_of
from roadperc_stream.schemas import roadperc_pb2, ros2, row_messages
from roadperc_stream.system.time import NS_PER_S

_LARGEST: Final = float(np.finfo(np.float32).max)


def require_finite(what: str, *values: float | None) -> None:
    """Check that numbers are finite in 32 bits; None is unknown.

    Raises:
        DecodeError: one is NaN, infinite, or too large for the 32-bit floats of the chain and the viewer.
    """
    if not all(abs(value) <= _LARGEST for value in values if value is not None):
        raise DecodeError(f"{what}: a number is not finite in 32 bits")


def optional(message: Any, name: str) -> Any:
    """Return a field of a protobuf message; None if it is not set."""
    return getattr(message, name) if message.HasField(name) else None


def reason_in(message: Any) -> Reason:
    """Return the reason of a roadperc.Reason."""
    return reason_of(message.source, message.code, message.values, message.cause)


MESSAGE_TYPES: Final[dict[str, type[ProtobufMessage]]] = {
    message_type.DESCRIPTOR.full_name: message_type
    for message_type in (
        CameraCalibration,
        CompressedImage,
        FrameTransforms,
        ImageAnnotations,
        Log,
        PointCloud,
        PoseInFrame,
        PosesInFrame,
        SceneUpdate,
        roadperc_pb2.Detections,
        row_messages.FrameMetrics,
        roadperc_pb2.Lanes,
        roadperc_pb2.Objects,
        roadperc_pb2.Odometry,
        row_messages.StageTimes,
        roadperc_pb2.Surface,
    )
}


@cache
def schema_data(name: str) -> bytes:
    """Return the FileDescriptorSet of a message type, so that every reader can decode it."""
    data: bytes = build_file_descriptor_set(MESSAGE_TYPES[name]).SerializeToString(deterministic=True)
    return data


@dataclass(frozen=True)
class Schema:
    """Name, encodings and definition of a schema, as a log stores them."""

    name: str
    message_encoding: str
    schema_encoding: str
    data: bytes


def schema(name: str) -> Schema:
    """Return the schema with this name."""
    if name in ros2.DEFINITIONS:
        return Schema(name, "cdr", "ros2msg", ros2.DEFINITIONS[name])
    return Schema(name, "protobuf", "protobuf", schema_data(name))


def stamp_ns(timestamp: Any) -> int:
    """Return integer nanoseconds of a google.protobuf.Timestamp."""
    return int(timestamp.seconds) * NS_PER_S + int(timestamp.nanos)


def set_stamp(message: Any, stamp: int) -> None:
    """Write integer nanoseconds into a message's ``timestamp``."""
    message.timestamp.seconds, message.timestamp.nanos = divmod(stamp, NS_PER_S)
