"""Reads the stamp of a message without decoding the rest.

The channel's schema shows the place: a field ``timestamp`` (protobuf or JSON, in Foxglove's and this project's
messages), a leading std_msgs/Header (ROS), or that of the first element of a list of transforms.
"""

import json
import struct
from collections.abc import Callable
from typing import Any, Final

from google.protobuf import message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError

from roadperc_stream.log import Channel
from roadperc_stream.schemas.protobuf import stamp_ns
from roadperc_stream.system.time import NS_PER_S

_FIELD, _LIST = "timestamp", "transforms"
_TIMESTAMP: Final = "google.protobuf.Timestamp"
_HEADERS: Final = ("std_msgs/Header ", "std_msgs/msg/Header ", "Header ")
_LISTS_OF_STAMPED: Final = ("geometry_msgs/TransformStamped[] ", "geometry_msgs/msg/TransformStamped[] ")
_LIST_LENGTH_BYTES: Final = 4
StampReader = Callable[[bytes], int | None]


def stamp_reader(channel: Channel) -> StampReader | None:
    """A function that reads the stamp of a channel's messages in ns; None if the schema has no known stamp.

    The function returns None for an unreadable stamp and for zero, which means that it was not set.
    """
    readers = {"protobuf": _protobuf_reader, "cdr": _ros_reader, "ros1": _ros_reader, "json": _json_reader}
    reader = readers.get(channel.message_encoding)
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
    try:
        files = FileDescriptorSet.FromString(channel.schema_data).file
        message = message_factory.GetMessages(files)[channel.schema_name]
    except (DecodeError, KeyError, TypeError, RecursionError):  # the schema is damaged, or lacks a type
        return None
    if _has_stamp(message.DESCRIPTOR):
        return lambda data: stamp_ns(getattr(message.FromString(data), _FIELD))
    listed = message.DESCRIPTOR.fields_by_name.get(_LIST)
    if listed is not None and listed.is_repeated and listed.message_type and _has_stamp(listed.message_type):
        return lambda data: stamp_ns(getattr(getattr(message.FromString(data), _LIST)[0], _FIELD))
    return None


def _has_stamp(message: Any) -> bool:
    field = message.fields_by_name.get(_FIELD)
    single = None if field is None or field.is_repeated else field.message_type
    return single is not None and bool(single.full_name == _TIMESTAMP)


def _ros_reader(channel: Channel) -> Callable[[bytes], int] | None:
    """A reader of CDR or of ROS 1. The stamp has one place in both: CDR's first 4 bytes are a header of its own."""
    is_ros1 = channel.message_encoding == "ros1"
    lines = channel.schema_data.decode(errors="replace").splitlines()
    first = next((line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")), "")
    if first.startswith(_HEADERS):
        return lambda data: _stamp_ns(data, 4, is_little=is_ros1 or bool(data[1] & 1))
    if first.startswith(_LISTS_OF_STAMPED):
        return lambda data: _stamp_ns(data, 4 + _LIST_LENGTH_BYTES, is_little=is_ros1 or bool(data[1] & 1))
    return None


def _stamp_ns(data: bytes, at: int, *, is_little: bool) -> int:
    seconds, nanoseconds = struct.unpack_from("<iI" if is_little else ">iI", data, at)
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
