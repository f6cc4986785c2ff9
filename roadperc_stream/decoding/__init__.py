"""Input messages to datatypes, by what the role needs and how the message is written."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

from google.protobuf.message import DecodeError as ProtobufError

from roadperc_stream.channels import IMAGE_SCHEMA, POINTS_SCHEMA, TAG_TABLE_KEY, Kind
from roadperc_stream.decoding import foxglove, own, ros
from roadperc_stream.decoding.calibration import camera_from_calibration
from roadperc_stream.decoding.own import detection_from_proto
from roadperc_stream.decoding.payload import Context, Decoded, Payload, Transform
from roadperc_stream.errors import DecodeError
from roadperc_stream.schemas import ros2
from roadperc_stream.semantics import TABLES

__all__ = [
    "DECODERS",
    "Context",
    "Decoded",
    "Payload",
    "Transform",
    "camera_from_calibration",
    "context_of",
    "decode",
    "detection_from_proto",
    "schemas_of_kind",
]
_END_OF_TIME_NS: Final = 2**63

DECODERS: Final[Mapping[tuple[Kind, str, str], Callable[[bytes, Context], Decoded]]] = {
    ("image", IMAGE_SCHEMA, "protobuf"): foxglove.image,
    ("tags", IMAGE_SCHEMA, "protobuf"): foxglove.tags,
    ("depth", ros2.IMAGE, "cdr"): ros.depth,
    ("points", POINTS_SCHEMA, "protobuf"): foxglove.point_cloud,
    ("calibration", "foxglove.CameraCalibration", "protobuf"): foxglove.calibration,
    ("detections", "roadperc.Detections", "protobuf"): own.detections,
    ("tf", "foxglove.FrameTransforms", "protobuf"): foxglove.transforms,
    ("pose", "foxglove.PoseInFrame", "protobuf"): foxglove.pose,
    ("surface", "roadperc.Surface", "protobuf"): own.surface,
    ("lanes", "roadperc.Lanes", "protobuf"): own.lanes,
    ("objects", "roadperc.Objects", "protobuf"): own.objects,
}


def schemas_of_kind(kind: Kind) -> tuple[tuple[str, str], ...]:
    """(schema, message encoding) pairs that can serve a kind of role."""
    return tuple((schema, encoding) for known, schema, encoding in DECODERS if known == kind)


def context_of(metadata: Mapping[str, str], configured: str) -> Context:
    """Decoding context of a channel; the configured tag table (not ``auto``) wins over the channel's own."""
    name = metadata.get(TAG_TABLE_KEY, "") if configured == "auto" else configured
    return Context(TABLES.get(name))


def decode(kind: Kind, schema: str, encoding: str, data: bytes, log_time_ns: int, context: Context) -> Decoded:
    """Decode one message; a message without a stamp of its own gets its log time.

    Raises:
        DecodeError: the bytes are not what the schema promises.

    """
    try:
        decoded = DECODERS[kind, schema, encoding](data, context)
    except (ProtobufError, ValueError) as error:
        raise DecodeError(f"{len(data)} bytes are no {schema}: {error}") from error
    decoded = decoded if decoded.stamp_ns else replace(decoded, stamp_ns=log_time_ns)
    if not 0 <= decoded.stamp_ns < _END_OF_TIME_NS:
        raise DecodeError(f"stamp {decoded.stamp_ns} ns does not fit 64 bits")
    return decoded
