"""Parses Foxglove messages in JSON: times are seconds and nanoseconds, and bytes are base64."""

import json
from typing import Any

from google.protobuf.json_format import ParseDict, ParseError
from google.protobuf.timestamp_pb2 import Timestamp

from roadperc_stream.errors import DecodeError
from roadperc_stream.schemas.definitions import brief


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
