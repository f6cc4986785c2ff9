"""Decodes input messages, by the kind of their role and by their schema and encoding."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

from google.protobuf.message import DecodeError as ProtobufError

from roadperc_stream.config import DEFAULT_LIMITS, LimitsConfig
from roadperc_stream.errors import DecodeError
from roadperc_stream.formats.images import require_pixels
from roadperc_stream.geometry import Camera
from roadperc_stream.input.decoding import foxglove, own, ros
from roadperc_stream.input.decoding.json_messages import from_json
from roadperc_stream.input.decoding.payload import (
    READ_AS_A_WHOLE,
    Contents,
    Context,
    Payload,
    Stamped,
    camera_from_calibration,
    stamp_of,
    without_slashes,
)
from roadperc_stream.log.records import Channel
from roadperc_stream.model.tag_tables import table_named
from roadperc_stream.schemas import cdr, ros2
from roadperc_stream.schemas.record import TAG_TABLE_KEY
from roadperc_stream.schemas.roles import CARLA_BRIDGE, Kind
from roadperc_stream.system.time import END_OF_TIME_NS

Decoder = Callable[[bytes, Context], Stamped]


def _protobuf(message_type: Any, contents: Contents) -> Decoder:
    return lambda data, context: _stamped(message_type.FromString(data), contents, context)


def _json(message_type: Any, contents: Contents) -> Decoder:
    return lambda data, context: _stamped(from_json(message_type, data), contents, context)


def _cdr(name: str, contents: Contents) -> Decoder:
    def decode_cdr(data: bytes, context: Context) -> Stamped:
        definition = context.definition or ros2.DEFINITIONS.get(name, b"")
        message = cdr.read(data, name, definition, context.definition_encoding)
        with cdr.as_defined(f"{name} as the log defines it"):
            return _stamped(message, contents, context)

    return decode_cdr


def _stamped(message: Any, contents: Contents, context: Context) -> Stamped:
    return Stamped(stamp_of(message), contents(message, context))


_MESSAGES: Final = {**own.CONTENTS, **foxglove.CONTENTS}
DECODERS: Final[Mapping[tuple[Kind, str, str], Decoder]] = {
    **{(kind, t.DESCRIPTOR.full_name, "protobuf"): _protobuf(t, f) for (kind, t), f in _MESSAGES.items()},
    **{(kind, name, "cdr"): _cdr(name, f) for (kind, name), f in ros.CONTENTS.items()},
    **{(kind, name.replace("/msg/", "/"), "ros1"): _cdr(name, f) for (kind, name), f in ros.CONTENTS.items()},
    ("tf", "tf/tfMessage", "ros1"): _cdr("tf/msg/tfMessage", ros.CONTENTS["tf", "tf2_msgs/msg/TFMessage"]),
    **{(kind, t.DESCRIPTOR.full_name, "json"): _json(t, f) for (kind, t), f in foxglove.CONTENTS.items()},
}


def schemas_of_kind(kind: Kind) -> tuple[tuple[str, str], ...]:
    """(schema, message encoding) pairs that can serve a kind of role."""
    return tuple((schema, encoding) for known, schema, encoding in DECODERS if known == kind)


def context_of_channel(
    channel: Channel, configured: str, otherwise: str = "", limits: LimitsConfig = DEFAULT_LIMITS
) -> Context:
    """The decoding context of a channel, with the channel's own message definition.

    Args:
        channel: may name its tag table.
        configured: the tag table that replaces the channel's own, or ``auto``.
        otherwise: the tag table of a channel that names none.
        limits: limits on the contents of a message.
    """
    name = dict(channel.metadata).get(TAG_TABLE_KEY, otherwise) if configured == "auto" else configured
    context = Context(table_named(name), limits=limits, carla_bridge=channel.topic.startswith(CARLA_BRIDGE))
    if not channel.schema_data:
        return context
    return replace(context, definition=channel.schema_data, definition_encoding=channel.schema_encoding)


def decode(kind: Kind, schema: str, encoding: str, data: bytes, log_time_ns: int, context: Context) -> Stamped:
    """Decode one message; a message without a stamp gets its log time. Frames lose their leading slash.

    Raises:
        DecodeError: the bytes do not fit the schema, or the kind does not accept the schema.
    """
    decoder = DECODERS.get((kind, schema, encoding))
    if decoder is None:
        expected = ", ".join(f"{known} ({written})" for known, written in schemas_of_kind(kind))
        raise DecodeError(f"expected {expected}; found {schema or 'no schema'} ({encoding})")
    if len(data) > context.limits.message_bytes and kind not in READ_AS_A_WHOLE:
        raise DecodeError(f"{len(data)} bytes: expected {context.limits.message_bytes} at most")
    try:
        decoded = decoder(data, context)
        if isinstance(decoded.payload, Camera):
            require_pixels("calibration", decoded.payload.width, decoded.payload.height, context.limits)
    except (ProtobufError, ValueError) as error:
        raise DecodeError(f"{len(data)} bytes are not a valid {schema}: {error}") from error
    decoded = Stamped(decoded.stamp_ns or log_time_ns, without_slashes(decoded.payload))
    if not 0 <= decoded.stamp_ns < END_OF_TIME_NS:
        raise DecodeError(f"stamp {decoded.stamp_ns} ns does not fit 64 bits")
    return decoded
