"""The stamp of any message that carries one, without decoding the rest of it.

The channel's own schema says where it stands: a field ``timestamp`` of Foxglove's messages and of this project's
(protobuf, JSON), a leading std_msgs/Header (ROS 2), or that of the first part of a list, as transforms have it.
"""

import json
import struct
from collections.abc import Callable
from functools import cache
from typing import Any, Final

from google.protobuf import message_factory, timestamp_pb2
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError

from roadperc_stream.log import Channel
from roadperc_stream.schemas.protobuf import stamp_ns
from roadperc_stream.system.time import NS_PER_S

_FIELD, _LIST = "timestamp", "transforms"
_TIMESTAMP: Final = ".google.protobuf.Timestamp"
_HEADERS: Final = ("std_msgs/Header ", "std_msgs/msg/Header ")
_LISTS_OF_STAMPED: Final = ("geometry_msgs/TransformStamped[] ", "geometry_msgs/msg/TransformStamped[] ")
_LIST_LENGTH_BYTES: Final = 4
StampReader = Callable[[bytes], int | None]


def stamp_reader(channel: Channel) -> StampReader | None:
    """What reads the stamp, in ns, of a channel's messages; None where they carry none that is known.

    The reader gives None for a message whose stamp cannot be read, and for one of zero, which says that nobody set it.
    """
    reader = {"protobuf": _protobuf_reader, "cdr": _cdr_reader, "json": _json_reader}.get(channel.message_encoding)
    found = None if reader is None else reader(channel)
    return None if found is None else _forgiving(found)


def _forgiving(read: Callable[[bytes], int]) -> StampReader:
    def stamp(data: bytes) -> int | None:
        try:
            return read(data) or None
        except (DecodeError, ValueError, KeyError, TypeError, IndexError, struct.error, RecursionError):
            return None

    return stamp


def _protobuf_reader(channel: Channel) -> Callable[[bytes], int] | None:
    numbers = _field_numbers(channel.schema_name, channel.schema_data)
    if numbers is None:
        return None
    timestamp, parts = numbers
    probe = _probe(timestamp, parts)
    if parts is None:
        return lambda data: stamp_ns(probe.FromString(data).timestamp)
    return lambda data: stamp_ns(probe.FromString(data).parts[0].timestamp)


def _field_numbers(name: str, schema_data: bytes) -> tuple[int, int | None] | None:
    """Number of the field ``timestamp``, and of the list whose first part has it, where the message has none itself."""
    try:
        files = FileDescriptorSet.FromString(schema_data).file
    except DecodeError:
        return None
    kinds = {f".{file.package}.{kind.name}".replace("..", "."): kind for file in files for kind in file.message_type}
    message = kinds.get(f".{name}")
    if message is None:
        return None
    own = _timestamp_number(message)
    if own is not None:
        return own, None
    for field in message.field:
        part = kinds.get(field.type_name)
        if field.name == _LIST and part and (number := _timestamp_number(part)):
            return number, field.number
    return None


def _timestamp_number(message: DescriptorProto) -> int | None:
    numbers = (f.number for f in message.field if f.name == _FIELD and f.type_name == _TIMESTAMP)
    return next(numbers, None)


@cache
def _probe(timestamp: int, parts: int | None) -> Any:
    """A message type that knows the stamp alone: all other fields are passed over, whatever is in them."""
    kind = FieldDescriptorProto.TYPE_MESSAGE
    file = FileDescriptorProto(name="probe.proto", package="probe", dependency=["google/protobuf/timestamp.proto"])
    stamped = file.message_type.add(name="Stamped")
    stamped.field.add(name="timestamp", number=timestamp, type=kind, label=1, type_name=_TIMESTAMP)
    if parts is not None:
        listed = file.message_type.add(name="Listed")
        listed.field.add(name="parts", number=parts, type=kind, label=3, type_name=".probe.Stamped")
    pool = DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    name = "probe.Stamped" if parts is None else "probe.Listed"
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def _cdr_reader(channel: Channel) -> Callable[[bytes], int] | None:
    lines = channel.schema_data.decode(errors="replace").splitlines()
    first = next((line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
    if first.startswith(_HEADERS):
        return lambda data: _cdr_stamp_ns(data, 4)
    if first.startswith(_LISTS_OF_STAMPED):
        return lambda data: _cdr_stamp_ns(data, 4 + _LIST_LENGTH_BYTES)
    return None


def _cdr_stamp_ns(data: bytes, at: int) -> int:
    """Stamp at a byte of a CDR message, whose second byte gives the order of bytes."""
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, at)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def _json_reader(channel: Channel) -> Callable[[bytes], int] | None:
    try:
        fields = json.loads(channel.schema_data)["properties"].keys()
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    return _json_stamp_ns if fields & {_FIELD, _LIST} else None


def _json_stamp_ns(data: bytes) -> int:
    message = json.loads(data)
    stamp = (message if _FIELD in message else message[_LIST][0])[_FIELD]
    return int(stamp["sec"]) * NS_PER_S + int(stamp["nsec"])
