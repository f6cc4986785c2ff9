"""Foxglove's JSON, in which times are seconds and nanoseconds and bytes are base64, to protobuf messages."""

import json
from typing import Any

from google.protobuf.json_format import ParseDict, ParseError
from google.protobuf.timestamp_pb2 import Timestamp

from roadperc_stream.errors import DecodeError
from roadperc_stream.schemas.definitions import brief


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
