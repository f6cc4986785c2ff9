"""Parses Foxglove messages: protobuf without copying the one large field, and JSON.

The protobuf parser copies every field, and reading a field copies it again. The first pass needs only an image's stamp.
In JSON, times are seconds and nanoseconds, and bytes are base64.
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
"""For messages with more fields, the search takes longer than parsing."""
_LONGEST_VARINT: Final = 5
"""Most bytes of a tag or length."""


def parsed(message_type: Any, data: bytes, field: str) -> tuple[Any, Content]:
    """A message without one of its fields, and the content of that field.

    Args:
        message_type: the generated class.
        data: the whole message.
        field: a bytes field; it is copied only if the message has an unusual layout.

    Raises:
        google.protobuf.message.DecodeError: the bytes are not a message of this type.
    """
    place = _place(data, message_type.DESCRIPTOR.fields_by_name[field].number)
    if place is None:
        message = message_type.FromString(data)
        return message, getattr(message, field)
    first, start, end = place
    return message_type.FromString(data[:first] + data[end:]), memoryview(data)[start:end]


def _place(data: bytes, number: int) -> tuple[int, int, int] | None:
    """Start of the only field with a number, start of its content, and end of both; None to use the parser."""
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
    """The varint at a position and its end; the value is -1 if there is none."""
    value = 0
    for shift, byte in enumerate(data[at : at + _LONGEST_VARINT]):
        value |= (byte & 0x7F) << 7 * shift
        if byte < 0x80:
            return value, at + shift + 1
    return -1, at


def from_json(message_type: Any, data: bytes) -> Any:
    """The protobuf message of a JSON text; unknown fields are ignored.

    Raises:
        DecodeError: not JSON, or a field of another type.
    """
    try:
        return ParseDict(_with_times(_object(data)), message_type(), ignore_unknown_fields=True)
    # protobuf's C code also raises undocumented errors, such as SystemError for invalid Unicode.
    except (ParseError, ValueError, TypeError, AttributeError, ArithmeticError, RecursionError, SystemError) as error:
        name = message_type.DESCRIPTOR.full_name
        raise DecodeError(f"{len(data)} bytes are not a valid {name} as JSON: {brief(error)}") from error


def _object(data: bytes) -> dict[str, Any]:
    found = json.loads(data)
    if not isinstance(found, dict):
        raise TypeError(f"expected an object, found a {type(found).__name__}")
    return found


def _with_times(value: Any) -> Any:
    """The value with every ``{"sec", "nsec"}`` as a timestamp text for protobuf."""
    if isinstance(value, list):
        return [_with_times(item) for item in value] if value and isinstance(value[0], dict | list) else value
    if not isinstance(value, dict):
        return value
    if value.keys() == {"sec", "nsec"}:
        return Timestamp(seconds=value["sec"], nanos=value["nsec"]).ToJsonString()
    return {key: _with_times(item) for key, item in value.items()}
