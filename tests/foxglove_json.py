"""Foxglove's messages in its JSON, as its own recorders write them."""

import json

from google.protobuf.json_format import MessageToDict
from google.protobuf.timestamp_pb2 import Timestamp


def as_json(message, **more):
    """The protobuf message as JSON, with more fields where there are any."""
    return json.dumps(_with_times(MessageToDict(message, preserving_proto_field_name=True)) | more).encode()


def _with_times(value):
    if isinstance(value, list):
        return [_with_times(item) for item in value]
    if isinstance(value, dict):
        return {key: _time(item) if key == "timestamp" else _with_times(item) for key, item in value.items()}
    return value


def _time(text):
    """Protobuf writes a time as text, with as many digits of the second as it needs."""
    made = Timestamp()
    made.FromJsonString(text)
    return {"sec": made.seconds, "nsec": made.nanos}
