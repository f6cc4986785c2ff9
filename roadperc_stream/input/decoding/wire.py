"""Foxglove's messages as bytes: protobuf whose one large field stays where it is, and JSON.

Parsing copies every field, and asking for one copies it again; of an image's megabyte the first pass needs the stamp.
In JSON times are seconds and nanoseconds, and bytes are base64.
Source of the layout: protobuf.dev/programming-guides/encoding.
"""

import json
from typing import Any, Final

from google.protobuf.json_format import ParseDict, ParseError
from google.protobuf.timestamp_pb2 import Timestamp

from roadperc_stream.errors import DecodeError
from roadperc_stream.formats.raster import Content
from roadperc_stream.schemas.definitions import brief

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_LENGTHS: Final = {_FIXED64: 8, _FIXED32: 4}
_MOST_FIELDS: Final = 32
"""A message of more is none that this is for; walking it would take longer than parsing it."""
_LONGEST_VARINT: Final = 5
"""Bytes; of tags and lengths, more would be no message."""


def parsed(message_type: Any, data: bytes, field: str) -> tuple[Any, Content]:
    """A message without one of its fields, and what that holds.

    Args:
        message_type: the generated class.
        data: the whole message.
        field: a field of bytes; it is copied where the message is not laid out as encoders write it.

    Raises:
        google.protobuf.message.DecodeError: the bytes are no such message.
    """
    place = _place(data, message_type.DESCRIPTOR.fields_by_name[field].number)
    if place is None:
        message = message_type.FromString(data)
        return message, getattr(message, field)
    first, start, end = place
    return message_type.FromString(data[:first] + data[end:]), memoryview(data)[start:end]


def _place(data: bytes, number: int) -> tuple[int, int, int] | None:
    """Where the only field of a number begins, its content begins, and both end; None where a parser has to say."""
    found, at = None, 0
    for _ in range(_MOST_FIELDS):
        if at == len(data):
            return found
        first = at
        tag, at = _varint(data, at)
        wire_type = tag & 7
        length = _LENGTHS.get(wire_type, -1)
        if wire_type in (_VARINT, _BYTES):
            value, after = _varint(data, at)
            length, at = (value, after) if wire_type == _BYTES else (after - at or -1, at)
        if tag >> 3 <= 0 or length < 0 or at + length > len(data):
            return None
        if tag >> 3 == number:
            if found is not None or wire_type != _BYTES:
                return None
            found = first, at, at + length
        at += length
    return None


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """The number at a place, and where it ends; -1 where there is none."""
    value = 0
    for shift, byte in enumerate(data[at : at + _LONGEST_VARINT]):
        value |= (byte & 0x7F) << 7 * shift
        if byte < 0x80:
            return value, at + shift + 1
    return -1, at


def from_json(message_type: Any, data: bytes) -> Any:
    """The protobuf message that says what the JSON says; fields the type does not know are left out.

    Raises:
        DecodeError: no JSON, or a field of another type.
    """
    try:
        return ParseDict(_with_times(_object(data)), message_type(), ignore_unknown_fields=True)
    # Beside what it states, protobuf raises what its C code meets: SystemError of text that is no Unicode.
    except (ParseError, ValueError, TypeError, AttributeError, ArithmeticError, RecursionError, SystemError) as error:
        name = message_type.DESCRIPTOR.full_name
        raise DecodeError(f"{len(data)} bytes are no {name} as JSON: {brief(error)}") from error


def _object(data: bytes) -> dict[str, Any]:
    found = json.loads(data)
    if not isinstance(found, dict):
        raise TypeError(f"expected an object, found a {type(found).__name__}")
    return found


def _with_times(value: Any) -> Any:
    """The same with every ``{"sec", "nsec"}`` as the text that protobuf reads."""
    if isinstance(value, list):
        return [_with_times(item) for item in value] if value and isinstance(value[0], dict | list) else value
    if not isinstance(value, dict):
        return value
    if value.keys() == {"sec", "nsec"}:
        return Timestamp(seconds=value["sec"], nanos=value["nsec"]).ToJsonString()
    return {key: _with_times(item) for key, item in value.items()}
